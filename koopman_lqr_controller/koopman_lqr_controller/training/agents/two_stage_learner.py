"""Model-oriented Koopman control (thesis 4.3.3): first the model from data, then its LQR with hand-tuned costs.

z is the observation followed by a network's features, so that costs can refer to meaningful components. The network is
trained for one-step prediction, or not at all, in which case its random features are the user-defined functions of
EDMD. The data consists of random actions, as many as for the other methods; A and B are finally fitted by least
squares.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch
from ctrl_rl_learning.torch import gradient_step
from torch import Tensor, nn

from koopman_lqr_controller.control.latent_controller import LatentController
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.models.edmd import Snapshots, fit
from koopman_lqr_controller.models.encoder import Encoder
from koopman_lqr_controller.training.agents.actor import AgentInterface
from koopman_lqr_controller.training.agents.learner import ReplayLearner
from koopman_lqr_controller.training.environments.task import AnyEnvironment, BenchmarkTask
from koopman_lqr_controller.training.networks.differentiable_lqr import LatentLqr
from koopman_lqr_controller.training.replay import Replay, Transitions
from koopman_lqr_controller.training.settings import Settings

_RIDGE = 1e-6


class LiftedModel(nn.Module):
    """z = [x, psi(x)] and A, B.

    Attributes:
        encoder: Embedding psi of observations.
        linear: A and B; the costs are not used.
    """

    def __init__(self, interface: AgentInterface, settings: Settings) -> None:
        super().__init__()
        self.encoder = interface.encoder(settings)
        self.linear = LatentLqr(interface.shape[0] + settings.latent, interface.controls, settings.riccati_iterations)

    def lift(self, x: Tensor) -> Tensor:
        """Return the lifted state z (N, n)."""
        return torch.cat((self.encoder.normalise(x), self.encoder(x)), dim=1)

    def deploy(self) -> Encoder:
        """Return the lifting without torch."""
        return replace(self.encoder.deploy(), inclusive=True)


class TwoStageLearner(ReplayLearner):
    """A learner that fits a model to random actions, then solves for its LQR.

    The replay must hold all actions of a run. Unless `learnt`, psi keeps its random initial weights.

    Raises:
        KoopmanError: The task has image observations, no goal, or no hand-tuned costs.
    """

    def __init__(
        self,
        problem: BenchmarkTask,
        environment: AnyEnvironment,
        seed: int,
        capacity: int,
        device: str = "cpu",
        learnt: bool = True,
    ) -> None:
        super().__init__(problem, environment, seed)
        self.replay = Replay(capacity, self.interface.shape, self.interface.controls, self.interface.kind)
        self._device, self._learnt = torch.device(device), learnt
        self.method = "two-stage Koopman control, " + ("learnt lifting" if learnt else "EDMD with random features")
        goal = self.interface.goal
        if goal is None or len(self.interface.shape) != 1 or problem.name not in HAND_TUNED:
            raise KoopmanError(f"{problem.name}: two_stage needs hand-tuned costs, as for {', '.join(HAND_TUNED)}")
        self._goal, self._cost = goal, HAND_TUNED[problem.name][problem.settings.cost]
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self._model = LiftedModel(self.interface, problem.settings).to(self._device)
        parameters = [*self._model.encoder.parameters(), self._model.linear.A, self._model.linear.B]
        self._optimizer = torch.optim.Adam(parameters, lr=problem.settings.learning_rate)
        self._modules, self._optimizers = {"model": self._model}, {"optimizer": self._optimizer}
        self._losses: list[Tensor] = []

    def _begin(self, random: np.random.Generator) -> tuple[None, Callable[[], None]]:
        def update() -> None:
            if self._learnt:
                self._update(self.replay.draw(self._settings.batch, random))

        return None, update

    def _update(self, data: Transitions) -> None:
        x, u, x_next = (torch.from_numpy(it).to(self._device).float() for it in (data.x, data.u, data.x_next))
        model = self._model
        loss = model.linear.model_loss(model.lift(x), u, model.lift(x_next))
        gradient_step(self._optimizer, loss)
        self._losses.append(loss.detach())

    def take_losses(self) -> dict[str, float]:
        """Return the mean model loss since the last call; empty if the model is fitted at once."""
        losses, self._losses = self._losses, []
        return {"loss": float(torch.stack(losses).mean())} if losses else {}

    def candidates(self) -> dict[str, LatentController]:
        """Return the LQR of the least-squares model or, if there is none, of a contracted model."""
        encoder, data = self._model.deploy(), self.replay.everything()
        u = data.u.astype(np.float64)
        z_ref = encoder(self._goal)
        seen = Snapshots(encoder(data.x), u, encoder(data.x_next)).centred(z_ref, np.zeros(u.shape[1]))
        model = fit(seen, _RIDGE, lifted=True)
        first, rest = self._cost
        Q = np.concatenate((first, np.full(len(z_ref) - len(first), rest)))
        for each in (model, model.contracted()[1]):
            try:
                return {"lqr": LatentController(encoder, each, Q, np.ones(u.shape[1]), z_ref)}
            except KoopmanError:
                continue
        raise KoopmanError("no regulator for the fitted model: give it more actions")


HAND_TUNED = {
    "cartpole_swingup": {
        "Q1": ((84.12, 62.07, 65.79, 0.04, 0.04), 0.0),
        "Q2": ((0.01, 10.0, 10.0, 0.01, 0.01), 0.0),
        "Q3": ((10.0, 60.0, 60.0, 0.01, 0.01), 0.0),
        "Q4": ((10.0, 60.0, 60.0, 10.0, 10.0), 0.1),
    }
}
"""Costs by task: of the observation's entries (position, cos, sin, speed, turn rate), and of all others (Table 4.2)."""
