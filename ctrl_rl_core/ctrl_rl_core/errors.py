"""Base class of errors meant for users, and one-line formatting of any error."""

_LONGEST = 300


class CtrlRlError(Exception):
    """An error that a user can fix: the message names the file, key or value and the remedy.

    Commands and nodes print only the message, without a traceback, and exit with a non-zero code. Unprintable
    characters are escaped, because a message may contain a name received from outside.
    """

    def __str__(self) -> str:
        return printable(super().__str__())


def printable(text: str) -> str:
    """Escape all characters of a text that cannot be printed, except line breaks."""
    if text.isprintable():
        return text
    return "".join(each if each.isprintable() or each == "\n" else ascii(each)[1:-1] for each in text)


def one_line(error: BaseException) -> str:
    """Format an error as one short printable line, with its type unless it is a `CtrlRlError`."""
    text = " ".join(str(error).split())
    if not isinstance(error, CtrlRlError):
        text = f"{type(error).__name__}: {text}" if text else type(error).__name__
    text = printable(text)
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 4]} ..."
