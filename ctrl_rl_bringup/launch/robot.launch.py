"""ros2 launch ctrl_rl_bringup robot.launch.py [policy:=...] [dry_run:=true]: controller and watchdog for a real robot.

The watchdog stops the robot when the controller dies. It is started again when it dies itself, and begins with zeros.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from koopman_lqr_controller import DEFAULT_POLICY


def generate_launch_description() -> LaunchDescription:
    """Return the two nodes that drive a robot."""
    stamped = ParameterValue(LaunchConfiguration("stamped"), value_type=bool)
    timeout = ParameterValue(LaunchConfiguration("timeout"), value_type=float)
    policy = ParameterValue(LaunchConfiguration("policy"), value_type=str)
    dry_run = ParameterValue(LaunchConfiguration("dry_run"), value_type=bool)
    max_distance = ParameterValue(LaunchConfiguration("max_distance"), value_type=float)
    robot = ParameterValue(LaunchConfiguration("robot"), value_type=str)
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "robot",
                default_value="turtlebot3_burger",
                description="name of the robot, or the path of its .yaml file",
            ),
            DeclareLaunchArgument("policy", default_value=DEFAULT_POLICY, description="policy name or file"),
            DeclareLaunchArgument(
                "stamped", default_value="true", description="cmd_vel is a TwistStamped (Jazzy), else a Twist (Humble)"
            ),
            DeclareLaunchArgument(
                "timeout", default_value="0.5", description="age of the last command that stops the robot [s]"
            ),
            DeclareLaunchArgument(
                "commands",
                default_value="cmd_vel_raw",
                description="topic that the controller commands on; cmd_vel_auto where twist_mux is in between",
            ),
            DeclareLaunchArgument("dry_run", default_value="false", description="compute commands, but send none"),
            DeclareLaunchArgument(
                "max_distance",
                default_value="0.0",
                description="distance after which it stands [m]; 0.0 for any",
            ),
            Node(
                package="ctrl_rl_core",
                executable="watchdog",
                parameters=[{"robot": robot, "enable_stamped_cmd_vel": stamped, "timeout": timeout}],
                output="screen",
                respawn=True,
            ),
            Node(
                package="koopman_lqr_controller",
                executable="controller",
                parameters=[
                    {
                        "robot": robot,
                        "enable_stamped_cmd_vel": stamped,
                        "policy": policy,
                        "dry_run": dry_run,
                        "max_distance": max_distance,
                    }
                ],
                remappings=[("cmd_vel", LaunchConfiguration("commands"))],
                output="screen",
            ),
        ]
    )
