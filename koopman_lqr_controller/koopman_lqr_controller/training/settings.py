"""The hyperparameters of a learner, the same for all tasks but for the changes of a benchmark task."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

from koopman_lqr_controller.errors import KoopmanError

RECIPES: Mapping[str, Mapping[str, int | float | str]] = {
    "thesis": {},
    "quick": {
        "critic_input": "observation",
        "scale": "seen",
        "encoder_loss": "nothing",
        "learning_rate": 3e-4,
        "model_weight": 0.02,
        "critic_rate": 0.02,
        "updates": 2,
        "actor_every": 1,
        "deviation": 0.135,
        "deviations": "each",
    },
    "model_based": {
        "critic": "model_based",
        "scale": "seen",
        "encoder_loss": "nothing",
        "depth": 3,
        "depth_behind": 2,
        "learning_rate": 3e-4,
        "model_weight": 0.02,
        "reward_steps": 3,
        "model_steps": 3,
    },
}
"""Changes of a task's settings by name. "thesis": none, Algorithm 2. "quick": critics of scaled observations, and A and
B that follow the actor's loss above all; it learns more from as many simulated frames, of vectors. "model_based":
values and features after MR.Q, whose model looks several steps ahead; it begins later than "quick" and ends higher on
the cheetah, the task that it was measured on."""
_KINDS = {"int": "a whole number", "float": "a number"}
_CHOICES = {
    "encoder_loss": ("contrastive", "reconstruction", "reconstruction_prediction", "nothing"),
    "policy": ("lqr", "network"),
    "critic": ("layer_norm", "plain", "categorical", "model_based"),
    "critic_input": ("latent", "observation"),
    "scale": ("task", "seen"),
    "deviations": ("one", "each"),
    "bfloat16": ("nothing", "all"),
    "cost": ("Q1", "Q2", "Q3", "Q4"),
}
_MAY_BE_ZERO = ("depth_behind", "crop", "noise", "model_weight")
_LEAST_REPLAY = 100
_SHARES = ("discount", "critic_rate", "encoder_rate", "average_rate", "exploration")


@dataclass(frozen=True)
class Settings:
    """Hyperparameters of a learner.

    Attributes:
        latent: Dimensions of z.
        riccati_iterations: Number M of iterations of Algorithm 1.
        hidden: Units of each hidden layer.
        depth: Hidden layers of an encoder of vectors, convolutions of one of images.
        depth_behind: Hidden layers between these and z. With a "model_based" critic the actor's loss trains them, and
            the model's loss those before them.
        crop: Rows and columns of an image that the encoder looks at; 0 for vectors.
        learning_rate: Learning rate of all networks.
        model_weight: Weight of the model loss in the actor's steps; 0 where A and B have steps of their own for it, or
            none with a "model_based" critic, whose values are in units of the mean reward.
        batch: Steps in an update.
        discount: Discount gamma of rewards.
        reward_steps: Rewards in the goal of a value, before the target critic says what follows.
        first_steps: Actions at random before learning begins.
        replay: Steps that are remembered.
        temperature: Temperature alpha to begin with.
        deviation: Standard deviation of the controls to begin with, before tanh.
        deviations: "one" deviation for all controls, as in the thesis, or one for "each".
        critic_rate: Rate at which the target critic follows.
        encoder_rate: Rate at which the key encoder follows.
        update_every: Actions before updates.
        updates: Number of updates at a time.
        actor_every: Updates of the critic for one of actor and targets.
        noise: Noise eta of Eq. 4.5.
        average_rate: Rate at which the averaged actor follows.
        encoder_loss: Loss of the encoder besides the task's: "contrastive" (Eq. 4.4), or that of an autoencoder,
            "reconstruction", or "reconstruction_prediction", which decodes the model's next z as well (4.3.5); or
            "nothing", where the task's loss alone trains it.
        policy: "lqr", or "network" as in CURL.
        critic: "plain" hidden layers, or each with a "layer_norm": values cannot run away, and policies oscillate less;
            or "categorical", a distribution of values by residual layers, which bears more updates for each action;
            or "model_based", values of what a model of several steps makes of observations and actions (MR.Q): the
            actor has a fixed noise then and no temperature, its features are the model's, and the hidden layers behind
            them and z its own; critic_input, encoder_loss, encoder_rate, noise, actor_every, critic_rate and what
            concerns deviations are of no effect.
        critic_input: State that the critics see: the "latent" z, as in the thesis, or the "observation" as the encoder
            scales it. The second leaves the encoder to the actor's loss and its own: values need not wait for z, and z
            need not tell values.
        scale: Scale of vectors that are observed: that of the "task", or the mean and deviation of those "seen" so far.
        bfloat16: "all" hidden layers are computed so while learning, or "nothing": a third quicker, if processors can.
        model_steps: Steps that the model of a "model_based" critic looks ahead.
        renewal: Updates for which its targets stay as they are.
        exploration: Deviation of the noise that explores, of actions in [-1, 1], with it.
        cost: Hand-tuned cost of `two_stage_learner`, "Q1" to "Q4"; of no effect elsewhere.
    """

    latent: int = 50
    riccati_iterations: int = 5
    hidden: int = 256
    depth: int = 2
    depth_behind: int = 0
    crop: int = 0
    learning_rate: float = 5e-4
    model_weight: float = 0.0
    batch: int = 256
    discount: float = 0.99
    reward_steps: int = 1
    first_steps: int = 1000
    replay: int = 100_000
    temperature: float = 0.1
    deviation: float = 1.0
    deviations: str = "one"
    critic_rate: float = 0.01
    encoder_rate: float = 0.05
    update_every: int = 1
    updates: int = 1
    actor_every: int = 2
    noise: float = 0.1
    average_rate: float = 0.005
    encoder_loss: str = "contrastive"
    policy: str = "lqr"
    critic: str = "layer_norm"
    critic_input: str = "latent"
    scale: str = "task"
    bfloat16: str = "nothing"
    model_steps: int = 5
    renewal: int = 250
    exploration: float = 0.2
    cost: str = "Q1"

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name in _CHOICES:
                if value not in _CHOICES[field.name]:
                    raise KoopmanError(f"{field.name} is {value}: must be {' or '.join(_CHOICES[field.name])}")
                continue
            if field.type == "float" and type(value) is int:
                value = float(value)  # 1 and 1.0 are the same setting
                object.__setattr__(self, field.name, value)
            if type(value).__name__ != field.type:
                raise KoopmanError(f"{field.name} is {value!r}: must be {_KINDS[str(field.type)]}")
            if not math.isfinite(value) or value < 0 or (value == 0 and field.name not in _MAY_BE_ZERO):
                raise KoopmanError(f"{field.name} is {value}: must be positive")
            if field.name in _SHARES and value > 1.0:
                raise KoopmanError(f"{field.name} is {value}: must be at most 1")

        if self.replay < _LEAST_REPLAY:
            raise KoopmanError(f"replay is {self.replay}: must be at least {_LEAST_REPLAY} steps to learn from")
        if self.critic == "model_based" and self.reward_steps > self.model_steps:
            raise KoopmanError(f"reward_steps is {self.reward_steps}: must be at most model_steps, {self.model_steps}")
        if self.critic == "model_based" and self.model_steps >= self.replay:
            raise KoopmanError(f"model_steps is {self.model_steps}: must be less than replay, {self.replay}")
        if self.crop and self.critic == "model_based":
            raise KoopmanError("critic must not be model_based: this task shows pictures")
        if self.crop and (self.critic_input == "observation" or self.scale == "seen"):
            raise KoopmanError("critic_input must be latent and scale task: this task shows pictures")
        if self.policy == "network" and self.encoder_loss == "reconstruction_prediction":
            raise KoopmanError("encoder_loss reconstruction_prediction needs a model: policy must be lqr")

    def as_json(self) -> dict[str, Any]:
        """Return all of them by name."""
        return asdict(self)
