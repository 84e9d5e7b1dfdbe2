"""The command `export`: writes a policy's card and, with --onnx, its ONNX model and manifest."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import tyro
import yaml
from ctrl_rl_core.command import FolderToWrite, OptionalFileToWrite, make_command
from ctrl_rl_core.networks import to_onnx
from ctrl_rl_core.policies import OBSERVATIONS, TOLERANCE, largest_difference, policy_digest

from ctrl_rl_bringup.cards.zoo import TRANSFER, all_shipped, describe, make_card, write_differences
from ctrl_rl_core import CommandError, PolicyDescription, atomic_write, find_policy, load_policy

_RESULTS = Path("docs/results") / TRANSFER


@dataclass(frozen=True)
class ExportOptions:
    """Write a policy's card, NAME.md, and with --onnx its model, NAME.onnx, and manifest, NAME.yaml."""

    policies: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="POLICY...")] = ()
    """Names of shipped policies, or files; all that are shipped unless given."""

    onnx: bool = False
    """Write ONNX models too; each is compared with its policy, and refused if they differ."""

    output: FolderToWrite = Path()
    """Folder to write to."""

    overwrite: bool = False
    """Replace files that exist."""

    transfer: Path | None = None
    """Results of `transfer` that hold the policy's success; docs/results/transfer.json unless given, if it is there."""

    task: str | None = None
    """Task of those results, by name or file; the task that the policy was trained on unless given."""

    results: OptionalFileToWrite = None
    """JSON file to write the models' largest differences to; rows of other policies stay in it."""


def _export(options: ExportOptions) -> int:
    if options.results is not None and not options.onnx:
        raise CommandError("--results holds the differences of ONNX models: give --onnx too")
    if options.transfer is not None and not options.transfer.is_file():
        raise CommandError(f"--transfer {options.transfer}: there is no such file")
    files = _files(options.policies)
    suffixes = (".onnx", ".yaml", ".md") if options.onnx else (".md",)
    for path in (options.output / f"{name}{suffix}" for name in files for suffix in suffixes):
        if path.exists() and not options.overwrite:
            raise CommandError(f"{path} exists: give another folder, or --overwrite to replace it")
    differences = {}
    for name, file in files.items():
        difference = _export_one(name, file, options)
        if difference is not None:
            differences[name] = policy_digest(file), difference
    if options.results is not None:
        write_differences(options.results, differences)
    return 0


def _files(words: tuple[str, ...]) -> dict[str, Path]:
    """Return the files to export, by name.

    Raises:
        CtrlRlError: There is no such policy, or two have the same name.
    """
    shipped = all_shipped()
    if not words:
        return shipped
    files: dict[str, Path] = {}
    for word in words:
        file = shipped[word] if word in shipped else find_policy(word)
        name = file.absolute().parent.name if file.stem == "policy" else file.stem
        if name in files:
            raise CommandError(f"two policies are called {name}: export them to two folders")
        files[name] = file
    return files


def _export_one(name: str, file: Path, options: ExportOptions) -> float | None:
    """Write the files of a policy; return the largest difference of its model, if one was asked for.

    Raises:
        CtrlRlError: The policy cannot be exported, or its model differs from it.
    """
    description = describe(file)
    contents: dict[str, bytes | str] = {}
    difference = None
    if options.onnx:
        contents, difference = _model(name, file, description)
    results = options.transfer if options.transfer is not None else _RESULTS
    contents[f"{name}.md"] = make_card(name, file, description, results, options.task, difference).text()
    options.output.mkdir(parents=True, exist_ok=True)
    for each, content in contents.items():
        atomic_write(options.output / each, content)
    print(f"policy     {', '.join(str(options.output / each) for each in contents)}")
    if difference is not None:
        print(f"           differs by at most {difference:.1e} of its range on {OBSERVATIONS:,} random observations")
    if description.manifest is None:
        print("           no node drives by it, see Limits in its card")
    elif options.onnx:
        print(f"try it     ros2 run ctrl_rl_core policy --ros-args -p policy:={options.output / name}.onnx")
    return difference


def _model(name: str, file: Path, description: PolicyDescription) -> tuple[dict[str, bytes | str], float]:
    """Return a policy's model and manifest by file name, loaded once as the node loads them, and their difference.

    Raises:
        CtrlRlError: The policy has layers that ONNX has not, or its model differs from it.
    """
    about = {"policy": name, "sha256": policy_digest(file), "task": str(description.training.get("task", ""))}
    model = to_onnx(description.network, name, about)
    difference = largest_difference(description, model)
    if not difference <= TOLERANCE:
        raise CommandError(f"{name}: its ONNX model differs by {difference:.1e} of its range: nothing was written")
    contents: dict[str, bytes | str] = {f"{name}.onnx": model}
    if description.manifest is not None:
        manifest = description.manifest.model_dump(mode="json", exclude_defaults=True)
        manifest["observation"] = [{"source": part["source"], **part} for part in manifest["observation"]]
        contents[f"{name}.yaml"] = yaml.safe_dump(manifest, sort_keys=False, width=120)
        with TemporaryDirectory(prefix="export-") as folder:
            for each, content in contents.items():
                atomic_write(Path(folder) / each, content)
            load_policy(Path(folder) / f"{name}.onnx")
    return contents, difference


export = make_command("export", ExportOptions, _export)
