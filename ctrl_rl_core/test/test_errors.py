"""Error messages with content from outside are printable single lines."""

from ctrl_rl_core.errors import CtrlRlError, one_line, printable


def test_what_a_terminal_would_obey_is_escaped():
    said = str(CtrlRlError("frame 'a\u202eb\x1b[31m\r' in\nlängs"))
    assert said == "frame 'a\\u202eb\\x1b[31m\\r' in\nlängs"
    assert printable("plain") == "plain"
    assert one_line(ValueError("a\x07")) == "ValueError: a\\x07"
