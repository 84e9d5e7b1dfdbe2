"""The advice of an error message can be followed: each command and option that it names is there."""

import re
from functools import cache

import pytest
from advice import Advice, advices, commands_that_reach, executables
from commands import command

_ALL = list(executables())
_OLD_WORDS = {"koopman_lqr_controller.cli.train"}
"""Modules that name what a command line once was."""
_OF_ROS = {"--ros-args", "--params-file", "--show-args", "--src", "--dst"}


@cache
def help_of(package: str, executable: str, *words: str) -> str:
    """Return what a command answers to --help; nothing where it is refused."""
    answer = command(executable, *words, "--help", package=package)
    return answer.stdout if answer.returncode == 0 else ""


@cache
def options_of(package: str, executable: str) -> frozenset[str]:
    """Return the options of an executable and of its subcommands."""
    text = help_of(package, executable)
    found = set(re.findall(r"(?<![\w-])--[a-z][a-z-]*[a-z]", text))
    usage = text.split("\n\n", 1)[0].replace("\n", " ")
    for names in re.findall(r"(?<![-=\w] )\{([a-z_,]+)\}", usage):
        for name in names.split(","):
            found |= set(re.findall(r"(?<![\w-])--[a-z][a-z-]*[a-z]", help_of(package, executable, name)))
    return frozenset(found)


def place(advice: Advice) -> str:
    return f"{advice.module}:{advice.line}"


def test_there_is_advice() -> None:
    assert len(list(advices())) > 80


@pytest.mark.parametrize("advice", [each for each in advices() if each.module not in _OLD_WORDS], ids=place)
def test_the_advice_of_an_error_can_be_followed(advice: Advice) -> None:
    for package, (name, *more), options in advice.commands():
        found = [each for each in _ALL if each.name == name and package in ("", each.package)]
        if not found and not package and not options and not more:
            continue  # a single word in backticks, such as a key of a file
        assert found, f"no command {package} {name}: {advice.text}"
        known = frozenset().union(*(options_of(each.package, each.name) for each in found))
        assert options <= known | _OF_ROS, advice.text
        if more and re.fullmatch(r"[a-z_]+", more[0]):
            subcommands = any(help_of(each.package, each.name, more[0]) for each in found)
            assert subcommands or any("positional" in help_of(each.package, each.name) for each in found), advice.text
    if missing := advice.options() - _OF_ROS:
        commands = commands_that_reach(advice.module)
        missing -= frozenset().union(*(options_of(each.package, each.name) for each in commands))
        assert not missing, f"of the {len(commands)} commands that come here none has {missing}: {advice.text}"
