"""Teaching: the teacher passes the doorways, a pupil learns from its own drives, and a run goes on where it was."""

import numpy as np
import pytest
from ctrl_rl_learning.cli.teach import teach
from ctrl_rl_learning.dagger import run as teaching_run
from ctrl_rl_learning.dagger.clutter import KINDS, draw_corridor
from ctrl_rl_learning.dagger.episode import corridor_interface, drive_labelled
from ctrl_rl_learning.dagger.expert import wheeled
from ctrl_rl_learning.dagger.run import DaggerTrainer, TaughtRun
from ctrl_rl_learning.dagger.student import Student
from ctrl_rl_learning.errors import LearningError
from ctrl_rl_learning.study.run import RunOptions

from ctrl_rl_core import Outcome, load_navigation_task, load_policy

TASK = load_navigation_task("corridor_doorways")
INTERFACE = corridor_interface(TASK)


def test_the_teacher_passes_four_doorways():
    moments, outcome = drive_labelled(TASK, INTERFACE, 3)
    assert outcome == Outcome.GOAL.name
    assert len(moments) > 100
    assert all(each.observation.shape == (INTERFACE.size,) for each in moments)
    wanted = np.array([each.wanted for each in moments])
    low, high = INTERFACE.action.low, INTERFACE.action.high
    assert ((wanted >= low) & (wanted <= high)).all()


def test_a_pupil_that_drives_is_told_what_the_teacher_would_do():
    moments, outcome = drive_labelled(TASK, INTERFACE, 0, lambda _: np.array((0.2, 0.0)))
    assert outcome != Outcome.GOAL.name
    assert any(abs(each.wanted[1]) > 0.1 for each in moments)


def test_a_run_goes_on_from_its_checkpoint_as_if_it_had_not_ended(tmp_path, monkeypatch):
    monkeypatch.setattr(teaching_run, "_UPDATES", 20)
    monkeypatch.setattr(teaching_run, "_LAST_UPDATES", 20)
    options = RunOptions(tmp_path, 2, 40, 0, 1)
    run = TaughtRun("corridor_doorways", 0)
    with run.begin(options, lambda *_: None) as whole:
        curve = [whole.iterate([])]
        whole.save(tmp_path / "checkpoint", {"curve": curve})
        point = whole.iterate(curve)
    later = DaggerTrainer(TASK, 0, options)
    assert later.load(tmp_path / "checkpoint") == {"curve": curve}
    assert later.iterate(curve) == point
    figures = later.finish(tmp_path)
    assert set(figures) == {"success", "collisions", "loss", "success by kind"}
    policy = load_policy(tmp_path / "policy.safetensors")
    assert policy.period is None
    assert policy.needs == frozenset()


@pytest.mark.parametrize("seed", range(12))
def test_beside_every_leg_and_opening_the_expert_has_a_way(seed):
    radius = wheeled(TASK).through_gaps
    corridor = draw_corridor(TASK, radius, seed)
    again = draw_corridor(TASK, radius, seed)
    assert (again.task, again.width, again.kind) == corridor
    assert (corridor.kind == KINDS[0]) == (corridor.task is TASK)
    world = corridor.task.build_world(corridor.width)
    assert len(world.obstacles) > 0 or corridor.kind in KINDS[:1]
    assert drive_labelled(corridor.task, INTERFACE, seed, None, corridor.width).outcome == Outcome.GOAL.name


def test_a_scan_for_which_the_expert_knows_no_command_is_left_out():
    """Drives against a leg, from where no node around has a time to reach."""
    random = np.random.default_rng(0)
    for seed in (1, 2, 3, 4):
        corridor = draw_corridor(TASK, wheeled(TASK).through_gaps, seed)
        student = lambda _: np.array((0.15, random.uniform(-2.0, 2.0)))  # noqa: E731
        found = drive_labelled(corridor.task, INTERFACE, seed, student, corridor.width)
        assert all(np.isfinite(each.wanted).all() for each in found.samples)


def test_a_student_refuses_to_learn_what_is_not_finite():
    student = Student(INTERFACE)
    seen = np.zeros((4, INTERFACE.size), np.float32)
    with pytest.raises(LearningError, match="not finite"):
        student.fit(seen, np.full((4, 2), np.nan, np.float32), 1, np.random.default_rng(0))


def test_all_kinds_of_corridors_are_drawn():
    assert {draw_corridor(TASK, 0.105, seed).kind for seed in range(24)} == set(KINDS)


def test_a_task_without_a_corridor_is_refused_in_one_line(capsys, tmp_path):
    assert teach(["--task", "car_ttr", "--folder", str(tmp_path)]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "task 'car_ttr' has no corridor" in line
