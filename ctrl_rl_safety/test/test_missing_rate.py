"""The rate at which a lidar misses surfaces is measured from scans, whatever moves and wherever edges are."""

import numpy as np
import pytest
from ctrl_rl_safety.identification.missing import Missing, count_missing

BEARINGS = np.radians(np.arange(0.0, 360.0, 1.0))


def scans(lost: float, whole: float = 0.0, driving: float = 0.0, walker: bool = False, count: int = 120) -> list:
    """Return scans of a square room with a box in it, which lose beams and whole scans."""
    random, out, x = np.random.default_rng(1), [], 0.0
    for k in range(count):
        x += driving * 0.1 * (k % 40 < 20) - driving * 0.1 * (k % 40 >= 20)
        c, s = np.cos(BEARINGS), np.sin(BEARINGS)
        with np.errstate(divide="ignore"):
            ranges = np.minimum(np.abs((np.sign(c) * 3.0 - x) / c), np.abs(2.0 / s))
        ranges[40:70] = 1.0 - x * np.cos(BEARINGS[40:70])
        if walker:
            ranges[(3 * k) % 360 : (3 * k) % 360 + 12] = 0.8
        ranges += 0.01 * np.clip(random.standard_normal(360), -2.5, 2.5)
        ranges[random.random(360) < lost] = np.inf
        if random.random() < whole:
            ranges[:] = np.inf
        out.append((0.1 * k, ranges))
    return out


@pytest.mark.parametrize("lost", [0.0, 0.05, 0.2, 0.4])
def test_the_share_of_lost_beams_is_found(lost: float) -> None:
    found = count_missing(scans(lost))
    assert found.rate == pytest.approx(lost, abs=0.01)
    assert lost <= found.bound <= lost + 0.03


def test_whole_scans_that_are_lost_count() -> None:
    assert count_missing(scans(0.0, whole=0.1)).rate == pytest.approx(0.1, abs=0.06)


@pytest.mark.parametrize(("driving", "walker"), [(0.3, False), (0.0, True), (0.2, True)])
def test_motion_is_no_miss(driving: float, walker: bool) -> None:
    found = count_missing(scans(0.05, driving=driving, walker=walker))
    assert found.rate == pytest.approx(0.05, abs=0.02)


def test_gaps_and_other_scans_are_not_compared() -> None:
    some = scans(0.0, count=2)
    assert count_missing([*some, (5.0, some[0][1]), (5.1, some[0][1][:10])]) == Missing(0, 0)
