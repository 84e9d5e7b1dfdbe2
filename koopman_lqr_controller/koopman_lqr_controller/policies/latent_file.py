"""The two parts of a latent policy's file: a JSON header and tensors. `policy_file` reads and writes the file."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np
from ctrl_rl_core.io.checked_tensors import Tensors
from numpy.typing import NDArray

from koopman_lqr_controller.control.latent_controller import LatentController
from koopman_lqr_controller.models.edmd import LinearModel
from koopman_lqr_controller.models.encoder import Encoder
from koopman_lqr_controller.policies.latent_policy import LatentPolicy, RobotInterface
from koopman_lqr_controller.policies.policy_header import LatentHeader

FORMAT = "koopman-latent-2"
_LQR = ("A", "B", "Q", "R", "z_ref")
_REFERENCE = ("a_ref", "drift")
_COMMAND_LIMITS = ("u_low", "u_high")


def describe_latent(policy: LatentPolicy) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Return what `build_latent` makes the policy from again."""
    controller, robot_interface = policy.controller, policy.robot_interface
    encoder, tensors = controller.encoder.describe()
    arrays: dict[str, NDArray[Any]] = {**tensors, "A": controller.model.A, "B": controller.model.B}
    arrays |= {"Q": controller.Q, "R": controller.R, "z_ref": controller.z_ref}
    if controller.horizon is None:
        arrays |= {name: getattr(controller, name) for name in _REFERENCE}
    if controller.projection is not None:
        arrays["projection"] = controller.projection
    header: dict[str, Any] = {
        "format": FORMAT,
        "encoder": encoder,
        "dt": policy.dt,
        "horizon": controller.horizon,
        "manifest": dict(policy.manifest),
    }
    if robot_interface is not None:
        arrays |= {"u_low": robot_interface.u_low, "u_high": robot_interface.u_high}
        header["observation"] = asdict(robot_interface.observation)
        header["action"] = ["speed [m/s]", "turn rate [rad/s]"]
    return header, arrays


def build_latent(told: LatentHeader, tensors: Tensors) -> LatentPolicy:
    """Return the policy; its gain is computed anew.

    Raises:
        KoopmanError: the parts do not fit each other, or there is no regulator.
        KeyError: a tensor is missing.
    """
    wanted = _LQR if told.horizon is not None else _LQR + _REFERENCE
    given = {name: np.ascontiguousarray(tensors[name], dtype=np.float64) for name in wanted}
    projection = tensors.get("projection")
    controller = LatentController(
        encoder=Encoder.build(told.encoder.model_dump(), tensors),
        model=LinearModel(given["A"], given["B"]),
        Q=given["Q"],
        R=given["R"],
        z_ref=given["z_ref"],
        a_ref=given.get("a_ref"),
        drift=given.get("drift"),
        horizon=told.horizon,
        projection=None if projection is None else projection.astype(np.float64),
    )
    robot_interface = None
    if told.observation is not None:
        low, high = (tensors[name].astype(np.float64) for name in _COMMAND_LIMITS)
        robot_interface = RobotInterface(told.observation.observation, low, high)
    manifest = told.manifest.model_dump(exclude_unset=True)
    return LatentPolicy(controller, told.dt, robot_interface, manifest, told.training_distribution(tensors))
