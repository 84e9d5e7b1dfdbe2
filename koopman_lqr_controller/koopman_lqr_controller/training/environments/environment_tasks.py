"""Tasks of any environment: the control suite's, Gymnasium's, and those of a Python file, with one setting for all."""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable
from pathlib import Path

from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.training.environments.task import AnyEnvironment, BenchmarkTask
from koopman_lqr_controller.training.settings import Settings

_SUITE, _GYMNASIUM, _FILE = "suite", "gym", "file"
_ENVIRONMENT = re.compile(rf"(?P<kind>{_SUITE}|{_GYMNASIUM}|{_FILE}):(?P<what>.+)@(?P<repeat>[1-9][0-9]{{0,3}})")
_REPEAT = {_SUITE: 2, _GYMNASIUM: 1, _FILE: 1}
_FRAMES_BETWEEN, _CHUNKS = 10_000, 10
"""Simulation steps between two evaluations of an environment, and the default number of evaluations."""


def name_environment(text: str, repeat: int = 0) -> str:
    """Return the name of an environment's task for `find_task`.

    Args:
        text: Task of the control suite, such as "walker_walk"; FILE.py:NAME of a class or function without arguments;
            or Gymnasium's identifier of an environment, such as "Pendulum-v1" or "my_package:Mine-v0".
        repeat: Number of the environment's steps per action; 0 for two in the control suite, as is usual, otherwise
            one.
    """
    kind, what = _GYMNASIUM, text
    path, colon, _ = text.rpartition(":")
    if colon and path.endswith(".py"):
        kind, what = _FILE, f"{Path(path).resolve()}:{text.rpartition(':')[2]}"
    elif re.fullmatch(r"[a-z0-9_]+", text):
        kind = _SUITE
    return f"{kind}:{what}@{repeat or _REPEAT[kind]}"


def environment_task(name: str) -> BenchmarkTask | None:
    """Return the task of an environment by its name from `name_environment`; None for a name of another form.

    Raises:
        KoopmanError: The environment does not exist, or has no continuous actions.
    """
    match = _ENVIRONMENT.fullmatch(name)
    if match is None:
        return None
    kind, what, repeat = match["kind"], match["what"], int(match["repeat"])
    if kind == _SUITE:
        make, pictures = make_suite(*_suite_task(what), repeat), False
    else:
        make = _own(kind, what, repeat)
        environment = make(False)  # fails now rather than after the start of the runs
        pictures = environment.pictures
        environment.close()
    if pictures:
        settings = Settings(depth=4, crop=64, batch=128, learning_rate=1e-3, bfloat16="all")
    else:
        settings = Settings(learning_rate=3e-4, critic_rate=0.02, scale="seen", bfloat16="all")
    return BenchmarkTask(
        name=name,
        about="an environment",
        make=make,
        settings=settings,
        repeat=repeat,
        chunk=max(1, _FRAMES_BETWEEN // repeat),
        chunks=_CHUNKS,
        middle=127.5 if pictures else 0.0,
        unit=127.5 if pictures else 1.0,
    )


def _suite_task(name: str) -> tuple[str, str]:
    """Return domain and task of the control suite by their joint name.

    Raises:
        KoopmanError: There is no such task.
    """
    from koopman_lqr_controller.training.environments.control_suite import suite_tasks

    names = {f"{domain}_{task}": (domain, task) for domain, task in suite_tasks()}
    if name not in names:
        near = difflib.get_close_matches(name, names, 3) or sorted(names)[:3]
        raise KoopmanError(f"no task '{name}' in the control suite: did you mean {', '.join(near)}?")
    return names[name]


def _own(kind: str, what: str, repeat: int) -> Callable[[bool], AnyEnvironment]:
    def make(_: bool) -> AnyEnvironment:
        from koopman_lqr_controller.training.environments import own_environment as own

        inner = own.make_from_file(what) if kind == _FILE else own.make_gymnasium(what)
        return own.OwnEnvironment(what, inner, repeat)

    return make


def make_suite(domain: str, task: str, repeat: int, pixels: int = 0) -> Callable[[bool], AnyEnvironment]:
    """Return what makes an environment of the control suite; arguments as for `ControlSuite`."""

    def make(_: bool) -> AnyEnvironment:
        from koopman_lqr_controller.training.environments.control_suite import ControlSuite

        return ControlSuite(domain, task, repeat, pixels)

    return make
