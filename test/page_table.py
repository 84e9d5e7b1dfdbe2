"""What a test has to know of each page with shell commands: see `pages.Page`."""

from pages import Page

ROBOT = "a real robot, or a device of it"
ROS = "an installed ROS 2, of which the wheels have no tool but `ros2 run`"
ROOT = "the rights of root"
NETWORK = "the internet: packages or data from elsewhere"
MACHINES = "a second computer"
HOURS = "hours of a computer, and has no smaller budget"
ITSELF = "this very test, or all others"
CHANGES = "an environment that may be changed or built anew"
REASONS = (ROBOT, ROS, ROOT, NETWORK, MACHINES, HOURS, ITSELF, CHANGES)
"""Why a command is not run: it needs one of these."""

_BRIDGE = "ros2 run sim_bridge bridge --ros-args -p task:="
_DRIVES = "ros2 run ctrl_rl_bringup record_drives --episodes 3 --speed 8 --output runs/drives\n"
_LOOP = "ros2 run ctrl_rl_trials loop --folder runs/first"
_TEAM = """
ros2 run option_coordinator loop --folder first --seeds 1 --rounds 1 --episodes 20 --tests 1
learnt=$(echo first/tool_delivery-s0/round_1/learning/*/policy.safetensors)
"""


def _robot(task: str) -> str:
    """Return the shell line that starts a simulated robot in a task."""
    return f"terminal bridge '{_BRIDGE}{task}'\n"


