"""The base of every error that is meant for a user, and any error in one line."""

_LONGEST = 300


class CtrlRlError(Exception):
    """An error that a user can fix: the message names the file, key or value, and says what to do.

    Commands and nodes print the message alone, without a traceback, and exit with a non-zero code. What cannot be
    printed is escaped: a message may repeat a name that somebody has sent.
    """

    def __str__(self) -> str:
        return printable(super().__str__())


def printable(text: str) -> str:
    """Return a text whose letters, line breaks apart, can be printed anywhere: others are escaped."""
    if text.isprintable():
        return text
    return "".join(each if each.isprintable() or each == "\n" else ascii(each)[1:-1] for each in text)


def one_line(error: BaseException) -> str:
    """Return an error in one short line of printable text, its type included where the message is not the suite's."""
    text = " ".join(str(error).split())
    if not isinstance(error, CtrlRlError):
        text = f"{type(error).__name__}: {text}" if text else type(error).__name__
    text = printable(text)
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 4]} ..."
