"""Launch file with safety filter and watchdog between any driver and a real robot.

Run it with `ros2 launch ctrl_rl_safety safety_filter.launch.py`. The driver publishes cmd_vel_raw, the filter
cmd_vel_safe, the watchdog cmd_vel. Each node is restarted when it dies, and starts by sending zeros. The driver, the
robot and a localiser are started elsewhere.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PythonExpression
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

ARGUMENTS = {
    "robot": ("turtlebot3_burger", "name of the robot, or the path of its .yaml file"),
    "mover_speed": ("0.0", "largest speed of people and other robots around [m/s]"),
    "use_map": ("false", "whether the topic map tells what never moves"),
    "min_echo_share": ("0.3", "share of beams with an echo below which the robot stands; 0.0 in the open"),
    "largest_gap": ("2.1", "widest angle without echoes ahead in which the robot drives; 6.3 in the open [rad]"),
    "pose": ("tf", "where the pose on the map comes from: tf, amcl_pose or odometry"),
    "stamped": ("true", "velocities are TwistStamped (Jazzy), else Twist (Humble)"),
    "largest_speed": ("", "speed above which the watchdog refuses a command [m/s]; empty for the robot's"),
    "timeout": ("0.5", "age of the last command that stops the robot [s]"),
    "watchdog": ("true", "whether to start the watchdog; false where another launch file starts it"),
    "use_sim_time": ("false", "whether time is that of the topic clock, as beside a simulator"),
}


def generate_launch_description() -> LaunchDescription:
    """Return the launch description of filter and watchdog."""
    given = {name: LaunchConfiguration(name) for name in ARGUMENTS}
    both = {
        "enable_stamped_cmd_vel": ParameterValue(given["stamped"], value_type=bool),
        "use_sim_time": ParameterValue(given["use_sim_time"], value_type=bool),
    }
    # The robot's value by default: a launch file cannot omit a parameter.
    own = ("ctrl_rl_core.find_robot('", given["robot"], "').speed")
    limit = PythonExpression(["float('", given["largest_speed"], "' or ", *own, ")"], ["ctrl_rl_core"])
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=meaning)
                for name, (default, meaning) in ARGUMENTS.items()
            ),
            Node(
                package="ctrl_rl_safety",
                executable="safety_filter",
                parameters=[
                    {
                        "robot": ParameterValue(given["robot"], value_type=str),
                        "mover_speed": ParameterValue(given["mover_speed"], value_type=float),
                        "use_map": ParameterValue(given["use_map"], value_type=bool),
                        "min_echo_share": ParameterValue(given["min_echo_share"], value_type=float),
                        "largest_gap": ParameterValue(given["largest_gap"], value_type=float),
                        "pose": ParameterValue(given["pose"], value_type=str),
                        **both,
                    }
                ],
                remappings=[("cmd_vel", "cmd_vel_safe")],
                output="screen",
                respawn=True,
            ),
            Node(
                package="ctrl_rl_core",
                executable="watchdog",
                condition=IfCondition(given["watchdog"]),
                parameters=[
                    {
                        "timeout": ParameterValue(given["timeout"], value_type=float),
                        "robot": ParameterValue(given["robot"], value_type=str),
                        "largest_speed": ParameterValue(limit, value_type=float),
                        **both,
                    }
                ],
                remappings=[("cmd_vel_raw", "cmd_vel_safe")],
                output="screen",
                respawn=True,
            ),
        ]
    )
