"""Assignment of commands to steps: clocks, reception, periods, slow simulators, jumps; a consistent interpretation."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from ctrl_rl_bags.alignment.extractors import odometry_jumps
from ctrl_rl_bags.alignment.resampling import TimeSeries, acting
from ctrl_rl_bags.datasets.extraction import Found, extract, find_layout
from ctrl_rl_bags.datasets.frames import ScanLayout, times_of, whole_episodes
from ctrl_rl_bags.datasets.options import ExtractionOptions, check_task
from ctrl_rl_bags.datasets.rebuilding import ODOMETRY_TYPE, SCAN_TYPE, MessageMaker
from hypothesis import given, settings
from hypothesis import strategies as st

from ctrl_rl_bags import BagError, BagWriter, align

SCAN = ScanLayout(beams=12, angle_min=-1.9, angle_increment=0.35, range_min=0.1, range_max=8.0, frame="base_scan")
STAMPED, PLAIN = "geometry_msgs/msg/TwistStamped", "geometry_msgs/msg/Twist"
STEP, START, SECOND = 10**8, 1_750_000_000 * 10**9, 10**9
Change = Callable[[int], int]


def same(time: int) -> int:
    return time


def write(
    folder: Path,
    count: int = 40,
    kind: str = STAMPED,
    log: Change = same,
    stamps: dict[str, Change] | None = None,
    shift: Callable[[int], int] = lambda _: 10**6,
    beams: Callable[[int], int] = lambda _: 12,
    jump_at: int = 10**9,
    per_step: int = 1,
    twist: float = 0.1,
) -> Path:
    """Write a drive: scan k shows k + 1 m and is answered by k cm/s, received `shift` ns after the scan.

    Args:
        folder: The bag.
        count: Number of scans.
        kind: Type of the commands.
        log: Log time of a time.
        stamps: Stamp of a time, by topic.
        shift: Time from scan k to its command [ns].
        beams: Number of beams of scan k.
        jump_at: Scan before which the odometry jumps by 0.15 m.
        per_step: Scans until the command changes.
        twist: Speed that the odometry tells [m/s]; the pose moves by 0.1 m/s.
    """
    make, events = MessageMaker(), []
    stamps = stamps or {}

    def stamp(topic: str, time: int) -> int:
        return stamps.get(topic, same)(START + time)

    for k in range(count):
        t = (k + 1) * STEP
        at = np.zeros(13)
        at[[0, 6, 7]] = 0.01 * k + 0.15 * (k >= jump_at), 1.0, twist
        layout = SCAN.model_copy(update={"beams": beams(k), "angle_increment": 4.2 / beams(k)})
        events.append((t - 10**6, "/odom", make.odometry(stamp("/odom", t), at)))
        events.append((t, "/scan", make.scan(stamp("/scan", t), np.full(beams(k), 1.0 + 0.1 * k, np.float32), layout)))
        command = np.array((0.01 * (k // per_step), 0.0))
        events.append((t + shift(k), "/cmd_vel", make.command(stamp("/cmd_vel", t), command, kind)))
    with BagWriter(folder) as bag:
        for name, each in (("/scan", SCAN_TYPE), ("/odom", ODOMETRY_TYPE), ("/cmd_vel", kind)):
            bag.add_topic(make.topic(name, each))
        for time, name, data in sorted(events, key=lambda event: event[0]):
            bag.write(name, data, log(START + time))
    return folder


def read(bag: Path, **options: object) -> tuple[list[dict[str, np.ndarray]], Found]:
    how, found = ExtractionOptions(**options), Found()
    return [dict(each) for _, each in whole_episodes(extract([bag], find_layout(bag, how), how, found))], found


def pairs(episodes: list[dict[str, np.ndarray]]) -> list[tuple[int, float]]:
    """Return scan number and action of each transition."""
    return [
        (round(10.0 * (float(np.nanmin(scan)) - 1.0)), round(100.0 * float(action[0]), 3))
        for each in episodes
        for scan, action in zip(each["observation.scan"][:-1], each["action"][:-1], strict=True)
    ]


@settings(deadline=None, max_examples=25)
@given(
    st.lists(st.integers(-(10**7), 39 * 10**6), min_size=40, max_size=40),
    st.sampled_from([0.05, 1.0, 4.0, 11.0]),
    st.sampled_from([STAMPED, PLAIN]),
)
def test_every_step_has_its_own_command_at_any_speed_and_order(
    tmp_path_factory: pytest.TempPathFactory, shifts: list[int], slow: float, kind: str
) -> None:
    bag = tmp_path_factory.mktemp("drive") / "bag"
    write(bag, kind=kind, shift=lambda k: shifts[k], log=lambda time: START + round(slow * (time - START)))
    episodes, found = read(bag)
    assert pairs(episodes) == [(k, float(k)) for k in range(39)]
    assert not found.notes


def test_steps_have_the_length_that_a_task_asks_for(tmp_path: Path) -> None:
    bag = write(tmp_path / "bag", 41, per_step=4)
    (episode,), _ = read(bag, period=0.4)
    assert (np.diff(times_of(episode)) == 4 * STEP).all()
    assert pairs([episode]) == [(4 * k, float(k)) for k in range(10)]
    (episode,), _ = read(bag, period=0.25)
    assert set(np.diff(times_of(episode)) // STEP) <= {2, 3}
    assert np.diff(times_of(episode)).mean() == pytest.approx(0.25 * SECOND, rel=0.02)
    with pytest.raises(BagError, match=r"its scans come every 0\.1 s, later than a step of 0\.05 s ends"):
        read(bag, period=0.05)


@pytest.mark.fault
@pytest.mark.parametrize(
    ("topic", "change", "words"),
    [
        ("/cmd_vel", lambda time: time + 10 * SECOND, r"/cmd_vel is stamped 10\.0 s ahead of /scan"),
        ("/cmd_vel", lambda time: time - 30 * SECOND, r"/cmd_vel is stamped 30\.0 s behind /scan"),
        ("/odom", lambda time: time + 96 * 86400 * SECOND, r"/odom is stamped 96\.0 days ahead of /scan"),
        ("/scan", lambda time: time - 7 * SECOND, r"/scan is stamped 7\.0 s behind"),
        ("/scan", lambda time: time - START + 13 * SECOND, r"/scan is stamped 20254\.6 days behind"),
        ("/cmd_vel", lambda time: time + 10 * SECOND * (time - START > 2 * SECOND), "/cmd_vel is stamped"),
    ],
)
def test_a_clock_that_is_off_is_named_and_log_times_go_round_it(
    topic: str, change: Change, words: str, tmp_path: Path
) -> None:
    bag = write(tmp_path / "bag", stamps={topic: change})
    with pytest.raises(BagError, match=f"two clocks: {words}.*--clock log"):
        read(bag)
    with pytest.raises(BagError, match="two clocks"):
        align(bag, ["/scan", "/odom", "/cmd_vel"], "/scan")
    episodes, _ = read(bag, clock="log")
    assert pairs(episodes) == [(k, float(k)) for k in range(39)]


def test_commands_of_two_nodes_in_a_fast_simulation_are_no_reset_of_a_clock(tmp_path: Path) -> None:
    """A watchdog's zero and a driver's command, 0.7 s of simulation time and under 0.1 s of reception time apart."""

    def out_of_order(time: int) -> int:
        return time + SECOND * 3 // 4 if time - START == 20 * STEP else time

    bag = write(tmp_path / "bag", log=lambda time: START + (time - START) // 8, stamps={"/cmd_vel": out_of_order})
    episodes, _ = read(bag)
    assert len(pairs(episodes)) == 39
    slow = write(tmp_path / "slow", stamps={"/cmd_vel": out_of_order})
    with pytest.raises(BagError, match="the clock of /cmd_vel is set back where that of /scan is not"):
        read(slow)


@pytest.mark.fault
@pytest.mark.parametrize("topics", [("/cmd_vel",), ("/scan",), ("/odom", "/cmd_vel"), ("/scan", "/odom", "/cmd_vel")])
def test_a_stamp_of_zero_is_no_stamp(topics: tuple[str, ...], tmp_path: Path) -> None:
    episodes, found = read(write(tmp_path / "bag", stamps=dict.fromkeys(topics, lambda _: 0)))
    assert pairs(episodes) == [(k, float(k)) for k in range(39)]
    assert sum("its stamps are 0" in note for note in found.notes) == len(topics)


@pytest.mark.fault
def test_messages_at_time_zero_are_left_out_and_ask_for_no_memory(tmp_path: Path) -> None:
    bag = write(tmp_path / "bag", log=lambda time: 0 if time < START + 11 * STEP else time)
    episodes, found = read(bag)
    assert [pair[0] for pair in pairs(episodes)] == list(range(11, 39))  # the odometry of scan 10 is left out
    assert any("were received at time 0 and are left out" in note for note in found.notes)
    with pytest.warns(UserWarning, match="at time 0"):
        parts = align(bag, ["/odom", "/cmd_vel"], 100.0, clock="log", max_age=0.5)
    assert sum(map(len, parts)) < 400


def test_a_gap_of_years_asks_for_no_memory(tmp_path: Path) -> None:
    bag = write(tmp_path / "bag", log=lambda time: time - START + SECOND if time < START + 11 * STEP else time)
    assert sum(map(len, align(bag, ["/odom", "/cmd_vel"], 100.0, clock="log", max_age=0.5))) < 500
    with pytest.raises(BagError, match="are more than 100000000 rows"):
        align(bag, ["/odom", "/cmd_vel"], 100.0, clock="log")


@pytest.mark.fault
def test_a_jump_of_the_odometry_parts_the_drive(tmp_path: Path) -> None:
    episodes, found = read(write(tmp_path / "bag", jump_at=20))
    assert pairs(episodes) == [(k, float(k)) for k in range(39) if k != 19]
    assert "the odometry jumps once, " in found.notes[0]
    with pytest.warns(UserWarning, match="/odom jumps"):
        assert [len(part) for part in align(tmp_path / "bag", ["/odom"], "/odom")] == [20, 20]


@pytest.mark.parametrize("twist", [0.0, 1e-12])
def test_a_twist_of_zero_is_filled_by_the_motion_of_the_pose(twist: float, tmp_path: Path) -> None:
    """A TurtleBot3 reports such a twist while driving."""
    bag = write(tmp_path / "bag", twist=twist, jump_at=20)
    episodes, found = read(bag)
    told = f"{bag}: /odom: its twist is always zero: speeds are those of the pose's motion"
    assert found.notes[0] == told
    speeds = np.concatenate([each["observation.odometry"][:, 7] for each in episodes])
    np.testing.assert_allclose(speeds, 0.1, atol=1e-6)
    with pytest.warns(UserWarning, match="its twist is always zero"):
        parts = align(bag, ["/odom"], "/odom")
    np.testing.assert_allclose(np.concatenate([part.values["/odom"][:, 3] for part in parts]), 0.1, atol=1e-6)


@pytest.mark.fault
def test_a_twist_that_contradicts_the_pose_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BagError, match=r"odometry moves by .* in its pose, of which its speeds explain -"):
        read(write(tmp_path / "bag", twist=-0.1))


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 10**6), st.floats(0.05, 3.0), st.floats(0.1, 2.0), st.booleans())
def test_a_drive_is_no_jump_and_a_jump_is_one(seed: int, top: float, acceleration: float, tells: bool) -> None:
    random, count, dt = np.random.default_rng(seed), 200, 0.05
    wanted = np.repeat(random.uniform(-top, top, 10), 20)
    speeds = np.zeros(count)
    for k in range(1, count):
        speeds[k] = speeds[k - 1] + np.clip(wanted[k] - speeds[k - 1], -acceleration * dt, acceleration * dt)
    yaws = np.cumsum(np.repeat(random.uniform(-1.5, 1.5, 10), 20) * dt)
    steps = speeds[:, None] * dt * np.stack((np.cos(yaws), np.sin(yaws)), axis=1)
    places = np.cumsum(steps, axis=0) + random.normal(scale=1e-3, size=(count, 2))
    told = np.stack((speeds, np.gradient(yaws) / dt), axis=1) if tells else np.zeros((count, 2))
    times = (np.arange(count) * dt * SECOND).astype(np.int64)
    assert not len(odometry_jumps(times, places, yaws, told))
    at = int(random.integers(10, count - 10))
    places[at:] += 0.5 * np.array((np.cos(seed), np.sin(seed)))
    assert odometry_jumps(times, places, yaws, told).tolist() == [at]


def test_beams_may_vary_and_another_lidar_is_refused(tmp_path: Path) -> None:
    episodes, found = read(write(tmp_path / "bag", beams=lambda k: 100 + k % 7))
    assert pairs(episodes) == [(k, float(k)) for k in range(39)]
    assert found.notes == [f"{tmp_path / 'bag'}: its scans have 100 to 106 beams: all are brought to 100"]
    narrow = SCAN.model_copy(update={"angle_min": -0.5})
    how = ExtractionOptions()
    layout = find_layout(tmp_path / "bag", how).model_copy(update={"scan": narrow})
    with pytest.raises(BagError, match="of another lidar"):
        list(extract([tmp_path / "bag"], layout, how, Found()))


def test_topics_may_have_any_name(tmp_path: Path) -> None:
    bag = write(tmp_path / "bag")
    with pytest.raises(BagError, match=r"no topic /lidar \(sensor_msgs/msg/LaserScan: --scan /scan\)"):
        read(bag, scan="lidar")
    episodes, _ = read(bag, robot="mine", scan="/scan", odometry="/odom", commands="/cmd_vel")
    assert len(pairs(episodes)) == 39


def test_a_bag_of_another_task_is_refused_unless_it_is_asked_for() -> None:
    told: list[str] = []
    check_task("bag", {}, "car", "ab", allowed=False)
    check_task("bag", {"digest.task": "ab"}, "car", "ab", allowed=False)
    with pytest.raises(BagError, match=r"another task than .car.*--other-task"):
        check_task("bag", {"digest.task": "cd"}, "car", "ab", allowed=False)
    check_task("bag", {"digest.task": "cd"}, "car", "ab", allowed=True, tell=told.append)
    assert len(told) == 1


@settings(deadline=None)
@given(st.lists(st.integers(0, 3000), min_size=1, max_size=30, unique=True).map(sorted), st.integers(0, 2900))
def test_what_acted_against_a_count_by_milliseconds(times: list[int], begin: int) -> None:
    commands = TimeSeries(np.array(times, np.int64) * 10**6, np.arange(len(times), dtype=np.float64)[:, None])
    span = np.array([begin * 10**6]), np.array([(begin + 100) * 10**6])
    (got,) = acting(commands, *span, np.array([0]))
    held = [max((i for i, t in enumerate(times) if t <= now), default=-1) for now in range(begin, begin + 100)]
    held = [i for i, now in zip(held, range(begin, begin + 100), strict=True) if i >= 0 and now - times[i] < 1000]
    if len(held) < 50:
        assert np.isnan(got).all()
    else:
        most = max(set(held), key=held.count)
        assert got[0] == pytest.approx(most if held.count(most) > 50 else np.mean(held))
