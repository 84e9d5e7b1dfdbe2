"""The learner of thesis 4.2.4 (Algorithm 2): SAC around a differentiable LQR in a contrastive latent space.

Each update trains the critics and the encoder on Bellman's equation, the encoder on the contrastive loss (Eq. 4.4), A
and B on the model loss (Eq. 4.7); every other one trains encoder, A, B, Q and R on the actor's (Eq. 4.10). The model
loss leaves the encoder alone: it would make all latent states equal. The actor's passes into it through the control,
not through what the critics say of z.
"""

from __future__ import annotations

import copy
import math
from itertools import chain
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from koopman_lqr_controller.edmd import LinearModel
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.latent_controller import LatentController
from koopman_lqr_controller.training.contrastive import info_nce, noisy, random_crop
from koopman_lqr_controller.training.differentiable_lqr import LatentLqr
from koopman_lqr_controller.training.networks import TorchEncoder, TwinCritic
from koopman_lqr_controller.training.replay import Transitions
from koopman_lqr_controller.training.settings import Settings

_LOG_DEVIATIONS = (-5.0, 1.0)
"""Between which the logarithm of the controls' deviation stays."""
Array = NDArray[np.float64]


class Sight(NamedTuple):
    """What an agent sees and does.

    Attributes:
        shape: of an observation.
        controls: how many.
        middle: what becomes 0 in an observation; broadcasts to `shape`.
        unit: what becomes 1 above it.
        goal: observation of the goal, x_ref; None for z_ref = 0.
    """

    shape: tuple[int, ...]
    controls: int
    middle: NDArray[np.float32]
    unit: NDArray[np.float32]
    goal: NDArray[np.float32] | None