PAGES = {
    "CONTRIBUTING.md": Page(
        0.0,
        skipped={"make build ": CHANGES, "make lint ": ITSELF, "make test ": ITSELF, "make docs ": NETWORK},
    ),
    "README.md": Page(60.0, skipped={"pip install": NETWORK, "make test ": ITSELF}),
    "docs/bags.md": Page(
        60.0,
        before="ros2 run ctrl_rl_bringup record_drives --episodes 2 --speed 8 --output runs/corridor\n"
        + _TEAM
        + "cp -r first/tool_delivery-s0/round_0/bag runs/team_bag; cp $learnt team.safetensors\n"
        + _robot("curved_corridor"),
        between={"ros2 run ctrl_rl_bags recorder": "sleep 5; stop 'ctrl_rl_bags recorder'"},
    ),
    "docs/explanation/ladder.md": Page(
        300.0,
        smaller={"ros2 run ctrl_rl_trials train": "--samples 2048"},
        skipped={"make ladder ": HOURS},
    ),
    "docs/few_frames.md": Page(600.0),
    "docs/howto/any_policy.md": Page(
        600.0,
        before=_robot("car_ttr")
        + "mkdir -p runs/mine && cp $(python -c 'import ctrl_rl_core.policies as p; print(p.__path__[0])')"
        + "/pretrained/car_ttr.safetensors runs/mine/policy.safetensors\n",
        between={
            "ros2 run ctrl_rl_core policy --ros-args -p policy:=runs/mine": "sleep 2; stop_all",
            "ros2 run ctrl_rl_core policy --ros-args -p policy:=runs/onnx": "sleep 2; stop_all",
        },
        smaller={
            "ros2 run ctrl_rl_learning teach": "--seeds 1 --samples 4000",
            "ros2 run ctrl_rl_bringup transfer": "--seeds 1",
        },
        skipped={
            "ros2 run ctrl_rl_core policy --ros-args -p policy:=drlnav.onnx": NETWORK,
            "ros2 param ": ROS,
            "ros2 topic ": ROS,
            "python -m pip": NETWORK,
        },
    ),
    "docs/howto/barn.md": Page(0.0, skipped={"git clone": NETWORK, "ros2 run ctrl_rl_trials barn": NETWORK}),
    "docs/howto/datasets.md": Page(40.0, before=_DRIVES, skipped={"python -m pip": NETWORK}),
    "docs/howto/installed_ros.md": Page(0.0, skipped={"source /opt/ros/jazzy/setup.bash\npython3": ROS}),
    "docs/howto/learn_offline.md": Page(
        900.0,
        before=f"{_LOOP} --seeds 1 --rounds 1 --tests 1 --updates 1\n"
        "mkdir -p runs/drives runs/hall && cp -r runs/first/car_navigation-value_model-s0/round_0/bag runs/drives/bag\n"
        "sed 's/^name: .*/name: hall/' "
        '"$(python -c \'from ctrl_rl_core import task_file; print(task_file("car_navigation"))\')" > hall.yaml\n'
        f"{_LOOP} --tasks hall.yaml --seeds 1 --rounds 1 --tests 1 --updates 1\n"
        "cp -r runs/first/hall-value_model-s0/round_0/bag runs/hall/bag\n" + _robot("car_navigation"),
    ),
    "docs/howto/many_machines.md": Page(
        0.0,
        skipped={"python -m pip": NETWORK, "ray ": MACHINES, "ros2 run option_coordinator train": MACHINES},
    ),
    "docs/howto/nav2.md": Page(40.0, files={"application.py": 0}, skipped={"# on a robot with Nav2": ROBOT}),
    "docs/howto/navigate.md": Page(
        12.0,
        smaller={"ros2 run ctrl_rl_navigation trials": "--goals 1"},
        skipped={
            "ros2 run nav2_map_server": ROBOT,
            "ros2 launch": ROS,
            "ros2 run sim_bridge bridge &\nros2 launch": ROS,
            "ros2 service": ROS,
        },
    ),
    "docs/howto/own_driver.md": Page(60.0, before=_robot("curved_corridor"), files={"gap.py": 0, "gap_node.py": 1}),
    "docs/howto/own_robot.md": Page(
        300.0,
        before="""
maps=$(python -c 'import ctrl_rl_navigation.maps as maps; print(maps.__path__[0])')
cp "$maps"/maze.yaml office.yaml; cp "$maps"/maze.pgm .
sed 's/name: .*/name: courier_room/; s/body: .*/body: courier.yaml/' \
  "$(python -c 'from ctrl_rl_core import task_file; print(task_file("curved_corridor"))')" > courier_room.yaml
export PYTHONPATH=$PWD/packages:$PYTHONPATH
"""
        + _robot("courier_room.yaml"),
        files={"courier.yaml": 0},
        between={
            "ros2 run ctrl_rl_navigation navigator": "stop 'ctrl_rl_navigation navigator'",
            "ros2 run ctrl_rl_safety safety_filter": "stop 'ctrl_rl_safety safety_filter'",
        },
        smaller={
            "ros2 run ctrl_rl_navigation trials": "--goals 1",
            "pip install": "--no-deps --no-build-isolation --target packages",
            "ros2 run ctrl_rl_trials train": "--samples 2048",
        },
    ),
    "docs/howto/real_robot.md": Page(
        30.0, before=_robot("curved_corridor"), skipped={"ros2 launch turtlebot3": ROBOT, "ros2 launch": ROS}
    ),
    "docs/howto/robot_learning.md": Page(
        300.0,
        between={"ros2 run ctrl_rl_learning fine_tune": "stop_all"},
        smaller={
            "ros2 run ctrl_rl_learning fine_tune": "--minutes 0.3",
            "ros2 run ctrl_rl_trials shift_study": "--seeds 1 --minutes 0.3 --tests 1",
        },
        skipped={"# on the robot\nros2 run ctrl_rl_safety": ROBOT, "ros2 run teleop_twist_keyboard": ROBOT},
    ),
    "docs/howto/safe_sets.md": Page(20.0),
    "docs/howto/safety_filter.md": Page(
        300.0,
        between={
            'make demo ARGS="--filter --task quad_ttr': _robot("curved_corridor"),
            "ros2 run ctrl_rl_core watchdog": "stop_all\n" + _robot("quad_ttr"),
        },
        skipped={"ros2 launch": ROS},
    ),
    "docs/howto/safety_measure.md": Page(
        900.0,
        before=_robot("car_navigation"),
        between={"ros2 run ctrl_rl_bags recorder": "python test/drive_about.py; stop 'ctrl_rl_bags recorder'"},
        smaller={
            "ros2 run ctrl_rl_safety trials": "--episodes 1",
            "ros2 run ctrl_rl_safety train": "--seeds 1 --samples 2048",
        },
    ),
    "docs/howto/shell.md": Page(1.0),
    "docs/howto/view.md": Page(
        0.0,
        skipped={"python -m pip": NETWORK, "ros2 run ctrl_rl_bringup view": NETWORK, "ssh ": MACHINES},
    ),
    "docs/index.md": Page(60.0, skipped={"make test ": ITSELF}),
    "docs/installation.md": Page(0.0, skipped={"pip install": NETWORK, "docker ": NETWORK, "sudo ": ROOT}),
    "docs/security.md": Page(
        0.0, skipped={"export ROS_AUTOMATIC": MACHINES, "ros2 security create_keystore keys\nros2 security": ROS}
    ),
    "docs/tutorials/bag_to_policy.md": Page(120.0),
    "docs/tutorials/burger_guide.md": Page(
        240.0,
        skipped={
            "# robot\nsudo apt": ROOT,
            "# robot (on the computer": ROBOT,
            "# robot and computer": ROBOT,
            "# robot\nros2 launch turtlebot3": ROBOT,
            "# robot\nros2 run twist_mux": ROBOT,
            "# computer: the command": ROS,
            "# robot; if twist_mux": ROBOT,
        },
    ),
    "docs/howto/work.md": Page(20.0, files={"order.py": 0}, skipped={"ros2 service": ROS, "ros2 topic": ROS}),
    "docs/tutorials/first_drive.md": Page(120.0),
    "docs/tutorials/own_corridor.md": Page(120.0),
    "docs/tutorials/own_system.md": Page(25.0),
    "docs/tutorials/own_team.md": Page(180.0),
    "docs/tutorials/train_compare_plot.md": Page(180.0),
    "koopman_lqr_controller/README.md": Page(
        1500.0,
        before="ros2 run ctrl_rl_bringup record_drives --episodes 6 --speed 8 --output runs/drives\n"
        "sed 's/name: .*/name: mine/' "
        '"$(python -c \'from ctrl_rl_core import task_file; print(task_file("curved_corridor"))\')" > mine.yaml\n'
        + _robot("curved_corridor"),
        between={"ros2 run koopman_lqr_controller controller": "sleep 2; stop_all"},
        smaller={
            ".venv/bin/python test/stops.py": "--starts 1",
            "ros2 run ctrl_rl_bringup trials": "--seeds 1 --at-least 0",
        },
        skipped={
            "ros2 launch turtlebot3": ROBOT,
            "ros2 topic ": ROS,
            "ros2 param ": ROS,
            "make koopman ": HOURS,
        },
    ),
    "option_coordinator/README.md": Page(
        600.0,
        before=_TEAM
        + """
mkdir -p runs/mine && cp -r first/tool_delivery-s0/round_0/bag runs/mine/bag; cp $learnt policy.safetensors
sed 's/^name: .*/name: my_team/' \
  "$(python -c 'from option_coordinator import team_file; print(team_file("delivery_team"))')" > my_team.yaml
""",
        between={"ros2 run option_coordinator coordinator --ros-args -p team": "stop_all"},
        smaller={"ros2 run option_coordinator train --task": "--seeds 1"},
        skipped={"ros2 launch": ROS, "ros2 param ": ROS},
    ),
    "ttr_reward_node/README.md": Page(15.0, before=_robot("car_ttr"), skipped={"make ttr ": HOURS}),
}
