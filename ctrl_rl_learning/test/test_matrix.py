"""The progress bar of many runs: one step for each iteration, whatever else is told of them."""

import io

from ctrl_rl_learning.study.matrix import _Progress
from tqdm import tqdm


def test_what_takes_long_is_told_without_counting_as_an_iteration() -> None:
    with tqdm(total=4, file=io.StringIO()) as bar:
        show = _Progress(bar)
        for report in (("a", 1, 0.5), ("b", 1, "going"), ("a", 2, "done"), ("a", 2, "consolidating, 6 dimensions")):
            show(report)
        assert bar.n == 3
        assert bar.postfix == "a 2: consolidating, 6 dimensions"
        for done in (2, 3, 4):
            show(("b", done, 1.0))
        assert bar.n == 4, "no more than there are"
        assert bar.postfix == "b 4: 100 %"


def test_what_was_learnt_before_a_run_was_cut_off_is_shown_and_sets_no_pace() -> None:
    with tqdm(total=70, file=io.StringIO()) as bar:
        show = _Progress(bar)
        show(("a", 22, 0.5))
        assert (bar.n, bar.initial) == (22, 22)
        show(("a", 23, 0.5))
        show(("b", 1, 0.5))
        assert (bar.n, bar.initial) == (24, 22)
