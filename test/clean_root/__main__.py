"""Run the steps of the Dockerfile in a bare Debian root, without Docker: what a fresh machine needs, takes and weighs.

python test/clean_root ROOT [--suite bookworm] [--bind PATH ...] [--results FILE.json]

It needs the rights of root and debootstrap. Commits alone are copied, as a clone has them.
"""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, NamedTuple

import tyro
from ctrl_rl_core.command import OptionalFileToWrite

from ctrl_rl_core import CtrlRlError, Result, parse_options, run_command, write_results

REPOSITORY = Path(__file__).resolve().parents[2]
_HANDED_ON = ("PIP_", "SSL_", "http_proxy", "https_proxy", "no_proxy", "REQUESTS_CA_BUNDLE")
_OF_THE_MACHINE = (
    *("etc/resolv.conf", "etc/hosts", "etc/apt/sources.list.d", "etc/apt/apt.conf.d"),
    *("etc/pip.conf", "etc/xdg/pip", "root/.config/pip", "usr/local/share/ca-certificates"),
)
"""How this machine reaches packages, relative to its root."""
_MEGABYTE = 1e6


@dataclass(frozen=True)
class Options:
    """Run the steps of the Dockerfile in a bare Debian root."""

    root: Annotated[Path, tyro.conf.Positional]
    """Folder of the root; debootstrap makes it if it does not exist."""
    suite: str = "bookworm"
    """Release of Debian."""
    mirror: str = "http://deb.debian.org/debian"
    """Mirror of Debian's packages."""
    bind: tuple[Path, ...] = ()
    """Folders of this machine that the root may read, such as an index of packages."""
    results: OptionalFileToWrite = None
    """JSON file of the results."""


class Step(NamedTuple):
    """A step of the Dockerfile: its instruction (RUN, COPY or WORKDIR) and the rest of the line."""

    instruction: str
    words: str


def main(options: Options) -> int:
    """Run, measure, print and write."""
    if os.geteuid() != 0:
        raise CtrlRlError("it makes a root and changes into it: run it as root")
    if not options.root.exists():
        _run(["debootstrap", "--variant=minbase", options.suite, str(options.root), options.mirror])
    for name in _OF_THE_MACHINE:
        _copy(Path("/") / name, options.root / name)
    rows = [Result("bare root", "size", "MB", [_size(options.root)])]
    folder = "/"
    for step in steps():
        begin = time.monotonic()
        if step.instruction == "WORKDIR":
            folder = step.words
            (options.root / folder.lstrip("/")).mkdir(parents=True, exist_ok=True)
            continue
        if step.instruction == "COPY":
            archive = subprocess.run(["git", "archive", "HEAD"], cwd=REPOSITORY, check=True, capture_output=True)
            _run(["tar", "-x", "-C", str(options.root / folder.lstrip("/"))], archive.stdout)
        else:
            _run(_changed_root(options, folder, step.words))
        seconds = time.monotonic() - begin
        name = step.words if len(step.words) < 40 else f"{step.words[:37]}..."
        rows += [
            Result(f"{step.instruction} {name}", "time", "s", [seconds]),
            Result(f"{step.instruction} {name}", "size", "MB", [_size(options.root)]),
        ]
        print(f"{step.instruction} {name}: {seconds:.0f} s, {rows[-1].values[0]:.0f} MB", flush=True)
    if options.results is not None:
        write_results(options.results, "Container steps in a bare root", [0], rows)
    return 0


def steps() -> Iterator[Step]:
    """Yield the Dockerfile's steps that change the root, in order."""
    for line in (REPOSITORY / "Dockerfile").read_text(encoding="utf-8").splitlines():
        instruction, _, words = line.partition(" ")
        if instruction in ("RUN", "COPY", "WORKDIR"):
            yield Step(instruction, words)


def _changed_root(options: Options, folder: str, words: str) -> list[str]:
    """Return the command that runs a step in the root, with mounts that vanish with it."""
    root = shlex.quote(str(options.root))
    mounts = [f"mount -t proc proc {root}/proc", f"mount --rbind /dev {root}/dev"]
    for path in options.bind:
        there = f"{root}{shlex.quote(str(path.resolve()))}"
        mounts.append(f"mkdir -p {there} && mount --bind {shlex.quote(str(path.resolve()))} {there}")
        mounts.append(f"mount -o remount,ro,bind {there}")
    handed = {name: value for name, value in os.environ.items() if name.startswith(_HANDED_ON)}
    kept = {"PATH": "/usr/sbin:/usr/bin:/sbin:/bin", "HOME": "/root", "DEBIAN_FRONTEND": "noninteractive", **handed}
    known = " ".join(f"{name}={shlex.quote(value)}" for name, value in kept.items())
    step = shlex.quote(f"cd {folder} && {words}")
    script = " && ".join([*mounts, f"chroot {root} env -i {known} /bin/bash -c {step}"])
    return ["unshare", "--mount", "--pid", "--fork", "bash", "-c", script]


def _run(command: list[str], given: bytes | None = None) -> None:
    done = subprocess.run(command, input=given, stdout=sys.stderr, check=False)
    if done.returncode != 0:
        raise CtrlRlError(f"{' '.join(command)[-200:]} ended with {done.returncode}")


def _copy(source: Path, target: Path) -> None:
    if source.is_dir():
        shutil.copytree(source, target, dirs_exist_ok=True)
    elif source.exists():
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source, target)


def _size(root: Path) -> float:
    words = subprocess.run(["du", "-sxb", root], check=True, capture_output=True, text=True).stdout.split()
    return int(words[0]) / _MEGABYTE


if __name__ == "__main__":
    given = parse_options("clean_root", Options)
    sys.exit(run_command("clean_root", lambda: main(given)))
