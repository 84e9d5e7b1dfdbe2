"""The base of every error that is meant for a user."""


class CtrlRlError(Exception):
    """Something a user can mend: the message names the file, key or value and says what to do.

    Commands and nodes print the message alone, without a traceback, and exit with a non-zero code.
    """
