"""Resampling of any scan to fixed bearings: varying lengths, inf, NaN, zeros."""

import numpy as np
import pytest
from ctrl_rl_core.sensing.resampling import EDGE, OPENING
from hypothesis import given, settings
from hypothesis import strategies as st

from ctrl_rl_core import ScanError, ScanGeometry, Sectors

FAR = 3.5
SECTORS = Sectors(tuple(np.deg2rad([-90.0, -45.0, 0.0, 45.0, 90.0]).tolist()), float(np.deg2rad(5.0)), FAR)


def scan_of(beams: int, angle_min: float = 0.0, range_max: float = FAR) -> ScanGeometry:
    return ScanGeometry(beams, angle_min, 2 * np.pi / beams, 0.12, range_max)


def distances(ranges: np.ndarray, scan: ScanGeometry) -> np.ndarray:
    return SECTORS.distances(np.asarray(ranges, dtype=np.float32), scan)


@settings(deadline=None)
@given(st.integers(240, 720), st.floats(-np.pi, np.pi))
def test_number_of_beams_and_first_bearing_do_not_matter(beams: int, angle_min: float) -> None:
    scan = scan_of(beams, angle_min)
    bearings = angle_min + np.arange(beams) * scan.angle_increment
    smooth = 1.5 + np.cos(bearings)
    assert distances(smooth, scan) == pytest.approx(1.5 + np.cos(SECTORS.bearings), abs=0.05)


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 0.3))
def test_a_third_of_misses_moves_a_constant_scan_nowhere(seed: int, share: float) -> None:
    random = np.random.default_rng(seed)
    ranges = np.full(720, 1.25)
    missed = random.random(720) < share
    ranges[missed] = np.nan
    assert distances(ranges, scan_of(720)) == pytest.approx(1.25)


def test_each_special_value_means_what_rep_117_says() -> None:
    ranges = np.full(360, 1.0)
    at = {bearing: np.arange(bearing - 5, bearing + 6) % 360 for bearing in (0, 45, 90, 270, 315)}
    ranges[at[0]] = np.inf
    ranges[at[45]] = -np.inf
    ranges[at[90]] = 0.0
    ranges[at[270]] = 9.0
    assert distances(ranges, scan_of(360)).tolist() == pytest.approx([FAR, 1.0, FAR, 0.12, FAR])


def test_a_sector_without_measurement_takes_the_mean_of_its_neighbours() -> None:
    ranges = np.full(360, np.nan)
    for bearing, value in ((270, 1.0), (315, 2.0), (45, 4.0), (90, 5.0)):
        ranges[bearing] = value
    assert distances(ranges, scan_of(360, range_max=10.0)).tolist() == pytest.approx([1.0, 2.0, 2.75, FAR, FAR])


def test_the_median_of_a_sector_ignores_one_stray_beam() -> None:
    ranges = np.full(360, 2.0)
    ranges[90] = 0.3
    assert distances(ranges, scan_of(360))[-1] == 2.0


@settings(deadline=None)
@given(
    st.lists(st.one_of(st.floats(width=32), st.sampled_from([np.nan, np.inf, -np.inf, 0.0])), min_size=1, max_size=600)
)
def test_whatever_comes_distances_are_finite_and_within_limits(ranges: list[float]) -> None:
    try:
        out = distances(np.array(ranges), scan_of(len(ranges)))
    except ScanError:
        return
    assert np.isfinite(out).all()
    assert (out >= 0.12 - 1e-6).all()
    assert (out <= FAR).all()


