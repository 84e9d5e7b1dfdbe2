"""Additional encoder losses: contrastive (thesis Eq. 4.4) or autoencoder (4.3.5); augmentations."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn

from koopman_lqr_controller.training.networks.differentiable_lqr import LatentLqr
from koopman_lqr_controller.training.networks.networks import Decoder, TorchEncoder
from koopman_lqr_controller.training.settings import Settings


def info_nce(queries: Tensor, keys: Tensor, W: Tensor) -> Tensor:
    """Return the mean of -log of Eq. 4.4, the cross entropy of matching each query to its own key.

    Args:
        queries: Queries z^q (N, n).
        keys: Keys z^k (N, n); row i belongs to query i, all others are its negatives.
        W: Matrix of the bilinear similarity z^q^T W z^k (n, n).
    """
    similarity = queries @ W @ keys.T
    return torch.nn.functional.cross_entropy(similarity, torch.arange(len(queries), device=queries.device))


def noisy(x: Tensor, eta: float, generator: torch.Generator) -> Tensor:
    """Return x + dx, with dx uniform in -eta |x| .. eta |x| (Eq. 4.5).

    Args:
        x: Observations (N, ...).
        eta: Relative size of the noise.
        generator: Generator on the CPU.
    """
    share = torch.rand(x.shape, generator=generator).to(x.device)
    return x + eta * x.abs() * (2.0 * share - 1.0)


def random_crop(images: Tensor, size: int, generator: torch.Generator) -> Tensor:
    """Crop each image to a uniformly random window.

    Args:
        images: Images (N, channels, height, width).
        size: Rows and columns of a window.
        generator: Generator on the CPU.
    """
    count, _, height, width = images.shape
    tops = torch.randint(height - size + 1, (count,), generator=generator).tolist()
    lefts = torch.randint(width - size + 1, (count,), generator=generator).tolist()
    windows = zip(images, tops, lefts, strict=True)  # much faster than one look-up of all pixels
    return torch.stack([image[:, top : top + size, left : left + size] for image, top, left in windows])


class EncoderBatch(NamedTuple):
    """A batch in the form required by encoder losses.

    Attributes:
        query: Observations, augmented for a contrastive loss or images (N, ...).
        key: The same observations with another augmentation.
        u: Actions (N, m).
        x_next: Next observations.
        key_encoder: The momentum encoder.
        model: A and B, if there is a model.
    """

    query: Tensor
    key: Tensor
    u: Tensor
    x_next: Tensor
    key_encoder: TorchEncoder
    model: LatentLqr | None


class Contrast(nn.Module):
    """InfoNCE (Eq. 4.4) against the momentum encoder's keys.

    Attributes:
        augments: Whether vector observations are augmented by noise.
        W: Matrix of the bilinear similarity (n, n).
    """

    augments = True

    def __init__(self, latent: int) -> None:
        super().__init__()
        self.W = nn.Parameter(torch.rand(latent, latent))

    def forward(self, z: Tensor, seen: EncoderBatch) -> Tensor:
        """Return the loss for z, the encoding of `seen.query`."""
        with torch.no_grad():
            keys = seen.key_encoder(seen.key)
        return info_nce(z, keys, self.W)


class Reconstruction(nn.Module):
    """Autoencoder loss: the mean squared reconstruction error of a decoder of z.

    Args:
        seen: Shape of the encoder's (cropped) input.
        settings: Settings with the layer sizes.
        predicts: Whether the model's next z must also reconstruct the next observation.

    Attributes:
        augments: Whether vector observations are augmented by noise.
        decoder: Decoder from z to the observation, normalised as by the encoder.
    """

    augments = False

    def __init__(self, seen: tuple[int, ...], settings: Settings, predicts: bool) -> None:
        super().__init__()
        self.decoder = Decoder(seen, settings.latent, settings.hidden, settings.depth)
        self._predicts = predicts

    def forward(self, z: Tensor, seen: EncoderBatch) -> Tensor:
        """Return the loss for z, the encoding of `seen.query`; collapsed latents do not reduce the prediction loss."""
        loss = nn.functional.mse_loss(self.decoder(z), seen.key_encoder.normalise(seen.query))
        if self._predicts and seen.model is not None:
            predicted = self.decoder(seen.model.predict(z, seen.u))
            loss = loss + nn.functional.mse_loss(predicted, seen.key_encoder.normalise(seen.x_next))
        return loss


def make_encoder_loss(encoder: TorchEncoder, settings: Settings) -> Contrast | Reconstruction | None:
    """Create the untrained loss selected by the settings, or None."""
    if settings.encoder_loss == "nothing":
        return None
    if settings.encoder_loss == "contrastive":
        return Contrast(settings.latent)
    return Reconstruction(encoder.seen, settings, settings.encoder_loss == "reconstruction_prediction")
