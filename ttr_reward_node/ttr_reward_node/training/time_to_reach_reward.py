"""Time to reach as the reward of any Gymnasium environment, single or vectorised.

    environment = TimeToReachReward(gymnasium.make("Mine-v0"), value, state=lambda observation: observation[:3])
    environment = TimeToReachVectorReward(gymnasium.make_vec("Mine-v0", 8), value, lambda observations: ...)

Rules of the reward:

- A reset, even within an episode, starts a new episode at its state.
- A state outside the grid is looked up at the nearest state on it. A state that cannot reach the goal pays nothing, and
  counts as the longest time if an episode begins there.
- A terminated episode pays the progress of its last step, and `shaping` deducts its potential. If `info` reports that
  the goal is reached (`is_success`, or the suite's `outcome`), the time is 0 even if the state is not yet in the goal
  of the value function.
- A truncated episode has not ended the task: its last step pays like any other, so that a learner can bootstrap.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from ctrl_rl_core.systems import NumberReader, Source
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from gymnasium.vector.utils import concatenate, create_empty_array, iterate
from numpy.typing import NDArray

from ctrl_rl_core import Outcome, ValueFunction
from ttr_reward_node.errors import TimeToReachError
from ttr_reward_node.rewards.progress import Pay, TimeToReach

Array = NDArray[np.float64]
_RESET_FIRST = "reset the environment before its first step"


class TimeToReachReward(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Adds a reward for progress in the time to reach to the environment's own reward.

    Each step also sets `info["time_to_reach"]`, the time from the new state to the goal [s]; +inf if it cannot be
    reached. Apply this wrapper before any wrapper that resets automatically (`gymnasium.wrappers.Autoreset`).

    >>> import ctrl_rl, gymnasium, numpy as np
    >>> value = ctrl_rl.solve("car_ttr", counts=(41, 41, 24))
    >>> class Car(gymnasium.Env):
    ...     observation_space = gymnasium.spaces.Box(-5.0, 5.0, (3,))
    ...     action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,))
    ...     def reset(self, *, seed=None, options=None):
    ...         super().reset(seed=seed)
    ...         self.x = np.array([-3.0, 3.0, 0.0])
    ...         return self.x.astype(np.float32), {}
    ...     def step(self, action):
    ...         self.x += 0.1 * np.array([np.cos(self.x[2]), np.sin(self.x[2]), float(action[0])])
    ...         return self.x.astype(np.float32), 0.0, False, False, {}
    >>> env = ctrl_rl.TimeToReachReward(Car(), value, state=lambda observation: observation)
    >>> _, info = env.reset()
    >>> _, reward, *_ = env.step(np.zeros(1))
    >>> reward > 0.0                                    # it went towards the goal
    True
    """

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        value: ValueFunction,
        state: Source = "state",
        *,
        kind: str = "best_progress",
        per_second: float = 1.0,
        discount: float = 0.99,
        own: float = 1.0,
    ) -> None:
        """Wrap an environment.

        Args:
            env: Any Gymnasium environment.
            value: Time-to-reach function, as returned by `ctrl_rl.solve` or `load_value`.
            state: Source of the state of the value's system in SI units: a key of `info`, a function of the
                observation, or a function of the observation and `info`. It may contain more than the learner observes.
            kind: "best_progress" (pays each second below the minimum time to reach so far in the episode), "progress"
                (also deducts losses) or "shaping" (preserves the optimal policy).
            per_second: Reward per second of progress. An episode pays at most this times phi(start): choose it so that
                the sum is of the order of the environment's reward for the goal.
            discount: Discount factor per step, used by "shaping".
            own: Weight of the environment's own reward; 0 to omit it.

        Raises:
            TimeToReachError: An argument is invalid, or no state outside the goal of the value can reach it.
        """
        super().__init__(env)
        self._potential = TimeToReach(value, kind, per_second=per_second, discount=discount)
        self._state = NumberReader(state, value.state_names, "state", TimeToReachError)
        self._own = own
        self._pay: Pay | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._pay = self._potential.pay()
        seconds = self._seconds(observation, info)
        self._pay.begin(seconds)
        return observation, {**info, "time_to_reach": seconds}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Take a step and add its reward.

        Raises:
            TimeToReachError: There was no reset, or the state cannot be read.
        """
        if self._pay is None:
            raise TimeToReachError(_RESET_FIRST)
        observation, own, terminated, truncated, info = self.env.step(action)
        seconds = self._seconds(observation, info)
        paid = self._own * float(own) + float(self._pay.step(seconds, terminated))
        return observation, paid, terminated, truncated, {**info, "time_to_reach": seconds}

    def _seconds(self, observation: Any, info: Mapping[str, Any]) -> float:
        if info.get("is_success", False) or info.get("outcome") == Outcome.GOAL.name:
            return 0.0
        return float(self._potential.times(self._state(observation, info)[None])[0])


class TimeToReachVectorReward(VectorWrapper):
    """Adds the reward of `TimeToReachReward` to a vectorised environment, with any of Gymnasium's autoreset modes.

    Args:
        env: Any vectorised Gymnasium environment.
        value: Time-to-reach function.
        state: Key of `info`, or function of the observations (and `info`), that returns the states (N, n).
        kind: Kind of progress reward.
        per_second: Reward per second of progress.
        discount: Discount factor per step, used by "shaping".
        own: Weight of the environment's own rewards.
    """

    def __init__(
        self,
        env: VectorEnv[Any, Any, Any],
        value: ValueFunction,
        state: Source = "state",
        *,
        kind: str = "best_progress",
        per_second: float = 1.0,
        discount: float = 0.99,
        own: float = 1.0,
    ) -> None:
        super().__init__(env)
        self._potential = TimeToReach(value, kind, per_second=per_second, discount=discount)
        self._states = NumberReader(state, value.state_names, "states", TimeToReachError, self.num_envs)
        self._own = own
        self._mode = env.metadata.get("autoreset_mode", AutoresetMode.NEXT_STEP)
        self._pay = self._potential.pay()
        self._over: NDArray[np.bool_] | None = None

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin episodes: all of them, or those in `options["reset_mask"]`."""
        observations, infos = self.env.reset(seed=seed, options=options)
        which = (options or {}).get("reset_mask", True)
        self._pay.begin(self._seconds(observations, infos), which)
        self._over = np.zeros(self.num_envs, dtype=np.bool_)
        return observations, infos

    def step(self, actions: Any) -> tuple[Any, Array, NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Take a step and add its reward.

        Raises:
            TimeToReachError: There was no reset, or the states cannot be read.
        """
        if self._over is None:
            raise TimeToReachError(_RESET_FIRST)
        observations, own, terminated, truncated, infos = self.env.step(actions)
        seconds, over = self._seconds(observations, infos), terminated | truncated
        last = seconds
        if self._mode == AutoresetMode.SAME_STEP and over.any():
            last = np.where(over, self._seconds(self._last(observations, infos), infos.get("final_info", {})), seconds)
        paid = self._pay.step(last, terminated)
        begun = over if self._mode == AutoresetMode.SAME_STEP else self._over
        if self._mode == AutoresetMode.NEXT_STEP:  # for finished episodes this step was only a reset, without a reward
            paid = np.where(self._over, 0.0, paid)
        if self._mode != AutoresetMode.DISABLED:
            self._pay.begin(seconds, begun)
        self._over = over
        return observations, self._own * np.asarray(own) + paid, terminated, truncated, infos

    def _seconds(self, observations: Any, infos: Mapping[str, Any]) -> Array:
        reached = np.asarray(infos.get("is_success", False), dtype=bool)
        return np.where(reached, 0.0, self._potential.times(self._states(observations, infos)))

    def _last(self, observations: Any, infos: Mapping[str, Any]) -> Any:
        """Return the observations, with those of finished episodes replaced by their final ones."""
        rows = list(iterate(self.observation_space, observations))
        final = infos["final_obs"]
        found = [row if final[index] is None else final[index] for index, row in enumerate(rows)]
        space = self.single_observation_space
        whole: Any = create_empty_array(space, self.num_envs)
        return concatenate(space, found, whole)
