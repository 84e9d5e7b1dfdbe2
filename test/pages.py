"""The shell commands of a page, and one script that runs them as a reader does who goes through it from top to bottom.

A page is written for a reader with a clone, a shell with the workspace, and terminals. So `script` gives each page a
folder of its own with the clone's `docs/results`, `examples` and `test` in it, and

- runs each command as it stands; the first that fails ends the page;
- gives a node that would block the shell a terminal of its own, in the background, and stops it by Ctrl-C when the page
  starts the same node again, or ends;
- takes `make TARGET` for the recipe of that target, without the installation in front of it.
"""

import re
import shlex
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parents[1]
_FENCED = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_SHELL = ("bash", "sh")
_HEREDOC = re.compile(r"<<-?'?(\w+)'?$")
_RUN = re.compile(r"ros2 run (\w+ \w+)")
_NODES = re.compile(r'"(\w+) = (\w[\w.]*(?:_node|\.node|_agent)):main"')

_START = f"""
set -eo pipefail -m
trap 'for job in $(jobs -p); do kill -KILL -- -$job 2>/dev/null || true; done' EXIT
. '{ROOT}/scripts/workspace.bash'
mkdir docs && cp -r '{ROOT}/docs/results' docs/ && cp -r '{ROOT}/examples' examples
for shared in test scripts install .venv; do ln -s '{ROOT}'/$shared $shared; done
make() {{ command make -f '{ROOT}/Makefile' -o setup -o build -o build-demo RUN='set -eo pipefail;' "$@"; }}
declare -A terminals=()
terminal() {{  # NAME COMMAND: until the node has said something, or the patience for it is over
  local log="terminal of ${{1// /, }}.txt"
  eval "$2" >"$log" 2>&1 & terminals[$1]=$!
  for ((tick = 0; tick < 150; tick++)); do
    [[ ! -s $log ]] && kill -0 "${{terminals[$1]}}" 2>/dev/null || break
    sleep 0.2
  done
  sleep 1
  kill -0 "${{terminals[$1]}}" || {{ cat "$log"; return 1; }}
}}
stop() {{  # NAME: Ctrl-C in its terminal
  local code=0 job=${{terminals[$1]:-}}
  [[ -n $job ]] || return 0
  unset "terminals[$1]"
  kill -INT -- -"$job"
  wait "$job" || code=$?
  ((code == 0)) || {{ echo "$1 ended with $code"; cat "terminal of ${{1// /, }}.txt"; return "$code"; }}
}}
stop_all() {{
  for name in "${{!terminals[@]}}"; do stop "$name"; done
}}
"""


_NOTHING: Mapping[str, Any] = MappingProxyType({})


class Page(NamedTuple):
    """What a test has to know of a page to go through it.

    Attributes:
        seconds: What it takes, roughly; pages of more than half a minute are slow tests.
        before: Shell lines that bring about what the page takes for granted: its robot, a map, a bag.
        files: Files that the page tells its reader to write: number of the block (from 0, of those that are no shell's)
            by file name.
        smaller: Options that make a command quicker, by how the command begins: the budget (seeds, samples, episodes,
            goals) and nothing else, by options that `--help` of that command names. They replace the page's values.
        between: Shell lines of what the reader does by hand after a command, by how it begins.
        skipped: Reason why a command is not run, by how it begins; or a whole block, by its first comment or two lines.
    """

    seconds: float
    before: str = ""
    files: Mapping[str, int] = _NOTHING
    smaller: Mapping[str, str] = _NOTHING
    between: Mapping[str, str] = _NOTHING
    skipped: Mapping[str, str] = _NOTHING


def blocks(text: str) -> list[str]:
    """Return the shell blocks of a page."""
    return [block for language, block in _FENCED.findall(text) if language in _SHELL]


def commands(block: str) -> Iterator[str]:
    """Yield the commands of a block: lines, with those that continue them and the documents that they read."""
    lines = iter(block.splitlines())
    for line in lines:
        command = line
        while command.endswith("\\"):
            command += "\n" + next(lines)
        document = _HEREDOC.search(command)
        while document:
            command += "\n" + (more := next(lines))
            if more == document.group(1):
                break
        if command.strip() and not command.startswith("#"):
            yield command


def begins(command: str, starts: Mapping[str, str]) -> str | None:
    """Return the longest of some beginnings that a command or block has."""
    return max((start for start in starts if command.startswith(start)), key=len, default=None)


def to_run(text: str, page: Page) -> list[str]:
    """Return the commands of a page that are run, as they stand there."""
    whole = {start: reason for start, reason in page.skipped.items() if start.startswith("#") or "\n" in start}
    kept = [block for block in blocks(text) if begins(block, whole) is None]
    return [command for block in kept for command in commands(block) if begins(command, page.skipped) is None]


def script(text: str, page: Page) -> str:
    """Return the bash script that goes through a page in an empty folder."""
    others = [block for language, block in _FENCED.findall(text) if language not in _SHELL]
    parts = [_START, *(_file(name, others[number]) for name, number in page.files.items()), page.before]
    started: set[str] = set()
    for command in to_run(text, page):
        parts.append(f"echo {shlex.quote(f'$ {command}')}")
        change = begins(command, page.smaller)
        words = command if change is None else with_options(command, page.smaller[change])
        name = node_of(words)
        if name is None:
            parts.append(words)
        else:
            parts += [f"stop {shlex.quote(name)}"] if name in started else []
            parts.append(f"terminal {shlex.quote(name)} {shlex.quote(words)}")
            started.add(name)
        by_hand = begins(command, page.between)
        parts += [] if by_hand is None else [page.between[by_hand]]
    return "\n".join((*parts, "stop_all"))


def _file(name: str, text: str) -> str:
    return f"cat > {shlex.quote(name)} <<'END OF FILE'\n{text}END OF FILE"


def with_options(command: str, options: str) -> str:
    """Return a command with options in place of its own of these names, before those of ROS."""
    words, given = _words(command), shlex.split(options)
    names = {word for word in given if word.startswith("--")}
    kept: list[str] = []
    taken = False
    for word in words:
        taken = word in names if word.startswith("-") else taken
        kept += [] if taken else [word]
    end = kept.index("--ros-args") if "--ros-args" in kept else len(kept)
    # A variable at the beginning stands for the command's first words.
    return " ".join(word if word.startswith("$") else shlex.quote(word) for word in (*kept[:end], *given, *kept[end:]))


def _words(command: str) -> list[str]:
    """Return the words of a command, without comments; it may go on over several lines."""
    return shlex.split(command.replace("\\\n", " "), comments=True)


def node_of(command: str) -> str | None:
    """Return package and executable of a command that starts a node in the foreground, or the script's name."""
    if ("\n" in command and "\\\n" not in command) or not command.startswith(("ros2 run ", "python ")):
        return None
    words = _words(command)
    if "--help" in words or "&" in words:
        return None
    if match := _RUN.match(command):
        return match.group(1) if match.group(1) in node_executables() else None
    return words[1] if words[0] == "python" and "--ros-args" in words else None


def node_executables() -> set[str]:
    """Return package and executable of each node of the workspace."""
    files = ROOT.glob("*/setup.py")
    return {f"{file.parent.name} {name}" for file in files for name, _ in _NODES.findall(file.read_text("utf-8"))}
