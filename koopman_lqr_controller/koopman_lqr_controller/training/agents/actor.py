"""Actors: an encoder and a stochastic policy on z, linear as in the thesis or a network as in CURL."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from koopman_lqr_controller.arrays import Array
from koopman_lqr_controller.control.latent_controller import LatentController
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.models.edmd import LinearModel
from koopman_lqr_controller.training.agents.network_policy import NetworkPolicy
from koopman_lqr_controller.training.networks.differentiable_lqr import LatentLqr
from koopman_lqr_controller.training.networks.networks import TorchEncoder, dense, deploy_layers
from koopman_lqr_controller.training.settings import Settings

_LOG_DEVIATIONS = (-5.0, 1.0)
"""Bounds of the logarithm of the controls' standard deviation."""


class AgentInterface(NamedTuple):
    """Observations and controls of an agent.

    Attributes:
        shape: Shape of one observation.
        controls: Number of controls.
        middle: Value of an observation that maps to 0; broadcasts to `shape`.
        unit: Distance from `middle` that maps to 1.
        goal: Observation of the goal, x_ref; None for z_ref = 0.
        kind: Data type of an observation.
    """

    shape: tuple[int, ...]
    controls: int
    middle: NDArray[np.float32]
    unit: NDArray[np.float32]
    goal: NDArray[np.float32] | None
    kind: type[np.generic] = np.float32

    def encoder(self, settings: Settings) -> TorchEncoder:
        """Create an untrained encoder psi."""
        middle, unit = torch.from_numpy(self.middle), torch.from_numpy(self.unit)
        if settings.scale == "seen":  # each component has its own scale
            middle, unit = (scale.expand(self.shape).clone() for scale in (middle, unit))
        sizes, crop = (self.shape, settings.latent, settings.hidden, settings.depth), settings.crop or None
        halved, normalised = settings.bfloat16 == "all", settings.critic == "model_based"
        return TorchEncoder(*sizes, middle, unit, crop, halved, normalised, settings.depth_behind)


class Actor(nn.Module, ABC):
    """A squashed Gaussian policy on z; only its deterministic part is deployed.

    Attributes:
        encoder: Embedding psi of observations.
        raw_deviation: Unbounded parameter of the log standard deviation of the controls, shared (1,) or per control
            (m,).
    """

    def __init__(self, interface: AgentInterface, settings: Settings) -> None:
        super().__init__()
        self.encoder = interface.encoder(settings)
        low, high = _LOG_DEVIATIONS
        if not math.exp(low) < settings.deviation < math.exp(high):
            raise KoopmanError(
                f"deviation is {settings.deviation}: must lie between {math.exp(low):.3g} and {math.exp(high):.3g}"
            )
        share = 2.0 * (math.log(settings.deviation) - low) / (high - low) - 1.0
        count = interface.controls if settings.deviations == "each" else 1
        self.raw_deviation = nn.Parameter(torch.full((count,), math.atanh(share)))

    @abstractmethod
    def mean(self, z: Tensor) -> Tensor:
        """Return u of the deterministic policy (N, m), before tanh."""

    @abstractmethod
    def deploy(self) -> LatentController | NetworkPolicy:
        """Return the current deterministic policy without torch."""

    @property
    def log_deviation(self) -> Tensor:
        """Log standard deviation before tanh (1,) or (m,), bounded by a tanh, which always has a gradient."""
        low, high = _LOG_DEVIATIONS
        return low + 0.5 * (high - low) * (torch.tanh(self.raw_deviation) + 1.0)

    def sample(self, z: Tensor, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """Sample actions in [-1, 1] (N, m), and return them with their log density (N,)."""
        mean = self.mean(z)
        log_deviation = self.log_deviation
        noise = torch.randn(mean.shape, generator=generator).to(mean.device)
        u = mean + log_deviation.exp() * noise
        normal = -0.5 * noise.square() - log_deviation - 0.5 * math.log(2.0 * math.pi)
        squash = 2.0 * (math.log(2.0) - u - nn.functional.softplus(-2.0 * u))  # log (1 - tanh^2 u)
        return torch.tanh(u), (normal - squash).sum(dim=1)


class LqrActor(Actor):
    """The regulator of a learnt model (Eq. 4.9).

    Attributes:
        lqr: Learnt A, B, Q, R.
        goal: Goal observation x_ref (1, *shape); empty without a goal.
    """

    goal: Tensor

    def __init__(self, interface: AgentInterface, settings: Settings) -> None:
        super().__init__(interface, settings)
        self.lqr = LatentLqr(settings.latent, interface.controls, settings.riccati_iterations)
        goal = torch.zeros(0, *interface.shape) if interface.goal is None else torch.from_numpy(interface.goal)[None]
        self.register_buffer("goal", goal)

    def z_ref(self) -> Tensor:
        """Return psi(x_ref), or zeros (n,)."""
        return self.encoder(self.goal)[0] if len(self.goal) else torch.zeros_like(self.lqr.log_Q)

    def mean(self, z: Tensor) -> Tensor:
        """Return u of the linear law (N, m), before tanh; K is G in the thesis."""
        K, k = self.lqr.gain(self.z_ref())
        return k - z @ K.T

    def deploy(self) -> LatentController:
        """Return the current deterministic controller without torch.

        z_ref is the one used in training; with hidden layers in bfloat16, it includes their rounding.
        """
        with torch.no_grad():
            z_ref = self.z_ref()
        lqr = self.lqr
        A, B, Q, R, goal = (_array(t) for t in (lqr.A, lqr.B, lqr.log_Q.exp(), lqr.log_R.exp(), z_ref))
        return LatentController(self.encoder.deploy(), LinearModel(A, B), Q, R, goal, lqr.iterations)


class NetworkActor(Actor):
    """A model-free policy with two hidden layers as large as the critics', without control-theoretic structure.

    Attributes:
        layers: Layers of the policy.
    """

    def __init__(self, interface: AgentInterface, settings: Settings) -> None:
        super().__init__(interface, settings)
        body = dense(settings.latent, settings.hidden, 2)
        self.layers = nn.Sequential(*body, nn.Linear(settings.hidden, interface.controls))

    def mean(self, z: Tensor) -> Tensor:
        """Return u of the network (N, m), before tanh."""
        u: Tensor = self.layers(z)
        return u

    def deploy(self) -> NetworkPolicy:
        """Return encoder and policy as one network."""
        return NetworkPolicy(self.encoder.deploy().followed_by(deploy_layers(self.layers)))


def make_actor(interface: AgentInterface, settings: Settings) -> LqrActor | NetworkActor:
    """Create the untrained actor selected by the settings."""
    return NetworkActor(interface, settings) if settings.policy == "network" else LqrActor(interface, settings)


def _array(tensor: Tensor) -> Array:
    return tensor.detach().cpu().numpy().astype(np.float64)
