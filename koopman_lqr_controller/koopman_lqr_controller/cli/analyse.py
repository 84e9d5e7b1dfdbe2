"""The command `analyse`: a page with figures from a control-theoretic analysis of a policy file."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from ctrl_rl_core.command import at_least, checked, folder_to_write, make_command, what_to_install

from ctrl_rl_core import CtrlRlError, atomic_write
from koopman_lqr_controller.cli.bag_options import PolicyOption, TopicOptions, read_segments
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.identification.evaluation import time_step_mismatch
from koopman_lqr_controller.policies.policy_file import digest, find_policy, load_policy

OptionalFolderToWrite = Annotated[Path | None, checked(folder_to_write, "FOLDER")]
"""Optional output folder."""
_PAGE, _DATA = "analysis.md", "analysis.json"


_MORE = """The folder then holds analysis.md, its pictures, and analysis.json, which they are made from.
Parts that need an environment or a bag are left out where there is none, with a line that says so.

Example:
  analyse runs/koopman/cartpole_swingup-s0/policy.safetensors"""


@dataclass(frozen=True, kw_only=True)
class AnalyseOptions(TopicOptions, PolicyOption):
    """Write a control-theoretic analysis of a policy: poles, controllability, costs, prediction, closed loop."""

    output: OptionalFolderToWrite = None
    """Output folder; by default the policy's name with the suffix "-analysis"."""

    bags: tuple[Path, ...] = ()
    """rosbag2 folders whose drives are used to measure the prediction; by default episodes in the environment."""

    episodes: at_least(1) = 6  # type: ignore[valid-type]
    """Number of episodes in the environment."""


def _analyse(options: AnalyseOptions) -> int:
    file = find_policy(options.policy)
    policy = load_policy(file)
    from tqdm import tqdm

    from koopman_lqr_controller.training.analysis.page import page
    from koopman_lqr_controller.training.analysis.plots import draw_all
    from koopman_lqr_controller.training.analysis.policy_analysis import analyse as find
    from koopman_lqr_controller.training.analysis.policy_world import EpisodeTrajectory, make_world

    segments = read_segments(options.bags, options, policy.observation_fn) if options.bags else []
    recorded = [
        EpisodeTrajectory(segment.x, policy.to_controls(segment.u), segment.u[:, 0] * 0.0, {}) for segment in segments
    ]
    world: Any = None
    try:
        world = make_world(policy)
    except ModuleNotFoundError as error:
        world = KoopmanError(what_to_install(str(error.name)))
    except CtrlRlError as error:
        world = error
    try:
        with tqdm(desc="analysing", unit="part", disable=None) as bar:

            def on_progress(what: str) -> None:
                bar.set_postfix_str(what)
                bar.update()

            found = find(policy, world, recorded, options.episodes, on_progress)
    finally:
        if not isinstance(world, CtrlRlError):
            world.close()
    folder = options.output or Path(f"{file.stem}-analysis")
    folder.mkdir(parents=True, exist_ok=True)
    atomic_write(folder / _DATA, json.dumps({"file": file.name, "digest": digest(file), **found}) + "\n")
    atomic_write(folder / _PAGE, page(found, file.name, draw_all(found, folder)))
    for row in found.get("limits", {}).get("rows", ()):
        over_best = row["model"] / max(row["linear_floor"], 1e-12)
        print(
            f"one step   {row['model']:.2f} of persistence, {over_best:.2f} of the best linear model; noise alone "
            f"{row['noise_floor']:.2f} (disturbance: {row['name']}, noise in the actions {row['noise']:g})"
        )
    for part, reason in found["left_out"].items():
        print(f"left out   {part}: {reason}")
    told = time_step_mismatch(policy, segments) if segments else ""
    if told:
        print(told)
    print(f"page       {folder / _PAGE}")
    return 0


analyse = make_command("analyse", AnalyseOptions, _analyse, _MORE)
