"""The main job, on real processes: drive, record, report; and the bag opens in every reader."""

import json
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import EXAMPLES_OF_A_BAG, check_example, check_refused, command, start
from mcap.reader import make_reader
from PIL import Image
from rosbags.highlevel import AnyReader

from ctrl_rl_bringup import read_drive

pytestmark = pytest.mark.realtime


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, subprocess.CompletedProcess[str]]:
    """Drive, and try to start a second demo in the same ROS domain meanwhile."""
    folder = tmp_path_factory.mktemp("demo") / "run"
    process = start("demo", "--speed", 6, "--seed", 5, "--output", folder)
    assert process.stdout is not None
    said = process.stdout.readline()
    second = folder.with_name("second")
    check_refused("another run is at work in ROS domain", "demo", "--output", second)
    check_refused("end that first, or set ROS_DOMAIN_ID", "options_demo", "--output", second)
    assert not second.exists()
    out, errors = process.communicate(timeout=280.0)
    return folder, subprocess.CompletedProcess(process.args, process.returncode, said + out, errors)


def test_the_robot_reaches_the_goal_and_nothing_is_lost(run) -> None:
    folder, answer = run
    assert answer.returncode == 0, answer.stderr
    assert answer.stderr.count("% of the way") > 2
    report = json.loads((folder / "report.json").read_text())
    assert report["outcome"] == "goal reached"
    assert report["collisions"] == 0
    assert report["messages_lost"] == 0
    assert report["smallest_clearance_m"] > 0.0
    assert 0.0 < report["latency_median_ms"] <= report["latency_p99_ms"]
    assert (folder / "path.png").read_bytes().startswith(b"\x89PNG")
    for line in ("goal reached", "collisions          0", str(folder / "bag"), str(folder / "path.png")):
        assert line in answer.stdout


def test_the_report_holds_what_the_run_promised_and_says_what_it_lacks(run) -> None:
    folder, _ = run
    report = json.loads((folder / "report.json").read_text())
    assert report["lacks"] == []
    assert report["oc_value_at_start"] == pytest.approx(265.0, abs=15.0)
    drive = read_drive(folder / "bag")
    assert {"policy", "time_to_reach", "oc_value"} <= drive.promised
    nothing = np.empty((0, 2))
    assert replace(drive, oc_values=nothing).lacks == ["no optimal value"]
    assert replace(drive, oc_values=drive.oc_values[40:]).lacks[0].startswith("no optimal value before")
    few = replace(drive, oc_values=drive.oc_values[:10])
    assert few.lacks == [f"10 values of optimal value for {len(drive.odometry)} of odometry"]
    assert replace(drive, rewards=drive.rewards[:0], latencies=np.empty(0)).lacks == [
        "no reward",
        "no command answers a scan",
    ]


def test_every_scan_was_answered_once_and_within_limits(run) -> None:
    folder, _ = run
    scans: list[int] = []
    commands: dict[str, dict[int, tuple[float, float]]] = {"/cmd_vel_raw": {}, "/cmd_vel": {}}
    with AnyReader([folder / "bag"]) as reader:
        for connection, _, raw in reader.messages():
            if connection.topic == "/scan" or connection.topic in commands:
                message = reader.deserialize(raw, connection.msgtype)
                stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
                if connection.topic == "/scan":
                    scans.append(stamp)
                else:
                    commands[connection.topic][stamp] = (message.twist.linear.x, message.twist.angular.z)
    answered = len(set(scans) & commands["/cmd_vel_raw"].keys())
    passed = len(set(scans) & commands["/cmd_vel"].keys())
    # On a busy machine a newer scan or command overtakes one that still waits: queues of commands hold one.
    assert answered >= 0.95 * len(scans)
    assert passed >= 0.8 * answered
    assert (np.abs(list(commands["/cmd_vel"].values())) <= (0.22 + 1e-9, 2.84 + 1e-9)).all()


def test_the_bag_opens_with_the_mcap_reader_schemas_and_quality_of_service_included(run) -> None:
    folder, _ = run
    with (folder / "bag" / "bag_0.mcap").open("rb") as stream:
        reader = make_reader(stream)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
    assert summary is not None
    channels = {channel.topic: channel for channel in summary.channels.values()}
    assert {
        "/scan",
        "/odom",
        "/cmd_vel_raw",
        "/cmd_vel",
        "/clock",
        "/episode",
        "/tf",
        "/tf_static",
        "/koopman_lqr_controller/latent",
    } <= set(channels)
    for channel in channels.values():
        assert channel.message_encoding == "cdr"
        assert "reliability" in channel.metadata["offered_qos_profiles"]
        assert summary.schemas[channel.schema_id].encoding == "ros2msg"


