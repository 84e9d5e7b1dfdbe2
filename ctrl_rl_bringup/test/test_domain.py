"""One run in a ROS domain: a second one is refused, or takes a free domain and says which."""

import os

import pytest
from ctrl_rl_bringup.cli.running import run_alone
from ctrl_rl_bringup.runner.domain import DomainError, claim, own_domain, stay_local
from rclpy.context import Context
from rclpy.node import Node
from sensor_msgs.msg import LaserScan

HERE = int(os.environ["ROS_DOMAIN_ID"])


@pytest.fixture
def scanner():
    """A node of somebody else that publishes scans in the domain of the tests."""
    context = Context()
    context.init(domain_id=HERE)
    node = Node("lidar", namespace="robot1", context=context)
    node.create_publisher(LaserScan, "scan", 1)
    yield node
    node.destroy_node()
    context.try_shutdown()


def test_a_domain_is_kept_until_its_run_ends() -> None:
    with claim(HERE), pytest.raises(DomainError, match=f"another run is at work in ROS domain {HERE}: end that"):
        claim(HERE)
    claim(HERE).close()


@pytest.mark.fault
@pytest.mark.usefixtures("scanner")
def test_a_run_beside_somebody_elses_robot_is_refused_before_it_starts(capsys) -> None:
    assert run_alone("demo", lambda: pytest.fail("it started")) == 2
    assert f"demo: /robot1/lidar is at work in ROS domain {HERE}: end that first" in capsys.readouterr().err


@pytest.mark.fault
def test_without_a_chosen_domain_a_free_one_is_taken_and_said(monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    monkeypatch.delenv("ROS_DOMAIN_ID")
    with own_domain("demo") as first:
        assert os.environ["ROS_DOMAIN_ID"] == str(first)
        monkeypatch.delenv("ROS_DOMAIN_ID")
        capsys.readouterr()
        with own_domain("demo") as second:
            assert second > first
            assert os.environ["ROS_DOMAIN_ID"] == str(second)
        assert f"this run takes ROS_DOMAIN_ID={second}" in capsys.readouterr().err
        monkeypatch.setenv("ROS_DOMAIN_ID", str(first))
    assert "ROS_DOMAIN_ID" not in os.environ


@pytest.mark.parametrize("number", ["233", "-1", "one"])
def test_a_domain_that_ros_does_not_know_is_refused(monkeypatch: pytest.MonkeyPatch, number: str) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", number)
    with (
        pytest.raises(DomainError, match=f"ROS_DOMAIN_ID={number}: must be a whole number from 0 to 232"),
        own_domain(""),
    ):
        pass


def test_only_an_unset_discovery_range_is_set(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
    stay_local()
    assert os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "SUBNET"
    monkeypatch.delenv("ROS_AUTOMATIC_DISCOVERY_RANGE")
    stay_local()
    assert os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"