def plain(ranges: np.ndarray, scan: ScanGeometry) -> np.ndarray:
    """Reference implementation, one beam after the other."""

    def meant(value: float) -> float:
        if value in (0.0, np.inf) or value > scan.range_max:
            return FAR
        if value == -np.inf:
            return min(scan.range_min, FAR)
        return np.nan if not value >= scan.range_min else min(value, FAR)

    ranges = np.array([meant(float(value)) for value in ranges])
    increment = round(scan.angle_increment * scan.beams / OPENING) * OPENING / scan.beams
    angles = scan.angle_min + np.arange(scan.beams) * increment
    apart = np.abs((angles - np.array(SECTORS.bearings)[:, None] + np.pi) % (2 * np.pi) - np.pi)
    inside = apart <= SECTORS.half_width + EDGE
    for row, far in zip(inside, apart, strict=True):
        if not row.any() and far.min() <= max(0.5 * abs(scan.angle_increment), np.pi / 360):
            row[far.argmin()] = True  # the lidar looks there, between two beams
    seen = [ranges[row & ~np.isnan(ranges)] for row in inside]
    out = np.array([np.median(each) if len(each) else np.nan for each in seen])
    known = np.concatenate((out[1:2], out, out[-2:-1]))  # the first and the last have one neighbour each
    both = 0.5 * (known[:-2] + known[2:])
    return np.where(np.isnan(out), np.where(np.isnan(both), FAR, both), out)


@settings(deadline=None)
@given(
    st.integers(20, 720),
    st.floats(-7.0, 7.0),
    st.floats(0.3, 1.0),
    st.sampled_from([-1, 1]),
    st.floats(0.0, 0.8),
    st.sampled_from([2.0, FAR, 100.0]),
    st.integers(0, 2**32 - 1),
)
def test_whatever_the_scan_a_sector_is_the_median_of_its_beams(
    beams: int, angle_min: float, turns: float, direction: int, missed: float, reach: float, seed: int
) -> None:
    """Partial and full turns, in either direction, from any bearing, with misses of all kinds; bitwise equal."""
    scan = ScanGeometry(beams, angle_min, direction * turns * 2 * np.pi / beams, 0.12, reach)
    random = np.random.default_rng(seed)
    ranges = random.uniform(0.05, 5.0, beams).astype(np.float32)
    ranges[random.random(beams) < missed] = random.choice([np.nan, np.inf, -np.inf, 0.0])
    expected = plain(ranges, scan)
    if (expected == FAR).all():
        return
    assert distances(ranges, scan).tolist() == expected.tolist()


def test_a_motor_of_varying_speed_is_looked_up_and_not_worked_out_again() -> None:
    """Scans of an LDS-02, all different: nearly all use the cache, with identical results."""
    random = np.random.default_rng(0)
    sectors = Sectors(SECTORS.bearings, SECTORS.half_width, FAR)
    for _ in range(2000):
        beams = random.uniform(267.0, 274.0)
        ranges = random.uniform(0.2, 3.0, int(np.ceil(beams))).astype(np.float32)
        scan = ScanGeometry(len(ranges), 0.0, 2 * np.pi / beams, 0.0, 100.0)
        assert sectors.distances(ranges, scan).tolist() == plain(ranges, scan).tolist()
    assert len(sectors._known) < 250


def test_geometries_without_end_are_forgotten_those_used_longest_ago_first() -> None:
    """Regardless of the number of beams, memory is bounded, and the lidar in use stays cached."""
    sectors = Sectors(SECTORS.bearings, SECTORS.half_width, FAR)
    own = scan_of(360)
    sectors.distances(np.ones(360, np.float32), own)
    first = sectors._beams(own)
    for beams in (*range(361, 1100), *range(19_000, 20_000, 10)):
        sectors.distances(np.ones(beams, np.float32), scan_of(beams))
        assert sectors._beams(own) is first
        assert len(sectors._known) <= 512
        assert sectors._known.bytes < 20_000_000


@pytest.mark.parametrize(
    ("ranges", "scan"),
    [
        ([], ScanGeometry(0, 0.0, 0.1, 0.12, 3.5)),
        ([np.nan] * 360, scan_of(360)),
        ([1.0] * 10, scan_of(11)),
        ([1.0] * 1_000_000, scan_of(1_000_000)),
        ([1.0] * 10, ScanGeometry(10, 0.0, 0.0, 0.12, 3.5)),
        ([1.0] * 10, ScanGeometry(10, float("nan"), 0.1, 0.12, 3.5)),
        ([1.0] * 10, ScanGeometry(10, 0.0, 0.1, 3.5, 0.12)),
    ],
)
def test_a_scan_that_shows_nothing_is_refused(ranges: list[float], scan: ScanGeometry) -> None:
    with pytest.raises(ScanError, match="scan with"):
        distances(np.array(ranges), scan)
