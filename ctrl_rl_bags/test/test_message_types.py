"""Message types by name, including malicious names."""

import subprocess
import sys

import pytest
from ctrl_rl_bags.recording.message_types import UnknownTypeError, is_type_name, message_class
from hypothesis import given
from hypothesis import strategies as st

from ctrl_rl_bags import BagWriter, Topic, message_definition

FOREIGN = ["this/msg/X", "os/msg/path", "antigravity/msg/X", "logging.config/msg/Dict", "rclpy/msg/Node"]
MALFORMED = [
    *("", "/", "Thing", "/msg/", ".x/msg/Y", "..std_msgs/msg/String", "std_msgs/msg/String/msg/String"),
    *("std_msgs/String", "std_msgs/srv/Thing", "std_msgs/msg/String\n", "std_msgs/msg/../String"),
    *("a_/msg/B", "A/msg/B", "1a/msg/B", "std_msgs/msg/string", "a" * 1_000_000 + "/msg/B", "a/msg/" + "B" * 10_000),
    *("std__msgs/msg/String", "a/msg/B\0", "st\u0501/msg/B"),
]  # fmt: skip


def test_definition_holds_all_nested_types_once():
    text = message_definition("nav_msgs/msg/Odometry")
    nested = [line[5:] for line in text.splitlines() if line.startswith("MSG: ")]
    vector, stamp = ("Vector3", "Twist", "TwistWithCovariance"), ("Pose", "Point", "Quaternion", "PoseWithCovariance")
    expected = [f"geometry_msgs/{name}" for name in (*vector, *stamp)]
    assert sorted(nested) == sorted([*expected, "std_msgs/Header", "builtin_interfaces/Time"])


def test_class():
    assert message_class("std_msgs/msg/String").__name__ == "String"


@pytest.mark.parametrize("name", ["nowhere_msgs/msg/Thing", "std_msgs/msg/Thing", *FOREIGN, *MALFORMED])
def test_unknown(name):
    before = set(sys.modules)
    for look_up in (message_class, message_definition):
        with pytest.raises(UnknownTypeError) as error:
            look_up(name)
        assert len(str(error.value)) < 500
        assert "\n" not in str(error.value)
    assert set(sys.modules) == before


@pytest.mark.fault
@given(st.text(max_size=300) | st.from_regex(r"[a-z_.]{1,8}/msg/[A-Za-z_]{1,8}", fullmatch=True))
def test_no_name_imports_anything_or_raises_anything_else(name):
    before = set(sys.modules)
    try:
        message_class(name)
    except UnknownTypeError:
        assert set(sys.modules) == before
    else:
        assert is_type_name(name)


@pytest.mark.fault
@pytest.mark.parametrize("kind", ["this/msg/X", ".x/msg/Y", "os/msg/path"])
def test_a_bag_does_not_choose_what_is_imported(tmp_path, kind):
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic(Topic("/evil", kind, "bool odd\n"))
        bag.write("/evil", b"\0\1\0\0\1", 5)
    code = (
        "import sys; from ctrl_rl_bags.cli import main\n"
        "code = main(['play', sys.argv[1]]); print(code, {'this', 'antigravity'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code, tmp_path / "bag"], capture_output=True, text=True, check=True)
    assert done.stdout == "1 set()\n"
    assert "Traceback" not in done.stderr
