"""Launch file with navigator and watchdog for a real robot.

Run it with `ros2 launch ctrl_rl_navigation navigation.launch.py map:=office.yaml`. The watchdog stops the robot when
the navigator dies; it is restarted if it dies itself, and starts by sending zeros. Without `map`, the map comes from
another node on the topic `map`; a localiser (AMCL, slam_toolbox) is started elsewhere.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution, PythonExpression
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

ARGUMENTS = {
    "map": ("", "map_server's .yaml file, or the name of a map of the suite; empty for the topic map"),
    "pose": ("tf", "where the pose comes from: tf (map -> base) or amcl_pose"),
    "stamped": ("true", "cmd_vel is a TwistStamped (Jazzy), else a Twist (Humble)"),
    "timeout": ("0.5", "age of the last command that stops the robot [s]"),
    "robot": ("turtlebot3_burger", "name of the robot, or the path of its .yaml file"),
    "max_speed": ("", "largest speed [m/s]; empty for the robot's"),
    "watchdog": ("true", "whether to start the watchdog; false where another launch file starts it"),
    "use_sim_time": ("false", "whether time is that of the topic clock, as beside a simulator"),
    "rviz": ("false", "whether to start RViz"),
}


def generate_launch_description() -> LaunchDescription:
    """Return the launch description of map server, navigator, watchdog and optionally RViz."""
    given = {name: LaunchConfiguration(name) for name in ARGUMENTS}
    stamped = ParameterValue(given["stamped"], value_type=bool)
    clock = {"use_sim_time": ParameterValue(given["use_sim_time"], value_type=bool)}
    view = PathJoinSubstitution([FindPackageShare("ctrl_rl_navigation"), "config", "navigation.rviz"])
    robot = ParameterValue(given["robot"], value_type=str)
    # The robot's value by default: a launch file cannot omit a parameter.
    own = ("ctrl_rl_core.find_robot('", given["robot"], "').plan.speed")
    fastest = PythonExpression(["float('", given["max_speed"], "' or ", *own, ")"], ["ctrl_rl_core"])
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=meaning)
                for name, (default, meaning) in ARGUMENTS.items()
            ),
            Node(
                package="ctrl_rl_navigation",
                executable="map_server",
                parameters=[{"map": ParameterValue(given["map"], value_type=str), **clock}],
                condition=IfCondition(PythonExpression(["'", given["map"], "' != ''"])),
                output="screen",
            ),
            Node(
                package="ctrl_rl_core",
                executable="watchdog",
                condition=IfCondition(given["watchdog"]),
                parameters=[
                    {
                        "enable_stamped_cmd_vel": stamped,
                        "timeout": ParameterValue(given["timeout"], value_type=float),
                        "robot": robot,
                        **clock,
                    }
                ],
                output="screen",
                respawn=True,
            ),
            Node(
                package="ctrl_rl_navigation",
                executable="navigator",
                parameters=[
                    {
                        "enable_stamped_cmd_vel": stamped,
                        "pose": ParameterValue(given["pose"], value_type=str),
                        "robot": robot,
                        "max_speed": ParameterValue(fastest, value_type=float),
                        **clock,
                    }
                ],
                remappings=[("cmd_vel", "cmd_vel_raw")],
                output="screen",
            ),
            Node(
                package="rviz2",
                executable="rviz2",
                arguments=["-d", view],
                parameters=[clock],
                condition=IfCondition(given["rviz"]),
                output="log",
            ),
        ]
    )
