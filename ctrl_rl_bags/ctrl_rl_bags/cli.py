"""The `bag` command: `ros2 run ctrl_rl_bags bag info|recover|play FOLDER`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from datetime import UTC, datetime

from ctrl_rl_core.command import run_command

from ctrl_rl_bags.format.checks import printable
from ctrl_rl_bags.format.mcap_records import DEFAULT_LIMITS, Limits
from ctrl_rl_bags.format.reader import bag_info
from ctrl_rl_bags.format.recovery import recover

_LONGEST_VALUE = 20_000


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code: 0 done, 1 failed, 2 wrong usage."""
    options = _parser().parse_args(arguments)
    return run_command(f"bag {options.command}", lambda: int(options.run(options)))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="bag", description="Look into, mend and play bags.")
    commands = parser.add_subparsers(dest="command", required=True)

    limited = argparse.ArgumentParser(add_help=False)
    limited.add_argument(
        "--max-chunk-mb", type=_limits, default=DEFAULT_LIMITS, metavar="MB", dest="limits",
        help=f"the largest chunk or message that is read (default: {DEFAULT_LIMITS.chunk_bytes >> 20})",
    )  # fmt: skip

    info = commands.add_parser("info", help="say what a bag holds", parents=[limited])
    info.add_argument("folder", help="the bag")
    info.set_defaults(run=_info)

    mend = commands.add_parser(
        "recover", help="mend a bag that was cut off; the bag itself is only read", parents=[limited]
    )
    mend.add_argument("folder", help="the bag, or one .mcap file of it")
    mend.add_argument("-o", "--output", help="folder of the mended bag (default: FOLDER_recovered)")
    mend.set_defaults(run=_recover)

    play = commands.add_parser("play", help="publish a bag again", parents=[limited])
    play.add_argument("folder", help="the bag")
    play.add_argument("--rate", type=float, default=1.0, help="speed; 1 is that of the recording (default: 1)")
    play.add_argument("--topics", nargs="+", default=(), metavar="TOPIC", help="play these alone")
    play.add_argument("--remap", nargs="+", default=(), metavar="OLD:=NEW", type=_remap, help="publish under new names")
    play.add_argument("--loop", action="store_true", help="begin again at the end, until Ctrl-C")
    play.add_argument("--clock", action="store_true", help="publish the bag's time on /clock, at 100 Hz")
    play.add_argument("--start-offset", type=float, default=0.0, metavar="S", help="leave out the first seconds")
    play.add_argument(
        "--wait-for-subscribers", type=float, default=1.0, metavar="S",
        help="wait so long for a subscriber on every topic (default: 1)",
    )  # fmt: skip
    play.set_defaults(run=_play)
    return parser


def _remap(text: str) -> tuple[str, str]:
    old, separator, new = text.partition(":=")
    if not (old and separator and new):
        raise argparse.ArgumentTypeError(f"'{text}' must be OLD:=NEW")
    return old, new


def _limits(text: str) -> Limits:
    try:
        size = int(text) << 20
    except ValueError:
        size = 0
    if not 0 < size <= 1 << 40:
        raise argparse.ArgumentTypeError(f"'{text}' must be a whole number of MB from 1 to {1 << 20}")
    return Limits(chunk_bytes=size, open_bytes=2 * size)


def _info(options: argparse.Namespace) -> int:
    info = bag_info(options.folder, options.limits)
    print(f"bag       {info.folder}")
    print(f"files     {printable(', '.join(info.files))}")
    print(f"start     {_date(info.start)}")
    print(f"duration  {(info.end - info.start) * 1e-9:.3f} s")
    print(f"messages  {info.message_count}")
    if info.unchecked:
        print(f"checksums none of {info.unchecked}: damage there cannot be seen")
    width = max((len(printable(name)) for name in info.topics), default=0)
    for name, topic in info.topics.items():
        qos = sorted({f"{profile['reliability']}, {profile['durability']}" for profile in topic.qos})
        what = f"{printable(topic.type)}  ({' | '.join(qos) or 'QoS unknown'})"
        print(f"  {printable(name):<{width}}  {topic.message_count:>8}  {what}")
    for key, value in sorted(info.custom_data.items()):
        print(f"{printable(key)}: {printable(value, _LONGEST_VALUE)}")
    return 0


def _recover(options: argparse.Namespace) -> int:
    found = recover(options.folder, options.output, progress=True, limits=options.limits)
    width = max((len(name) for name in found.messages), default=0)
    for name, count in sorted(found.messages.items()):
        print(f"  {printable(name):<{width}}  {count:>8}")
    total = sum(found.messages.values())
    if found.start is not None and found.end is not None:
        print(f"{total} messages, {_date(found.start)}, {(found.end - found.start) * 1e-9:.3f} s")
    if found.folder is None:
        print(f"{options.folder} is whole: nothing to mend")
        return 0
    if found.unfinished:
        print(f"cut off: {', '.join(found.unfinished)}; {found.dropped_bytes} bytes could not be read")
    if found.too_large:
        print(f"{found.too_large} chunks or records were larger than --max-chunk-mb allows, and are left out")
    print(f"mended bag: {found.folder}")
    return 0


def _play(options: argparse.Namespace) -> int:
    # Only playing needs an installed ROS.
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
