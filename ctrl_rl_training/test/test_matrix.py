"""The progress bar of many runs: one step for each iteration, whatever else is told of them."""

import io

from ctrl_rl_training.experiments.matrix import _Progress
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
