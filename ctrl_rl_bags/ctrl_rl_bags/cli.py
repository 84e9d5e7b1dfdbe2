"""The `bag` command: `ros2 run ctrl_rl_bags bag info|recover|play|export|import FOLDER`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Annotated

import tyro
from ctrl_rl_core.command import checked, checked_list

from ctrl_rl_bags.datasets.cli import Export, Import, run_export, run_import
from ctrl_rl_bags.format.checks import printable
from ctrl_rl_bags.format.mcap_records import DEFAULT_LIMITS, Limits
from ctrl_rl_bags.format.reader import bag_info
from ctrl_rl_bags.format.recovery import recover
from ctrl_rl_core import parse_options, run_command

_LONGEST_VALUE = 20_000
_MB = 20
"""Left shift that converts megabytes to bytes."""


def _remap(text: str) -> tuple[str, str]:
    old, separator, new = text.partition(":=")
    if not (old and separator and new):
        raise ValueError(f"'{text}' must be OLD:=NEW")
    return old, new


def _limits(text: str) -> Limits:
    try:
        size = int(text) << _MB
    except ValueError:
        size = 0
    if not 0 < size <= 1 << 40:
        raise ValueError(f"'{text}' must be a whole number of MB from 1 to {1 << 20}")
    return Limits(chunk_bytes=size, open_bytes=2 * size)


_MaxChunk = Annotated[
    Limits,
    checked(_limits, "MB", show=lambda limits: str(limits.chunk_bytes >> _MB)),
    tyro.conf.arg(name="max-chunk-mb"),
]
_Topics = Annotated[tuple[str, ...], checked_list(str, "TOPIC")]
_Remaps = Annotated[tuple[tuple[str, str], ...], checked_list(_remap, "OLD:=NEW", show=":=".join)]


@dataclass(frozen=True, kw_only=True)
class _Reading:
    """Options of commands that read a bag."""

    folder: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="FOLDER")]
    """Folder of the bag, or one .mcap file."""
    limits: _MaxChunk = DEFAULT_LIMITS
    """Maximum size of a chunk or message [MB]."""


@dataclass(frozen=True, kw_only=True)
class Info(_Reading):
    """Show the files, duration, topics and metadata of a bag."""


@dataclass(frozen=True, kw_only=True)
class Recover(_Reading):
    """Copy the readable part of an incomplete bag to a new bag; the original is only read."""

    output: Annotated[str | None, tyro.conf.arg(aliases=["-o"])] = None
    """Folder of the recovered bag; by default FOLDER_recovered."""


@dataclass(frozen=True, kw_only=True)
class Play(_Reading):
    """Publish the messages of a bag in the recorded order and timing, with the recorded QoS."""

    rate: float = 1.0
    """Speed as a multiple of the recording's."""
    topics: _Topics = ()
    """Names of the topics to play; by default all."""
    remap: _Remaps = ()
    """New names of topics."""
    loop: bool = False
    """Restart at the end, until Ctrl-C."""
    clock: bool = False
    """Publish the bag's time on /clock at 100 Hz."""
    start_offset: float = 0.0
    """Time to skip at the start of the bag [s]."""
    wait_for_subscribers: float = 1.0
    """Maximum time to wait for a subscriber on every topic [s]."""


_Command = (
    Annotated[Info, tyro.conf.subcommand("info")]
    | Annotated[Recover, tyro.conf.subcommand("recover")]
    | Annotated[Play, tyro.conf.subcommand("play")]
    | Annotated[Export, tyro.conf.subcommand("export")]
    | Annotated[Import, tyro.conf.subcommand("import")]
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code: 0 success, 1 failure, 2 wrong usage."""
    about = "Inspect, recover and play bags, and make datasets of them."
    options: Info | Recover | Play | Export | Import = parse_options("bag", _Command, arguments, about)
    match options:
        case Info():
            return run_command("bag info", lambda: _info(options))
        case Recover():
            return run_command("bag recover", lambda: _recover(options))
        case Play():
            return run_command("bag play", lambda: _play(options))
        case Export():
            return run_command("bag export", lambda: run_export(options))
        case Import():
            return run_command("bag import", lambda: run_import(options))


def _info(options: Info) -> int:
    info = bag_info(options.folder, options.limits)
    print(f"bag       {info.folder}")
    print(f"files     {printable(', '.join(info.files))}")
    print(f"start     {_date(info.start)}")
    print(f"duration  {(info.end - info.start) * 1e-9:.3f} s")
    print(f"messages  {info.message_count}")
    if info.unchecked:
        print(f"checksums missing in {info.unchecked}: damage there cannot be detected")
    for note in info.notes:
        print(f"note: {note}")
    width = max((len(printable(name)) for name in info.topics), default=0)
    for name, topic in info.topics.items():
        qos = sorted({f"{profile['reliability']}, {profile['durability']}" for profile in topic.qos})
        what = f"{printable(topic.type)}  ({' | '.join(qos) or 'QoS unknown'})"
        print(f"  {printable(name):<{width}}  {topic.message_count:>8}  {what}")
    for key, value in sorted(info.custom_data.items()):
        print(f"{printable(key)}: {printable(value, _LONGEST_VALUE)}")
    return 0


def _recover(options: Recover) -> int:
    found = recover(options.folder, options.output, progress=True, limits=options.limits)
    width = max((len(name) for name in found.messages), default=0)
    for name, count in sorted(found.messages.items()):
        print(f"  {printable(name):<{width}}  {count:>8}")
    total = sum(found.messages.values())
    if found.start is not None and found.end is not None:
        print(f"{total} messages, {_date(found.start)}, {(found.end - found.start) * 1e-9:.3f} s")
    if found.folder is None:
        print(f"{options.folder} is complete: nothing to recover")
        return 0
    if found.unfinished:
        print(f"cut off: {', '.join(found.unfinished)}; {found.dropped_bytes} bytes could not be read")
    if found.too_large:
        print(f"{found.too_large} chunks or records were larger than --max-chunk-mb allows and were left out")
    if found.foreign:
        print(f"{found.foreign} messages are none of ROS 2 and were left out")
    print(f"recovered bag: {found.folder}")
    return 0


def _play(options: Play) -> int:
    # Only playing requires an installed ROS.
    from ctrl_rl_bags.recording.player import PlaybackOptions, play

    how = PlaybackOptions(
        rate=options.rate,
        topics=options.topics,
        remap=dict(options.remap),
        loop=options.loop,
        clock=options.clock,
        start_offset=options.start_offset,
        wait=options.wait_for_subscribers,
        limits=options.limits,
    )
    count = play(options.folder, how, lambda text: print(f"bag play: {text}", file=sys.stderr), progress=True)
    print(f"{count} messages played")
    return 0


def _date(nanoseconds: int) -> str:
    try:
        return datetime.fromtimestamp(nanoseconds * 1e-9, UTC).strftime("%Y-%m-%d %H:%M:%S.%f UTC")
    except (ValueError, OverflowError, OSError):
        return f"{nanoseconds} ns, which is no date"


if __name__ == "__main__":
    sys.exit(main())
