"""Collects the frames of one episode as they arrive."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_bags.datasets.frames import (
    ACTION,
    DONE,
    GOAL,
    IMAGE,
    IS_LAST,
    LOG_TIME,
    ODOMETRY,
    OUTCOME,
    REWARD,
    SCAN,
    STAMP,
    STATE,
    Frames,
    Layout,
    states_of,
)

TIMEOUT = 4
"""Outcome of an episode that reached its step limit, as in ctrl_rl_msgs/TaskOutcome."""
PIECE = 1000
"""Number of frames held in memory."""
_PIECE_BYTES = 64 << 20


class Step(NamedTuple):
    """The observation at a scan, and the command, reward and outcome since the previous scan.

    Attributes:
        stamp: Time in the scan's header [ns].
        time: Reception time of the scan [ns].
        scan: Ranges (beams,) [m].
        odometry: Pose and twist (13,).
        goal: Position and attitude of the goal (7,); NaN without a goal.
        image: Image (height, width, 3); None without a camera.
        command: Last command (2,); None without a recent one.
        reward: Last reward; NaN without a reward.
        outcome: Outcome as in ctrl_rl_msgs/TaskOutcome.
    """

    stamp: int
    time: int
    scan: NDArray[np.float32]
    odometry: NDArray[np.float64]
    goal: NDArray[np.float64]
    image: NDArray[np.uint8] | None
    command: NDArray[np.float64] | None
    reward: float
    outcome: int


class EpisodeFrames:
    """Collects the steps of an episode and yields its frames in pieces.

    Attributes:
        left_out: Number of scans in no frame because no command followed.
    """

    def __init__(self, layout: Layout) -> None:
        self.left_out = 0
        self._layout = layout
        image = layout.image
        pixels = 0 if image is None else 3 * image.height * image.width
        self._piece = max(2, min(PIECE, _PIECE_BYTES // (4 * layout.scan.beams + pixels + 200)))
        self._steps: list[Step] = []
        self._done: list[tuple[NDArray[np.float64], float, int]] = []
        self._count = 0

    def __len__(self) -> int:
        """Return the number of frames in the episode so far."""
        return self._count

    @property
    def time(self) -> int | None:
        """Reception time of the last scan [ns]; None before the first."""
        return self._steps[-1].time if self._steps else None

    def add(self, step: Step) -> Iterator[Frames]:
        """Add a step; yield frames when a piece is full."""
        if self._steps:
            if step.command is None:
                yield from self.end()
            else:
                self._done.append((step.command, step.reward, step.outcome))
        self._steps.append(step)
        self._count += 1
        if len(self._steps) > self._piece + 1:
            # The last two scans are kept, because the end of the episode is not known yet.
            kept = self._steps[-2:], self._done[-1:]
            self._steps, self._done = self._steps[:-1], self._done[:-1]
            yield self._frames(last=False)
            self._steps, self._done = kept

    def end(self) -> Iterator[Frames]:
        """End the episode and yield its remaining frames; none if it had no transition."""
        if self._done:
            yield self._frames(last=True)
        else:
            self.left_out += len(self._steps)
        self._steps, self._done, self._count = [], [], 0

    def _frames(self, *, last: bool) -> Frames:
        """Return one frame per transition, plus a final one at the end of the episode."""
        steps = self._steps if last else self._steps[:-1]
        done = [*self._done, (self._done[-1][0], np.nan, 0)] if last else self._done
        odometry = np.array([step.odometry for step in steps])
        outcomes = np.array([outcome for _, _, outcome in done], dtype=np.int64)
        columns: dict[str, NDArray[np.generic]] = {
            SCAN: np.array([step.scan for step in steps], dtype=np.float32),
            ODOMETRY: odometry,
            STATE: states_of(odometry),
            ACTION: np.array([command for command, _, _ in done]),
            REWARD: np.array([reward for _, reward, _ in done], dtype=np.float64),
            OUTCOME: outcomes,
            DONE: (outcomes != 0) & (outcomes != TIMEOUT),
            IS_LAST: np.arange(len(steps)) == (len(steps) - 1 if last else -1),
            STAMP: np.array([step.stamp for step in steps], dtype=np.int64),
            LOG_TIME: np.array([step.time for step in steps], dtype=np.int64),
        }
        if self._layout.goal:
            columns[GOAL] = np.array([step.goal for step in steps])
        if self._layout.image is not None:
            columns[IMAGE] = np.array([step.image for step in steps], dtype=np.uint8)
        return Frames({name: columns[name] for name in self._layout.columns}, 0, 0, last)
