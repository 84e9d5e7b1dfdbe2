"""How every command of the suite ends: with its work done, one clear line of error, or quietly interrupted.

And how it refuses numbers that are too small, `check_least(options, seeds=1, workers=0)`, and, before any work, places
where nothing can be written, `type=file_to_write`.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable
from pathlib import Path

from ctrl_rl_core.errors import CtrlRlError

EXIT_INTERRUPTED = 130
"""As a shell reports SIGINT."""


class CommandError(CtrlRlError):
    """An option has a value that does not serve."""


def check_least(options: argparse.Namespace, **least: int) -> None:
    """Refuse options, by name, that are less than this; one that was left out, None, passes.

    Raises:
        CommandError: names the option.
    """
    for name, limit in least.items():
        value = getattr(options, name)
        if value is not None and value < limit:
            raise CommandError(f"--{name.replace('_', '-')} must be at least {limit}, not {value}")


def file_to_write(text: str) -> Path:
    """Return an option's file that will be written.

    Raises:
        ArgumentTypeError: it is a folder, or its folder cannot be there or be written to.
    """
    path = Path(text)
    if path.is_dir():
        raise argparse.ArgumentTypeError(f"{path} is a folder: name a file in it")
    folder_to_write(str(path.parent))
    return path


def folder_to_write(text: str) -> Path:
    """Return an option's folder that files will be written to; it need not be there yet.

    Raises:
        ArgumentTypeError: it cannot be there or be written to.
    """
    path = Path(text)
    nearest = next(each for each in (path, *path.parents) if each.exists())
    if not nearest.is_dir():
        raise argparse.ArgumentTypeError(f"{nearest} is a file: name a folder")
    if not os.access(nearest, os.W_OK | os.X_OK):
        raise argparse.ArgumentTypeError(f"{nearest} may not be written to")
    return path


def run_command(program: str, work: Callable[[], int], failure: int = 1) -> int:
    """Run a command and return its exit code.

    Args:
        program: name that its errors begin with.
        work: returns the exit code.
        failure: exit code of an error that the suite explains.
    """
    try:
        code = work()
        sys.stdout.flush()
    except CtrlRlError as error:
        print(f"{program}: {error}", file=sys.stderr)
        return failure
    except ModuleNotFoundError as error:
        print(f"{program}: needs '{error.name}': python -m pip install -r requirements/training.txt", file=sys.stderr)
        return failure
    except BrokenPipeError:  # the reader of a pipe (head, less) has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        print(f"{program}: {error.filename or ''}: {error.strerror or error}", file=sys.stderr)
        return failure
    except KeyboardInterrupt:
        print(f"{program}: interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED
    return code
