"""Launch file with navigator, safety filter and watchdog for a real robot.

Run it with `ros2 launch ctrl_rl_navigation navigation.launch.py map:=office.yaml`. The navigator commands on
cmd_vel_raw, the filter sends what is safe of it on cmd_vel_safe, and only the watchdog talks to the robot, on cmd_vel.
The watchdog stops the robot when a node before it dies; it is restarted if it dies itself, and starts by sending zeros.
Without `map`, it comes from another node on the topic `map`; a localiser (AMCL, slam_toolbox) is started elsewhere.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.conditions import IfCondition
from launch.launch_description_sources import PythonLaunchDescriptionSource
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
    "actions": ("all", "actions of Nav2 to serve: navigate, follow_path (under Nav2's planner), all or none"),
    "filter": ("true", "whether the safety filter stands between navigator and watchdog"),
    "mover_speed": ("0.0", "largest speed of people and other robots around, for the filter [m/s]"),
    "use_map": ("false", "whether the topic map tells the filter what never moves"),
    "watchdog": ("true", "whether to start the watchdog; false where another launch file starts it"),
    "use_sim_time": ("false", "whether time is that of the topic clock, as beside a simulator"),
    "rviz": ("false", "whether to start RViz"),
}
_FILTER = ("robot", "mover_speed", "use_map", "pose", "stamped", "timeout", "use_sim_time")
_IN_THE_OPEN = {"min_echo_share": "0.02", "largest_gap": "6.3", "watchdog": "false"}
"""Arguments of the filter: a hall on the map may be wider than the lidar's range."""


def generate_launch_description() -> LaunchDescription:
    """Return the launch description of map server, navigator, filter, watchdog and optionally RViz."""
    given = {name: LaunchConfiguration(name) for name in ARGUMENTS}
    stamped = ParameterValue(given["stamped"], value_type=bool)
    clock = {"use_sim_time": ParameterValue(given["use_sim_time"], value_type=bool)}
    view = PathJoinSubstitution([FindPackageShare("ctrl_rl_navigation"), "config", "navigation.rviz"])
    robot = ParameterValue(given["robot"], value_type=str)
    # The robot's value by default: a launch file cannot omit a parameter.
    own = ("ctrl_rl_core.find_robot('", given["robot"], "').plan.speed")
    fastest = PythonExpression(["float('", given["max_speed"], "' or ", *own, ")"], ["ctrl_rl_core"])
    last = PythonExpression(["'cmd_vel_safe' if '", given["filter"], "'.lower() in ('true', '1') else 'cmd_vel_raw'"])
    safety = PathJoinSubstitution([FindPackageShare("ctrl_rl_safety"), "launch", "safety_filter.launch.py"])
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
                remappings=[("cmd_vel_raw", last)],
                output="screen",
                respawn=True,
            ),
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource(safety),
                launch_arguments=[*_IN_THE_OPEN.items(), *((name, given[name]) for name in _FILTER)],
                condition=IfCondition(given["filter"]),
            ),
            Node(
                package="ctrl_rl_navigation",
                executable="navigator",
                parameters=[
                    {
                        "enable_stamped_cmd_vel": stamped,
                        "pose": ParameterValue(given["pose"], value_type=str),
                        "actions": ParameterValue(given["actions"], value_type=str),
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