def test_the_bag_knows_task_policy_and_parameters(run) -> None:
    folder, _ = run
    metadata = (folder / "bag" / "metadata.yaml").read_text()
    for key in ("digest.task", "digest.policy", "parameters./sim_bridge", "parameters./koopman_lqr_controller"):
        assert key in metadata


def test_the_report_can_be_made_again_from_the_bag_alone(run) -> None:
    folder, first = run
    (folder / "path.png").unlink()
    again = command("report", folder)
    assert again.returncode == 0, again.stderr
    assert again.stdout.splitlines()[:6] == first.stdout.splitlines()[1:7]
    assert (folder / "path.png").exists()


def test_a_drive_can_be_drawn_as_a_moving_picture(run, tmp_path: Path) -> None:
    folder, _ = run
    picture = tmp_path / "drive.gif"
    answer = command("animate", folder, "--output", picture)
    assert answer.returncode == 0, answer.stderr
    with Image.open(picture) as frames:
        assert frames.n_frames > 100
    assert picture.stat().st_size < 1_500_000
    check_refused("there is no such bag", "animate", tmp_path / "nowhere", "--output", tmp_path / "none.gif")
    assert not (tmp_path / "none.gif").exists()


@pytest.mark.parametrize("name", EXAMPLES_OF_A_BAG)
def test_an_example_reads_its_bag(run, name: str, tmp_path: Path) -> None:
    folder, _ = run
    check_example(name, tmp_path, *EXAMPLES_OF_A_BAG[name], bag=folder / "bag")


def test_a_run_never_overwrites_another(run) -> None:
    folder, _ = run
    check_refused(f"{folder} exists: give another folder", "demo", "--output", folder)


@pytest.mark.parametrize(
    ("option", "words"),
    [
        (("--policy", "nowhere"), "no policy 'nowhere'"),
        (("--task", "nowhere"), "no task 'nowhere'"),
        (("--width", "3.0"), "allows 0.6 to 0.8 m"),
    ],
)
def test_a_wrong_option_gives_one_clear_message(tmp_path: Path, option: tuple[str, str], words: str) -> None:
    check_refused(words, "demo", "--output", tmp_path / "run", *option)
    assert not (tmp_path / "run").exists()


def test_no_drive_is_no_figure(tmp_path: Path) -> None:
    results = tmp_path / "results.json"
    check_refused("--seeds must be a whole number of at least 1, not 0", "trials", "--seeds", 0, "--results", results)
    assert not results.exists()
    check_refused("--episodes must be a whole number of at least 1, not 0", "record_drives", "--episodes", 0)


def test_the_scripted_driver_takes_no_policy() -> None:
    answer = command("record_drives", "--policy", "curved_corridor")
    assert answer.returncode == 2
    assert "unknown option --policy" in answer.stderr


def test_random_starts_in_the_narrowest_corridor_reach_the_goal(tmp_path: Path) -> None:
    results = tmp_path / "results.json"
    answer = command(
        "trials",
        "--seeds",
        2,
        "--at-least",
        2,
        "--speed",
        8,
        "--width",
        0.6,
        "--output",
        tmp_path / "r",
        "--results",
        results,
    )
    assert answer.returncode == 0, answer.stderr
    rows = {row["metric"]: row for row in json.loads(results.read_text())["rows"]}
    assert rows["goal reached"]["values"] == [1.0, 1.0]
    assert min(rows["smallest clearance"]["values"]) > 0.0


@pytest.mark.slow
def test_a_policy_learned_from_scratch_drives(tmp_path: Path) -> None:
    answer = command("record_drives", "--episodes", 12, "--output", tmp_path / "drives", "--speed", 8)
    assert answer.returncode == 0, answer.stderr
    policy = tmp_path / "policy.safetensors"
    answer = command("train", tmp_path / "drives" / "bag", "--output", policy, package="koopman_lqr_controller")
    assert answer.returncode == 0, answer.stderr
    answer = command(
        "trials", "--seeds", 5, "--at-least", 5, "--speed", 8, "--policy", policy, "--output", tmp_path / "r"
    )
    assert answer.returncode == 0, answer.stdout + answer.stderr


@pytest.mark.slow
def test_with_the_filter_somebody_walks_past_and_the_robot_reaches_the_goal(tmp_path: Path) -> None:
    answer = command("demo", "--filter", "--seed", 5, "--output", tmp_path / "run")
    assert answer.returncode == 0, answer.stderr
    assert "safety filter" in answer.stdout
    report = json.loads((tmp_path / "run" / "report.json").read_text())
    assert report["task"] == "corridor_head_on"
    assert report["collisions"] == 0
    assert report["safety_filter"]["passed"] > report["safety_filter"]["corrected"] > 0
    assert 0.0 < report["safety_filter"]["held_s"] < 10.0
