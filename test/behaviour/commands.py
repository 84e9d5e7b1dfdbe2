"""Every command line that is run, in one table: where a command, an option or a file gets another name, adapt it here.

All file names are of the folder that the commands run in; a name with * stands for the files that match.
"""

from __future__ import annotations

from pathlib import Path

from case import Case

_ONE_RUN = "--seeds 1 --workers 1"
_TASK = f"--task {Path(__file__).with_name('light_car.yaml')}"
_REWARDS = f"ttr_reward_node train {_TASK} --grid solved.safetensors --rewards ttr --iterations 1 {_ONE_RUN}"
_BASELINES = f"oc_baseline_node train {_TASK} --value fitted.safetensors --iterations 1 {_ONE_RUN}"
_KOOPMAN = (
    f"koopman_lqr_controller learn --task cartpole_swingup {_ONE_RUN} --chunks 2 --actions 60 --episodes 1 "
    "--set batch=16 hidden=16 latent=6 first_steps=30"
)
_OPTIONS = f"option_coordinator train {_ONE_RUN} --evaluations 2"
_QUADROTOR = "ttr_reward_node solve --task quad_ttr --count x=11 v_x=9 z=11 v_z=9 psi=11 omega=5"
_RUN = ("*/*.safetensors", "*/result.json")
"""What a run of learning leaves in its folder."""


def _learning(name: str, command: str, after: tuple[str, ...] = ()) -> Case:
    """Return a case that learns in a folder of its name."""
    outputs = (f"{name}.json", *(f"{name}/{each}" for each in _RUN))
    return Case(name, f"{command} --folder {name} --results {name}.json", outputs, after)


def _from_bags(name: str, options: str) -> Case:
    """Return a case that learns from the bag of the coordinated team."""
    name = f"options_{name}"
    command = f"option_coordinator train --bags team --task delivery_team --evaluations 1 {options} --folder {name}"
    return Case(name, command, tuple(f"{name}/{each}" for each in _RUN), ("team_coordinated",))