class Actor(nn.Module):
    """What acts: psi, A, B, Q, R; its deterministic part is deployed.

    Attributes:
        encoder: psi.
        lqr: A, B, Q, R.
        raw_deviation: what tanh makes the logarithm of the controls' deviation from, one for all (1,).
        goal: x_ref (1, *shape), empty where there is none.
    """

    goal: Tensor

    def __init__(self, sight: Sight, settings: Settings) -> None:
        super().__init__()
        middle, unit = torch.from_numpy(sight.middle), torch.from_numpy(sight.unit)
        self.encoder = TorchEncoder(
            sight.shape, settings.latent, settings.hidden, settings.depth, middle, unit, settings.crop or None
        )
        self.lqr = LatentLqr(settings.latent, sight.controls, settings.riccati_iterations)
        low, high = _LOG_DEVIATIONS
        if not math.exp(low) < settings.deviation < math.exp(high):
            raise KoopmanError(
                f"deviation is {settings.deviation}: must lie between {math.exp(low):.3g} and {math.exp(high):.3g}"
            )
        share = 2.0 * (math.log(settings.deviation) - low) / (high - low) - 1.0
        self.raw_deviation = nn.Parameter(torch.tensor([math.atanh(share)]))
        goal = torch.zeros(0, *sight.shape) if sight.goal is None else torch.from_numpy(sight.goal)[None]
        self.register_buffer("goal", goal)

    def z_ref(self) -> Tensor:
        """Return psi(x_ref), or zeros (n,)."""
        return self.encoder(self.goal)[0] if len(self.goal) else torch.zeros_like(self.lqr.log_Q)

    def mean(self, z: Tensor) -> Tensor:
        """Return u of the linear law (N, m), before tanh."""
        K, k = self.lqr.gain(self.z_ref())
        return k - z @ K.T

    @property
    def log_deviation(self) -> Tensor:
        """Logarithm of the controls' deviation before tanh (1,); unlike a clamp it has a gradient everywhere."""
        low, high = _LOG_DEVIATIONS
        return low + 0.5 * (high - low) * (torch.tanh(self.raw_deviation) + 1.0)

    def sample(self, z: Tensor, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """Return actions in [-1, 1] (N, m) and the logarithm of their density (N,)."""
        mean = self.mean(z)
        log_deviation = self.log_deviation
        noise = torch.randn(mean.shape, generator=generator).to(mean.device)
        u = mean + log_deviation.exp() * noise
        normal = -0.5 * noise.square() - log_deviation - 0.5 * math.log(2.0 * math.pi)
        squash = 2.0 * (math.log(2.0) - u - nn.functional.softplus(-2.0 * u))  # log (1 - tanh^2 u)
        return torch.tanh(u), (normal - squash).sum(dim=1)

    def deploy(self) -> LatentController:
        """Return the deterministic controller as it stands, without torch."""
        with torch.no_grad():
            z_ref = self.z_ref()
        lqr = self.lqr
        A, B, Q, R, goal = (_array(t) for t in (lqr.A, lqr.B, lqr.log_Q.exp(), lqr.log_R.exp(), z_ref))
        return LatentController(self.encoder.deploy(), LinearModel(A, B), Q, R, goal, lqr.iterations)


class Agent(nn.Module):
    """All that is learnt, and how.

    Attributes:
        actor: what acts now.
        averaged: the exponential average of `actor` over updates.
        key_encoder: momentum encoder of contrastive keys and of the target critic.
        updates: how many there were.
    """

    def __init__(self, sight: Sight, settings: Settings, seed: int, device: str = "cpu") -> None:
        super().__init__()
        self.settings, self._device = settings, torch.device(device)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.actor = Actor(sight, settings)
            self.critic = TwinCritic(settings.latent, sight.controls, settings.hidden)
            self.W = nn.Parameter(torch.rand(settings.latent, settings.latent))
        self.averaged = copy.deepcopy(self.actor).requires_grad_(False)
        self.key_encoder = copy.deepcopy(self.actor.encoder).requires_grad_(False)
        self.target = copy.deepcopy(self.critic).requires_grad_(False)
        self.log_temperature = nn.Parameter(torch.tensor(math.log(settings.temperature)))
        self.updates = 0
        self._entropy = -float(sight.controls)
        self.to(self._device)
        encoder, lqr = self.actor.encoder, self.actor.lqr
        self.optimizers = {
            "critic": self._adam(chain(encoder.parameters(), self.critic.parameters())),
            "contrast": self._adam(chain(encoder.parameters(), [self.W])),
            "model": self._adam([lqr.A, lqr.B]),
            "actor": self._adam(self.actor.parameters()),
            "temperature": self._adam([self.log_temperature]),
        }

    def _adam(self, parameters: object) -> torch.optim.Optimizer:
        return torch.optim.Adam(list(parameters), lr=self.settings.learning_rate, fused=True)  # type: ignore[call-overload]

    def act(self, x: NDArray[np.generic], generator: torch.Generator) -> NDArray[np.float32]:
        """Return an action (m,) for an observation (*shape), with the noise that explores."""
        with torch.no_grad():
            z = self.actor.encoder(torch.from_numpy(np.asarray(x, np.float32))[None].to(self._device))
            action: NDArray[np.float32] = self.actor.sample(z, generator)[0][0].cpu().numpy()
        return action

    def update(self, data: Transitions, generator: torch.Generator) -> None:
        """Learn from a batch of steps.

        Args:
            data: the batch.
            generator: of all noise, on the CPU.
        """
        x, u, reward, x_next, terminated = (torch.from_numpy(it).to(self._device).float() for it in data)
        query, key = self._augmented(x, generator), self._augmented(x, generator)
        if self.settings.crop:  # images: as in CURL all losses see a window at random
            x, x_next = query, self._augmented(x_next, generator)
        z, z_next = self._update_critic(x, u, reward, x_next, terminated, generator)
        self._update_contrast(query, key)
        self._step("model", self.actor.lqr.model_loss(z, u, z_next))
        if self.updates % self.settings.actor_every == 0:
            self._update_actor(x, generator)
            _follow(self.target, self.critic, self.settings.critic_rate)
            _follow(self.key_encoder, self.actor.encoder, self.settings.encoder_rate)
        _follow(self.averaged, self.actor, self.settings.average_rate)
        self.updates += 1

    def _augmented(self, x: Tensor, generator: torch.Generator) -> Tensor:
        if self.settings.crop:
            return random_crop(x, self.settings.crop, generator)
        return noisy(x, self.settings.noise, generator)

    def _update_critic(
        self, x: Tensor, u: Tensor, reward: Tensor, x_next: Tensor, terminated: Tensor, generator: torch.Generator
    ) -> tuple[Tensor, Tensor]:
        """Train critics and encoder; return z and z_next as the encoder was before."""
        z = self.actor.encoder(x)
        with torch.no_grad():
            z_next = self.actor.encoder(x_next)
            u_next, log_density = self.actor.sample(z_next, generator)
            value = self.target(self.key_encoder(x_next), u_next).amin(dim=0)
            value = value - self.log_temperature.exp() * log_density
            goal = reward + self.settings.discount * (1.0 - terminated) * value
        self._step("critic", (self.critic(z, u) - goal).square().mean(dim=1).sum())
        return z.detach(), z_next

    def _update_contrast(self, query: Tensor, key: Tensor) -> None:
        with torch.no_grad():
            keys = self.key_encoder(key)
        self._step("contrast", info_nce(self.actor.encoder(query), keys, self.W))

    def _update_actor(self, x: Tensor, generator: torch.Generator) -> None:
        z = self.actor.encoder(x)
        u, log_density = self.actor.sample(z, generator)
        self.critic.requires_grad_(False)
        value = self.critic(z.detach(), u).amin(dim=0)
        self._step("actor", (self.log_temperature.exp().detach() * log_density - value).mean())
        self.critic.requires_grad_(True)
        surprise = (log_density.detach() + self._entropy).mean()
        self._step("temperature", -self.log_temperature.exp() * surprise)

    def _step(self, name: str, loss: Tensor) -> None:
        optimizer = self.optimizers[name]
        optimizer.zero_grad()
        torch.autograd.backward(loss)
        optimizer.step()


def _follow(slow: nn.Module, fast: nn.Module, rate: float) -> None:
    """Move one module's parameters towards another's."""
    with torch.no_grad():
        torch._foreach_lerp_(list(slow.parameters()), list(fast.parameters()), rate)


def _array(tensor: Tensor) -> Array:
    return tensor.detach().cpu().numpy().astype(np.float64)
