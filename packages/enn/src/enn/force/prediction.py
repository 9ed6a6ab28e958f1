"""Force prediction: the contact force of a step from what an expert sees in it; its loss is on features and force."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from enn.fitting import EpisodeFitProgress, EpisodeFitSettings, FitReport, digest_of, fit
from enn.force.samples import ForceSamples
from enn.model_file import FittedNetwork
from enn.networks.devices import bfloat16_on_processor, device_of, seeded
from enn.networks.image_network import ImageNetwork, ImageSettings
from enn.networks.normalisation import standardised
from enn.setting_kinds import PixelsOrNone, Units, UnitsOrNone, settings

_CLIP = 8.0  # standard deviations: beyond them a vector entry says nothing more


@settings
class ForceNetworkSettings:
    """What shapes of weights depend on."""

    # channels, height, width; all 0: no images
    image_shape: tuple[UnitsOrNone, PixelsOrNone, PixelsOrNone] = (1, 80, 80)
    vector: UnitsOrNone = 0  # numbers beside the images (joints, feeder, action); 0: images alone, as in the thesis
    matched: UnitsOrNone = 0  # size of the feature vector that is predicted too; 0: none
    variant: str = "desk"  # of the image network, "thesis" or "desk"
    image_features: Units = 256
    hidden: tuple[Units, ...] = (128, 128)  # units of the head's layers

    def __post_init__(self) -> None:
        if self.image_shape[0] == 0 and self.vector == 0:
            raise ValueError("a force network needs images or numbers to predict from, got neither")
        if self.image_shape[0] and not min(self.image_shape):
            raise ValueError(f"image_shape must be channels, height and width above 0, got {self.image_shape}")


@settings
class ForcePredictionSettings:
    """How the force is learnt.

    Attributes:
        network: its sizes that are free; shapes come from the samples.

    Source: thesis, section Downstream Tasks, Force Prediction.
    """

    network: ForceNetworkSettings = field(default_factory=ForceNetworkSettings)
    fit: EpisodeFitSettings = field(default_factory=EpisodeFitSettings)


DESK_FORCE = ForcePredictionSettings(
    fit=EpisodeFitSettings(
        epochs=15, batch_size=128, learning_rate=2e-3, weight_decay=1e-2, schedule="one_cycle", validation_share=0.0
    )
)
THESIS_FORCE = ForcePredictionSettings(
    network=ForceNetworkSettings(variant="thesis", image_features=128, hidden=(128,)),
    fit=EpisodeFitSettings(epochs=100, batch_size=32, learning_rate=1e-3, schedule="one_cycle", validation_share=0.0),
)


def force_preset(variant: str) -> ForcePredictionSettings:
    """The settings of a variant, "thesis" or "desk"."""
    presets = {"thesis": THESIS_FORCE, "desk": DESK_FORCE}
    if variant not in presets:
        raise ValueError(f"unknown variant '{variant}'; there are {', '.join(presets)}")
    return presets[variant]


class ForceNetwork(nn.Module):
    """Images and numbers to the feature vector Z and the force, in units of their scales."""

    vector_mean: Tensor
    vector_scale: Tensor
    force_scale: Tensor

    def __init__(self, settings: ForceNetworkSettings) -> None:
        super().__init__()
        self.settings = settings
        self.images: ImageNetwork | None = None
        size = settings.vector
        if settings.image_shape[0]:
            channels, height, width = settings.image_shape
            self.images = ImageNetwork(
                ImageSettings((channels, height, width), settings.variant, settings.image_features)
            )
            size += settings.image_features
        self.register_buffer("vector_mean", torch.zeros(settings.vector))
        self.register_buffer("vector_scale", torch.ones(settings.vector))
        self.register_buffer("force_scale", torch.ones(()))
        self.features = nn.Linear(size, settings.matched) if settings.matched else None
        layers: list[nn.Module] = []
        size += settings.matched
        for units in settings.hidden:
            layers += [nn.Linear(size, units), nn.SiLU()]
            size = units
        self.head = nn.Sequential(*layers, nn.Linear(size, 1))

    def fit_scales(self, samples: ForceSamples) -> None:
        """Takes means and scales of images, numbers and forces from the training samples."""
        if self.images is not None:
            self.images.fit_background(torch.as_tensor(samples.images))
        if self.settings.vector:
            self.vector_mean.copy_(torch.as_tensor(samples.vectors.mean(0)))
            self.vector_scale.copy_(torch.as_tensor(samples.vectors.std(0) + 1e-6))
        self.force_scale.fill_(float(samples.forces.std()) + 1e-9)

    def forward(self, images: Tensor, vectors: Tensor) -> tuple[Tensor, Tensor]:
        """Predicts features (N, matched) and forces (N,), the latter in units of `force_scale`."""
        parts = [] if self.images is None else [self.images(images)]
        if self.settings.vector:
            scaled = (vectors - self.vector_mean) / self.vector_scale
            parts.append(scaled.clamp(-_CLIP, _CLIP))
        known = torch.cat(parts, dim=1)
        features = known.new_zeros(len(known), 0) if self.features is None else self.features(known)
        return features, self.head(torch.cat((known, features), dim=1)).squeeze(1)


def fit_force(
    samples: ForceSamples,
    settings: ForcePredictionSettings = DESK_FORCE,
    *,
    seed: int = 0,
    folder: Path | str | None = None,
    progress: Callable[[EpisodeFitProgress], None] | None = None,
    device: torch.device | str = "cpu",
) -> tuple[ForcePredictor, FitReport]:
    """Learns to predict contact forces.

    Args:
        folder: for a checkpoint, from which an interrupted fit goes on.

    Returns:
        The predictor, and what the fit was like.

    Raises:
        FitError: a checkpoint of something else.
    """
    matched = 0 if samples.features is None else samples.features.shape[1]
    network_settings = replace(
        settings.network,
        image_shape=tuple(samples.images.shape[1:]),
        vector=samples.vectors.shape[1],
        matched=matched,
    )
    images, vectors = torch.as_tensor(samples.images), torch.as_tensor(samples.vectors)
    with seeded(seed, device):
        network = ForceNetwork(network_settings)
        network.fit_scales(samples)
        forces = torch.as_tensor(samples.forces) / network.force_scale
        target = torch.zeros(len(forces), 0)
        if matched and samples.features is not None:
            target = torch.as_tensor(standardised(samples.features))
        network.to(device)

        def loss(batch: NDArray[np.int64], training: bool, generator: np.random.Generator) -> Tensor:
            index = torch.as_tensor(batch)
            with bfloat16_on_processor():
                features, force = network(images[index].to(device), vectors[index].to(device))
            features, force = features.float(), force.float()
            value = nn.functional.mse_loss(force, forces[index].to(device))
            if matched and training:  # the best epoch is the one with the best force
                value = value + nn.functional.mse_loss(features, target[index].to(device))
            return value

        digest = (
            ""
            if folder is None
            else digest_of(samples.images, samples.vectors, samples.forces, replace(settings, fit=EpisodeFitSettings()))
        )
        report = fit(
            network, loss, samples.episodes, settings.fit, seed=seed, samples=digest, folder=folder, progress=progress
        )
    return ForcePredictor(network), report


class ForcePredictor(FittedNetwork[ForceNetwork]):
    """A fitted network: what is seen in a step to the contact force, in newtons."""

    FORMAT, KIND, VERB = "enn-force-predictor-1", "force predictor", "fit"

    @classmethod
    def build(cls, settings: dict[str, Any]) -> ForceNetwork:
        """The network with fresh weights, from the fields of its settings."""
        return ForceNetwork(ForceNetworkSettings(**settings))

    def predict(self, images: NDArray[np.uint8], vectors: NDArray[np.float32] | None = None) -> NDArray[np.float64]:
        """Forces of N samples.

        Args:
            images: (N, channels, height, width) uint8; without channels where none are seen.
            vectors: (N, v), or None for images alone.

        Returns:
            (N,) N, not negative.

        Raises:
            ValueError: another shape than in training, or numbers that are not finite.
        """
        settings = self.network.settings
        numbers = np.zeros((len(images), 0), np.float32) if vectors is None else vectors
        if images.shape[1:] != tuple(settings.image_shape) or numbers.shape[1:] != (settings.vector,):
            raise ValueError(
                f"the predictor was fitted to images of shape {tuple(settings.image_shape)} and {settings.vector} "
                f"numbers, got {images.shape[1:]} and {numbers.shape[1:]}: another image size, wire or set of inputs"
            )
        if not np.isfinite(numbers).all():
            raise ValueError("the numbers to predict forces from are not finite: look at what makes the observations")
        parts, device = [], device_of(self.network)
        with torch.inference_mode():
            for start in range(0, len(images), 512):
                batch = slice(start, start + 512)
                seen = torch.as_tensor(images[batch]).to(device), torch.as_tensor(numbers[batch]).to(device)
                _, force = self.network(*seen)
                parts.append(force.cpu().double() * self.network.force_scale.cpu().double())
        return np.clip(torch.cat(parts).numpy() if parts else np.zeros(0), 0.0, None)
