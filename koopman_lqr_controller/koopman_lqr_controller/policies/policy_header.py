"""Schema of policy file headers: types and ranges that permit a controller and safe driving."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from ctrl_rl_core.io import Name, Positive, Schema, Tensors
from pydantic import ConfigDict, Field, model_validator

from koopman_lqr_controller.safety.guards import LatentDistribution
from koopman_lqr_controller.sensing.lidar_observation import LidarObservation
from koopman_lqr_controller.sensing.observables import CorridorObservables

_Length = Annotated[float, Field(gt=0.0, le=1e4)]
_Bearing = Annotated[float, Field(gt=0.0, lt=180.0)]
_Size = Annotated[int, Field(ge=1, le=100_000)]
_TimeStep = Annotated[float, Field(gt=0.0, le=60.0)]
_LARGEST_OBSERVATION = 1_000_000
_REGION = ("mean", "covariance")


class _Sight(Schema):
    """Distances of the lidar observation [m]."""

    near: _Length
    closest: _Length
    far: _Length

    @model_validator(mode="after")
    def _in_order(self) -> _Sight:
        if not self.closest < self.far:
            raise ValueError("closest must lie below far")
        return self


class _Observables(_Sight):
    bearings_deg: Annotated[list[_Bearing], Field(min_length=1, max_length=1000)]
    half_width_deg: Annotated[float, Field(gt=0.0, le=90.0)]

    @property
    def observables(self) -> CorridorObservables:
        return CorridorObservables(tuple(self.bearings_deg), self.half_width_deg, self.near, self.closest, self.far)


class _Observation(_Sight):
    count: Annotated[int, Field(ge=4, le=2000)]
    speed: _Length
    turn: _Length

    @property
    def observation(self) -> LidarObservation:
        return LidarObservation(**dict(self))


class _Weights(Schema):
    """Weights of the two-stage cost."""

    side: Annotated[float, Field(ge=0.0, le=1e9)]
    ahead: Annotated[float, Field(ge=0.0, le=1e9)]
    speed: Annotated[float, Field(ge=0.0, le=1e9)]
    acceleration: Annotated[float, Field(gt=0.0, le=1e9)]
    turning: Annotated[float, Field(gt=0.0, le=1e9)]


class _Manifest(Schema):
    """Provenance of a policy; other keys are for human readers."""

    model_config = ConfigDict(extra="allow", allow_inf_nan=True)

    task: str | None = None
    task_digest: str | None = None
    command: str = ""
    dt: _TimeStep | None = None
    weights: _Weights | None = None


class _Region(Schema):
    distance: Positive
    error: Positive


class _Header(Schema):
    action: Annotated[list[Name], Field(max_length=100)] | None = None
    manifest: _Manifest
    region: _Region | None = None

    def training_distribution(self, tensors: Tensors) -> LatentDistribution | None:
        """Return the training distribution; None for files that predate it."""
        if self.region is None:
            return None
        mean, covariance = (tensors[f"region.{name}"].astype(float) for name in _REGION)
        return LatentDistribution(mean, covariance, self.region.distance, self.region.error)


class EdmdHeader(_Header):
    """Header of a policy with user-defined observables."""

    format: Literal["koopman-lqr-1"]
    observables: _Observables
    observation: Annotated[list[Name], Field(max_length=2000)] | None = None


class _Dense(Schema):
    kind: Literal["dense"]
    rectified: bool


class _Convolution(Schema):
    kind: Literal["convolution"]
    stride: Annotated[int, Field(ge=1, le=64)]


class _CentreCrop(Schema):
    kind: Literal["centre_crop"]
    size: Annotated[int, Field(ge=1, le=2000)]


class _Other(Schema):
    kind: Literal["flatten", "rectifier", "layer_norm"]


_Layer = Annotated[_Dense | _Convolution | _CentreCrop | _Other, Field(discriminator="kind")]


class EncoderHeader(Schema):
    """Header of an encoder."""

    shape: Annotated[list[_Size], Field(min_length=1, max_length=3)]
    layers: Annotated[list[_Layer], Field(max_length=100)]
    inclusive: bool = False

    @model_validator(mode="after")
    def _of_a_size(self) -> EncoderHeader:
        if math.prod(self.shape) > _LARGEST_OBSERVATION:
            raise ValueError(f"shape: an observation of more than {_LARGEST_OBSERVATION:,} numbers")
        return self


class LatentHeader(_Header):
    """Header of a policy with a learnt embedding."""

    format: Literal["koopman-latent-2"]
    encoder: EncoderHeader
    dt: _TimeStep
    horizon: Annotated[int, Field(ge=1, le=10_000)] | None
    observation: _Observation | None = None
