"""The base of every error that is meant for a user, and any error in one line."""

_LONGEST = 300


class CtrlRlError(Exception):
    """An error that a user can fix: the message names the file, key or value, and says what to do.

    Commands and nodes print the message alone, without a traceback, and exit with a non-zero code.
    """


def one_line(error: BaseException) -> str:
    """Return an error in one short line of printable text, its type included where the message is not the suite's."""
    text = " ".join(str(error).split())
    if not isinstance(error, CtrlRlError):
        text = f"{type(error).__name__}: {text}" if text else type(error).__name__
    text = "".join(letter if letter.isprintable() else "?" for letter in text)
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 4]} ..."
