"""Shipped policies: how they are found and described, and their pages on the site."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from ctrl_rl_core.io import add_results, kind_of, raise_as, read_experiment
from ctrl_rl_core.policies import describe_policy, policy_digest, shipped_policies

import option_coordinator
from ctrl_rl_bringup.cards.card import Card
from ctrl_rl_bringup.cards.success import ENGINES, NOMINAL, digests_of, read_team_figures, success_of
from ctrl_rl_core import PolicyDescription, PolicyError, Result

_METRIC = "largest difference"
TRANSFER, ONNX, TEAM = "transfer.json", "onnx.json", "options_{task}.json"
"""Results files: success of policies, exactness of their models, training of a team."""
_TEAM_KEY = "option_policy"
"""Header key of the policies of teams."""
_HEAD = """# Policy zoo

The policies that ship with the suite; each has a card with its origin, limits and interface. Success is that of nominal
drives, with the 95 % interval, from [the results](../results.md). `ros2 run ctrl_rl_bringup export NAME --onnx` takes a
policy out as an ONNX model ([how](../howto/any_policy.md#take-a-policy-out-as-onnx)); the last column is the model's
largest difference from the policy on 1,000 observations, relative to the range of its output.

| policy | robot | task | trained by | PyBullet | MuJoCo | the node drives by its ONNX | difference |
|---|---|---|---|---|---|---|---|
"""


def all_shipped() -> dict[str, Path]:
    """Return all shipped policies by name, those of teams included."""
    return shipped_policies() | option_coordinator.shipped_policies()


def describe(file: Path) -> PolicyDescription:
    """Describe a policy of any kind, those of teams included.

    Raises:
        CtrlRlError: The file has no policy, or one that cannot be exported.
    """
    with raise_as(PolicyError, file):
        of_a_team = file.suffix == ".safetensors" and _TEAM_KEY in kind_of(file)
    return option_coordinator.describe_policy(file) if of_a_team else describe_policy(file)


def make_card(
    name: str,
    file: Path,
    description: PolicyDescription,
    results: Path | None,
    task: str | None = None,
    difference: float | None = None,
) -> Card:
    """Return a policy's card, with the figures that results files have of it.

    Args:
        name: Name of the policy.
        file: Its file.
        description: Its description.
        results: Results file of `transfer`; a team's results are read from the same folder.
        task: Task to read success in; by default that of the policy's file.
        difference: Largest difference of its ONNX model.

    Raises:
        CtrlRlError: A results file cannot be read.
    """
    shipped = all_shipped().get(name) == file
    team = None if results is None else results.parent / TEAM.format(task=description.training.get("task"))
    figures = read_team_figures(team, description.training) if shipped and team is not None and team.exists() else []
    success = success_of(description, file, results, task)
    return Card(name, file, description, shipped, success, figures if description.manifest is None else (), difference)


def write_differences(results: Path, differences: Mapping[str, tuple[str, float]]) -> None:
    """Add models' largest differences to a results file.

    Args:
        results: File to write; it need not exist.
        differences: Digest of the policy's file and the difference, by name of the policy.

    Raises:
        CtrlRlError: The file cannot be read.
    """
    before = read_experiment(results) if results.exists() else None
    digests = digests_of(before) | {name: digest for name, (digest, _) in differences.items()}
    rows = [Result(name, _METRIC, "1", [difference]) for name, (_, difference) in differences.items()]
    add_results(results, "onnx", [0], rows, {"digests": digests})


def read_differences(results: Path) -> dict[str, float]:
    """Return models' largest differences from a results file, by digest of the policy's file.

    Raises:
        CtrlRlError: The file cannot be read.
    """
    experiment = read_experiment(results)
    digests = digests_of(experiment)
    rows = experiment.rows if experiment is not None else []
    return {digests[row.method]: row.mean for row in rows if row.metric == _METRIC and row.method in digests}


def zoo_pages(folder: Path) -> dict[str, str]:
    """Return the pages of shipped policies by file name: the table and the cards.

    Args:
        folder: Folder of the results files.

    Raises:
        CtrlRlError: A file cannot be read.
    """
    found = read_differences(folder / ONNX)
    cards = [
        make_card(name, file, describe(file), folder / TRANSFER, difference=found.get(policy_digest(file)))
        for name, file in all_shipped().items()
    ]
    return {"policies.md": _table(cards), **{f"policy_{card.name}.md": card.text() for card in cards}}


def _table(cards: Sequence[Card]) -> str:
    lines = []
    for card in cards:
        description = card.description
        manifest, difference = description.manifest, card.difference
        shares = card.success.shares if card.success is not None else {}
        cells = [
            f"[{card.name}](policy_{card.name}.md)",
            "a team" if manifest is None else manifest.robot.replace("_", " "),
            f"`{description.training.get('task')}`",
            card.method,
            *(str(shares.get((engine, NOMINAL), "see its card")) for engine in ENGINES),
            "yes" if manifest is not None else "no, a coordinator grants options",
            "" if difference is None else f"{difference:.1e}",
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return _HEAD + "\n".join(lines) + "\n"
