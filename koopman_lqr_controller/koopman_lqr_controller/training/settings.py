"""The hyperparameters of a learner, common to all tasks except for changes by a benchmark task."""

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
"""Changes to a task's settings, by recipe name. "thesis": none, Algorithm 2. "quick": critics of scaled observations,
with A and B mainly trained by the actor loss; learns more from the same number of simulated frames, for vectors.
"model_based": values and features as in MR.Q, with a multi-step model; starts more slowly than "quick" and ends higher
on the cheetah, the task on which it was measured."""
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
        latent: Dimension of z.
        riccati_iterations: Number M of iterations of Algorithm 1.
        hidden: Number of units of each hidden layer.
        depth: Number of hidden layers of a vector encoder, or of convolutions of an image encoder.
        depth_behind: Number of hidden layers between these and z. With a "model_based" critic, the actor loss trains
            them, and the model loss the preceding ones.
        crop: Size of the encoder's crop of an image; 0 for vectors.
        learning_rate: Learning rate of all networks.
        model_weight: Weight of the model loss in the actor's steps; 0 gives A and B separate steps for it, or none with
            a "model_based" critic, whose values are in units of the mean reward.
        batch: Number of steps per update.
        discount: Discount gamma of rewards.
        reward_steps: Number of rewards in a value target before bootstrapping from the target critic.
        first_steps: Number of random actions before training starts; up to ten times as many until a reward is not 0.
        replay: Capacity of the replay in steps.
        temperature: Initial temperature alpha.
        deviation: Initial standard deviation of the controls, before tanh.
        deviations: "one" standard deviation for all controls, as in the thesis, or one for "each".
        critic_rate: Update rate of the target critic.
        encoder_rate: Update rate of the key encoder.
        update_every: Number of actions between updates.
        updates: Number of consecutive updates.
        actor_every: Number of critic updates per update of actor and targets.
        noise: Noise eta of Eq. 4.5.
        average_rate: Update rate of the averaged actor.
        encoder_loss: Additional loss of the encoder: "contrastive" (Eq. 4.4); that of an autoencoder, "reconstruction",
            or "reconstruction_prediction", which also decodes the model's next z (4.3.5); or "nothing", so that only
            the task's loss trains it.
        policy: "lqr", or "network" as in CURL.
        critic: "plain" hidden layers; each with a "layer_norm", which prevents diverging values and reduces
            oscillations; "categorical", a distribution of values with residual layers, which tolerates more updates per
            action; or "model_based", values of a multi-step model's embedding of observations and actions (MR.Q): the
            actor then has fixed noise and no temperature, shares the model's features, and has its own hidden layers
            after them and its own z; critic_input, encoder_loss, encoder_rate, noise, actor_every, critic_rate and the
            settings of deviations have no effect.
        critic_input: Input of the critics: the "latent" z, as in the thesis, or the "observation" scaled by the
            encoder. With the latter, only the actor loss and its own loss train the encoder: values need not wait for
            z, and z need not represent values.
        scale: Scale of vector observations: that of the "task", or mean and standard deviation of those "seen" so far.
        bfloat16: Use of bfloat16 in training: for "all" hidden layers, a third faster on suitable processors, or for
            "nothing".
        model_steps: Number of prediction steps of the model of a "model_based" critic.
        renewal: Number of updates between its target updates.
        exploration: Standard deviation of its exploration noise on actions in [-1, 1].
        cost: Hand-tuned cost of `two_stage_learner`, "Q1" to "Q4"; no effect elsewhere.
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
        """Return all settings by name."""
        return asdict(self)
