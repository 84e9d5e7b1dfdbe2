"""Temporal alignment of a bag's topics."""

import numpy as np
import pytest
from bag_messages import OFFICE, cdr, odometry, scan, topic, twist, write_texts
from ctrl_rl_bags.alignment.extractors import TWIST
from hypothesis import given, settings
from hypothesis import strategies as st

from ctrl_rl_bags import BagError, BagWriter, TimeSeries, align, resample

SECOND = 10**9
START = 1_700_000_000 * SECOND


def write_drive(folder, stamp_offset=0, reset_at=None):
    """Odometry at 50 Hz on a curved path, scans at 10 Hz with one more beam each, commands at 20 Hz."""
    with BagWriter(folder) as bag:
        bag.add_topic(topic("/odom", "nav_msgs/msg/Odometry"))
        bag.add_topic(topic("/scan", "sensor_msgs/msg/LaserScan"))
        bag.add_topic(topic("/cmd_vel", "geometry_msgs/msg/Twist"))
        for k in range(200):
            now = START + k * SECOND // 100
            stamp = now + stamp_offset - (reset_at * SECOND // 100 if reset_at is not None and k >= reset_at else 0)
            t = k / 100
            if k % 2 == 0:
                yaw = (3.0 + 2.0 * t + np.pi) % (2 * np.pi) - np.pi
                bag.write("/odom", cdr(odometry(stamp, 0.5 * t, 1.0 - t, yaw, 0.5, 2.0)), now)
            if k % 10 == 0:
                bag.write("/scan", cdr(scan(stamp, np.full(k // 10 + 1, t))), now)
            if k % 5 == 0:
                bag.write("/cmd_vel", cdr(twist(t, -t)), now)
    return folder


class TestAlign:
    def test_linear_odometry_is_the_closed_form(self, tmp_path):
        bag = write_drive(tmp_path / "bag")
        (got,) = align(bag, ["/odom"], 37.0, methods={"/odom": "linear"})
        t = got.seconds
        np.testing.assert_allclose(t, np.arange(len(got)) / 37.0, atol=1e-9)
        x, y, yaw, v, omega = got.values["/odom"].T
        np.testing.assert_allclose(x, 0.5 * t, atol=1e-9)
        np.testing.assert_allclose(y, 1.0 - t, atol=1e-9)
        np.testing.assert_allclose(np.exp(1j * yaw), np.exp(1j * (3.0 + 2.0 * t)), atol=1e-9)
        np.testing.assert_allclose(v, 0.5)
        np.testing.assert_allclose(omega, 2.0)
        assert np.abs(yaw).max() <= np.pi
        assert got.ages["/odom"].max() <= 0.02 + 1e-9

    def test_scans_are_the_reference(self, tmp_path):
        (got,) = align(write_drive(tmp_path / "bag"), ["/scan", "/odom", "/cmd_vel"], "/scan")
        assert [len(scan.ranges) for scan in got.values["/scan"]] == list(range(1, 21))
        np.testing.assert_allclose(got.values["/odom"][:, 0], 0.5 * got.seconds)
        np.testing.assert_allclose(got.values["/cmd_vel"][:, 0], got.seconds)
        np.testing.assert_array_equal(got.ages["/cmd_vel"], 0.0)

    def test_log_times_are_brought_onto_the_clock_of_the_stamps(self, tmp_path):
        (got,) = align(write_drive(tmp_path / "bag", stamp_offset=-START), ["/scan", "/cmd_vel"], "/scan")
        assert got.times[0] == 0
        np.testing.assert_allclose(got.values["/cmd_vel"][:, 0], got.seconds)

    def test_reset_of_the_clock_starts_a_new_sequence(self, tmp_path):
        bag = write_drive(tmp_path / "bag", stamp_offset=-START, reset_at=100)
        first, second = align(bag, ["/odom", "/scan", "/cmd_vel"], "/scan")
        assert (len(first), len(second)) == (10, 10)
        np.testing.assert_allclose(second.values["/odom"][:, 0], 0.5 * (1.0 + second.seconds))
        np.testing.assert_allclose(second.values["/cmd_vel"][:, 0], 1.0 + second.seconds)
        (whole,) = align(bag, ["/odom", "/scan"], "/scan", clock="log")
        assert len(whole) == 20

    def test_bags_and_gaps_are_not_joined(self, tmp_path):
        bags = [write_drive(tmp_path / "one"), write_drive(tmp_path / "two")]
        assert [len(part) for part in align(bags, ["/scan", "/odom"], "/scan")] == [20, 20]
        with BagWriter(tmp_path / "gap") as bag:
            bag.add_topic(topic("/cmd_vel", "geometry_msgs/msg/Twist"))
            for t in (0.0, 0.1, 0.2, 1.0, 1.1):
                bag.write("/cmd_vel", cdr(twist(t, 0.0)), round(t * SECOND))
        parts = align(tmp_path / "gap", {"/cmd_vel": TWIST}, "/cmd_vel", max_step=0.5)
        assert [list(part.values["/cmd_vel"][:, 0]) for part in parts] == [[0.0, 0.1, 0.2], [1.0, 1.1]]

    def test_refusals(self, tmp_path):
        bag = write_drive(tmp_path / "bag")
        with pytest.raises(BagError, match="not among the topics"):
            align(bag, ["/odom"], "/scan")
        with pytest.raises(BagError, match="only numbers"):
            align(bag, ["/odom", "/scan"], "/odom", methods={"/scan": "linear"})
        with pytest.raises(BagError, match="no extractor"):
            align(write_texts(tmp_path / "talk"), ["/talk"], "/talk")
        with pytest.raises(BagError, match="positive"):
            align(bag, ["/odom"], 0.0)

    @settings(deadline=None)
    @given(
        st.lists(st.integers(0, 1000), min_size=1, max_size=20, unique=True).map(sorted),
        st.lists(st.integers(-100, 1100), min_size=1, max_size=20),
    )
    def test_sample_against_a_search_by_hand(self, known, asked):
        track = TimeSeries(np.array(known, dtype=np.int64), np.array(known, dtype=np.float64)[:, None])
        times = np.array(asked, dtype=np.int64)
        held, age = resample(track, times)
        near, near_age = resample(track, times, "nearest")
        line, line_age = resample(track, times, "linear")
        for i, t in enumerate(asked):
            before = [k for k in known if k <= t]
            assert (held[i, 0] == before[-1]) if before else np.isnan(held[i, 0])
            assert age[i] == (pytest.approx((t - before[-1]) * 1e-9) if before else np.inf)
            assert abs(near[i, 0] - t) == min(abs(k - t) for k in known)
            assert near_age[i] == pytest.approx(abs(near[i, 0] - t) * 1e-9)
            inside = known[0] <= t <= known[-1]
            assert (line[i, 0] == pytest.approx(t)) if inside else np.isnan(line[i, 0])
            assert np.isfinite(line_age[i]) == inside

    @pytest.mark.skipif(not OFFICE.exists(), reason="the recording is not here")
    def test_real_recording(self):
        parts = align(OFFICE, ["/scan", "/odom", "/cmd_vel"], "/scan", max_step=1.0)
        assert sum(len(part) for part in parts) == 357
        assert {len(scan.ranges) for part in parts for scan in part.values["/scan"]} == {720}
        speeds = np.concatenate([part.values["/odom"][:, 3] for part in parts])
        assert 0.0 < np.nanmax(speeds) < 0.5