CASES = (
    # Time to reach.
    Case("solve", f"ttr_reward_node solve {_TASK} --output solved.safetensors", ("solved.safetensors",)),
    Case(
        "solve_3d_car",
        "ttr_reward_node solve --task car_ttr --count x=31 y=31 theta=24 --robot-size --output car.safetensors",
        ("car.safetensors",),
    ),
    Case(
        "solve_lax_friedrichs",
        f"ttr_reward_node solve {_TASK} --method lax_friedrichs --count x=21 y=21 theta=16 --output lf.safetensors",
        ("lf.safetensors",),
    ),
    Case(
        "solve_disturbed",
        f"ttr_reward_node solve {_TASK} --disturbance d_x=-0.1:0.1 --output disturbed.safetensors",
        ("disturbed.safetensors",),
    ),
    Case(
        "solve_corridor",
        "ttr_reward_node solve --task curved_corridor --robot-size --output corridor.safetensors",
        ("corridor.safetensors",),
    ),
    Case("solve_4d_4d", f"{_QUADROTOR} --decomposition 4d+4d --output 4d.safetensors", ("4d.safetensors",)),
    Case("solve_five", f"{_QUADROTOR} --decomposition five --output five.safetensors", ("five.safetensors",)),
    Case("check", f"ttr_reward_node check solved.safetensors {_TASK} --starts 50", after=("solve",), printed=True),
    Case(
        "relabel",
        f"ttr_reward_node relabel drive labelled --grid solved.safetensors {_TASK} --frame odom",
        ("labelled/",),
        ("drive", "solve"),
    ),
    # Optimal control.
    Case("oc_extract", "oc_baseline_node oc extract car_navigation", printed=True),
    Case("oc_solve", "oc_baseline_node oc solve car_navigation --seed 3", printed=True),
    Case(
        "oc_data",
        f"oc_baseline_node oc data {_TASK.removeprefix('--task ')} --output mpc --trajectories 12 --workers 1",
        ("mpc/*.npz",),
    ),
    Case(
        "oc_fit",
        f"oc_baseline_node oc fit mpc {_TASK} --output fitted.safetensors --grid fit_grid.safetensors --epochs 20 "
        "--results fit.json",
        ("fitted.safetensors", "fit_grid.safetensors", "fit.json"),
        ("oc_data",),
    ),
    # Bags.
    Case("bag_info", "ctrl_rl_core bag info drive", after=("drive",), printed=True),
    Case("bag_recover", "ctrl_rl_core bag recover cut --output recovered", ("recovered/",), ("cut",)),
    # Koopman control from bags.
    Case(
        "koopman_train",
        "koopman_lqr_controller train drive --output edmd.safetensors",
        ("edmd.safetensors",),
        ("drive",),
    ),
    Case(
        "koopman_fit",
        "koopman_lqr_controller fit curved_corridor drive --output refitted.safetensors",
        ("refitted.safetensors",),
        ("drive",),
    ),
    Case(
        "koopman_evaluate",
        "koopman_lqr_controller evaluate edmd.safetensors drive --json judged.json",
        ("judged.json",),
        ("drive", "koopman_train"),
    ),
    Case(
        "koopman_learn_offline",
        "koopman_lqr_controller learn_offline drive --latent 6 --updates 60 --output imitated.safetensors",
        ("imitated.safetensors",),
        ("drive",),
    ),
    # Learning, each method.
    _learning("ttr_ppo", f"{_REWARDS} --algorithms ppo", ("solve",)),
    _learning("ttr_trpo", f"{_REWARDS} --algorithms trpo", ("solve",)),
    _learning("ttr_ddpg", f"{_REWARDS} --algorithms ddpg", ("solve",)),
    *(
        _learning(f"oc_{name}", f"{_BASELINES} --methods {method}", ("oc_fit",))
        for name, method in (
            ("ppo", "ppo"),
            ("baseline", "oc_ppo"),
            ("corrected", "oc_corrected"),
            ("trpo", "oc_trpo"),
            ("stein", "stein"),
            ("q_prop", "q_prop"),
        )
    ),
    _learning("koopman_learn", f"{_KOOPMAN} --consolidation 5"),
    _learning("koopman_two_stage", f"{_KOOPMAN} --consolidation 0 --learner two_stage"),
    _learning("koopman_edmd", f"{_KOOPMAN} --consolidation 0 --learner edmd"),
    _learning("koopman_sac", f"{_KOOPMAN} --consolidation 0 --learner sac"),
    Case(
        "koopman_consolidate",
        "koopman_lqr_controller consolidate koopman_learn/*/policy.safetensors --latent 4 --episodes 1 --live 5 "
        "--output consolidated.safetensors",
        ("consolidated.safetensors",),
        ("koopman_learn",),
    ),
    _learning("options_tool_delivery", f"{_OPTIONS} --task tool_delivery --samples 7500 --methods all"),
    _from_bags("imitation", "--head table"),
    _from_bags("imitation_autoregressive", "--head autoregressive"),
    # Teams in the simulated environment.
    *(
        Case(f"team_{name}", f"option_coordinator replay {options}", after=after, printed=True)
        for name, options, after in (
            ("scripted", "tool_delivery", ()),
            ("random", "tool_delivery --policy random --seed 1", ()),
            ("cut", "tool_delivery --synchronisation cut", ()),
            ("wait", "water_filling --synchronisation wait", ()),
            ("delivery", "delivery_team --policy random --seed 2", ()),
            (
                "learnt",
                "tool_delivery --policy options_tool_delivery/*-async-*/policy.safetensors --seed 3",
                ("options_tool_delivery",),
            ),
        )
    ),
)

_SIMULATED = "-p use_sim_time:=true"
_DRIVER = "-p scan_timeout:=10.0 -p wall_timeout:=600.0 -r cmd_vel:=cmd_vel_raw"
NODES = {
    "bridge": "sim_bridge bridge --ros-args -p start_paused:=true "
    "-r scan:=world/scan -r odom:=world/odom -r cmd_vel:=world/cmd_vel",
    "watchdog": f"ctrl_rl_core watchdog --ros-args {_SIMULATED} -p timeout:=60.0 -p repeat_for:=0.1",
    "controller": f"koopman_lqr_controller controller --ros-args {_SIMULATED} {_DRIVER}",
    "scripted_driver": f"koopman_lqr_controller scripted_driver --ros-args {_SIMULATED} {_DRIVER} -p seed:=3",
    "reward": f"ttr_reward_node reward --ros-args {_SIMULATED} -p grid:=corridor.safetensors",
    "baseline": f"oc_baseline_node baseline --ros-args {_SIMULATED} -p grid:=curved_corridor",
    "coordinator": "option_coordinator coordinator --ros-args -p team:=delivery_team -p policy:=delivery_team "
    "-p seed:=5 -p lost_after:=600.0 -p stale:=600.0 -p policy_limit:=10.0",
}
"""Nodes as processes; waits for a scan are long, so that a busy machine changes nothing."""
AS_REAL = (
    "-p lidar:=lds02 -p scan_dropout:=0.1 -p odom_drift:=0.05 -p command_truncation:=true -p command_delay:=0.1 "
    "-p randomise_width:=true"
)
"""What the bridge does as a real robot does."""
