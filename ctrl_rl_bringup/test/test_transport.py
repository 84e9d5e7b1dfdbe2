"""What a bag tells about losses and latency, on bags written for it."""

import struct
from pathlib import Path

import numpy as np
import pytest
from ctrl_rl_bringup.runner.transport import Sent, answer_latencies, late_answers, lost_messages, read_sent

from ctrl_rl_bags import BagWriter, Topic

MS = 10**6


def stamped(nanoseconds: int) -> bytes:
    return b"\x00\x01\x00\x00" + struct.pack("<iI", nanoseconds // 10**9, nanoseconds % 10**9) + bytes(8)


def test_reads_stamp_sequence_and_publication_from_the_wire(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic(Topic("/scan", "std_msgs/msg/Header", "", "", ()))
        writer.write("/scan", stamped(3_000_000_007), log_time=50, publish_time=40, sequence=9)
        writer.write("/scan", b"\x00\x01\x00\x00", log_time=60, publish_time=55, sequence=10)
    sent = read_sent(tmp_path / "bag")
    assert sent == {"/scan": [Sent(9, 40, 3_000_000_007), Sent(10, 55, 0)]}


def test_latency_is_that_of_the_answer_with_the_same_stamp() -> None:
    questions = [Sent(1, 100 * MS, 1), Sent(2, 300 * MS, 2)]
    answers = [Sent(1, 90 * MS, 0), Sent(2, 302 * MS, 2), Sent(3, 101 * MS, 1)]
    np.testing.assert_allclose(answer_latencies(questions, answers), [0.002, 0.001])
    assert answer_latencies(questions, []).shape == (0,)
    later = [*answers, Sent(4, 5000 * MS, 2)]
    np.testing.assert_allclose(answer_latencies(questions, later), [0.002, 0.001])


@pytest.mark.parametrize(
    ("numbers", "lost"),
    [
        ([1, 2, 3], 0),
        ([4, 6, 9], 3),
        ([1, 1, 2, 2, 5], 0),  # two publishers count apart: nothing can be said
        ([0, 0, 0], 0),  # a middleware that does not count
        ([7], 0),
    ],
)
def test_counts_the_gaps_of_one_publisher(numbers: list[int], lost: int) -> None:
    assert lost_messages({"/scan": [Sent(number, 0, 0) for number in numbers]}) == lost


def test_an_answer_is_late_once_the_next_question_has_been_asked() -> None:
    questions = [Sent(1, 100 * MS, 1), Sent(2, 200 * MS, 2), Sent(3, 300 * MS, 3)]
    answers = [Sent(1, 150 * MS, 1), Sent(2, 301 * MS, 2), Sent(3, 900 * MS, 3), Sent(4, 950 * MS, 2)]
    assert late_answers(questions, answers) == 1
    assert late_answers(questions, answers[:1]) == 0
