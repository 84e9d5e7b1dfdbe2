"""ros2 launch ctrl_rl_bringup robot.launch.py [policy:=... | navigate:=true] [filter:=...]: drives a real robot.

A policy's controller, or the navigator with navigate:=true, commands on cmd_vel_raw; with filter:=true, the default of
the navigator, the safety filter sends safe commands on cmd_vel_safe; only the watchdog talks to the robot, on cmd_vel.
It stops the robot if the nodes before it die. If it dies itself it is restarted, and begins with zeros. record:=true
adds a bag of the drive, view:=true a page in the browser, and params:=FILE the parameters that are no arguments.
"""

from launch import LaunchDescription, Substitution
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.conditions import IfCondition, UnlessCondition
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution, PythonExpression
from launch_ros.actions import Node, SetParametersFromFile
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from koopman_lqr_controller import DEFAULT_POLICY

ARGUMENTS = {
    "robot": ("turtlebot3_burger", "name of the robot, or the path of its .yaml file"),
    "policy": (DEFAULT_POLICY, "policy name or file of the controller, which drives unless navigate:=true"),
    "navigate": ("false", "whether the navigator drives to goals on a map instead"),
    "filter": (LaunchConfiguration("navigate"), "whether the safety filter stands before the watchdog"),
    "stamped": ("true", "cmd_vel is a TwistStamped (Jazzy), else a Twist (Humble)"),
    "timeout": ("0.5", "age of the last command that stops the robot [s]"),
    "commands": (
        "cmd_vel_raw",
        "topic that the controller commands on; cmd_vel_auto where twist_mux is in between",
    ),
    "dry_run": ("false", "compute commands of the controller, but send none"),
    "max_distance": ("0.0", "distance after which the controller stands [m]; 0.0 for any"),
    "map": ("", "map of the navigator: map_server's .yaml file; empty for the topic map"),
    "pose": ("tf", "where the pose on the map comes from: tf (map -> base) or amcl_pose"),
    "mover_speed": ("0.0", "maximum speed of people and other robots around, for the filter [m/s]"),
    "use_map": ("false", "whether the topic map tells the filter what never moves"),
    "record": ("false", "whether to record a bag"),
    "bag": ("", "folder of the bag; empty for bag_<date>-<time> in the working folder"),
    "view": ("false", "whether to show the robot in the browser, on port 8080 of this computer"),
    "params": ("", "YAML file with parameters of the nodes; arguments take precedence"),
    "use_sim_time": ("false", "whether time is that of the topic clock, as beside a simulator"),
}
_NAVIGATION = ("map", "pose", "robot", "filter", "mover_speed", "use_map", "stamped", "timeout", "use_sim_time")
_FILTER = ("robot", "mover_speed", "use_map", "pose", "stamped", "timeout", "use_sim_time")


def generate_launch_description() -> LaunchDescription:
    """Return the driver, the filter if wanted, and the watchdog."""
    given = {name: LaunchConfiguration(name) for name in ARGUMENTS}
    stamped = ParameterValue(given["stamped"], value_type=bool)
    clock = ParameterValue(given["use_sim_time"], value_type=bool)
    robot = ParameterValue(given["robot"], value_type=str)
    filters, navigates = (("'", given[name], "'.lower() in ('true', '1')") for name in ("filter", "navigate"))
    last = PythonExpression(["'cmd_vel_safe' if ", *filters, " else 'cmd_vel_raw'"])
    alone = PythonExpression([*filters, " and not ", *navigates])
    has_file = PythonExpression(["'", given["params"], "' != ''"])
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=meaning)
                for name, (default, meaning) in ARGUMENTS.items()
            ),
            SetParametersFromFile(given["params"], condition=IfCondition(has_file)),
            Node(
                package="ctrl_rl_core",
                executable="watchdog",
                parameters=[
                    {
                        "enable_stamped_cmd_vel": stamped,
                        "robot": robot,
                        "timeout": ParameterValue(given["timeout"], value_type=float),
                        "use_sim_time": clock,
                    }
                ],
                remappings=[("cmd_vel_raw", last)],
                output="screen",
                respawn=True,
            ),
            Node(
                package="koopman_lqr_controller",
                executable="controller",
                parameters=[
                    {
                        "enable_stamped_cmd_vel": stamped,
                        "robot": robot,
                        "policy": ParameterValue(given["policy"], value_type=str),
                        "dry_run": ParameterValue(given["dry_run"], value_type=bool),
                        "max_distance": ParameterValue(given["max_distance"], value_type=float),
                        "use_sim_time": clock,
                    }
                ],
                remappings=[("cmd_vel", given["commands"])],
                condition=UnlessCondition(given["navigate"]),
                output="screen",
            ),
            _included("ctrl_rl_navigation", "navigation", given["navigate"], _NAVIGATION),  # with a filter of its own
            _included("ctrl_rl_safety", "safety_filter", alone, _FILTER),
            Node(
                package="ctrl_rl_bags",
                executable="recorder",
                parameters=[{"output": ParameterValue(given["bag"], value_type=str), "use_sim_time": clock}],
                condition=IfCondition(given["record"]),
                output="screen",
            ),
            Node(
                package="ctrl_rl_bringup",
                executable="view",
                arguments=["--robot", given["robot"]],
                parameters=[{"enable_stamped_cmd_vel": stamped, "use_sim_time": clock}],
                condition=IfCondition(given["view"]),
                output="screen",
            ),
        ]
    )


def _included(package: str, file: str, wanted: Substitution, handed_on: tuple[str, ...]) -> IncludeLaunchDescription:
    """Include another launch file without its watchdog: a robot has only one."""
    path = PathJoinSubstitution([FindPackageShare(package), "launch", f"{file}.launch.py"])
    arguments = {name: LaunchConfiguration(name) for name in handed_on}
    return IncludeLaunchDescription(
        PythonLaunchDescriptionSource(path),
        launch_arguments=[("watchdog", "false"), *arguments.items()],
        condition=IfCondition(wanted),
    )
