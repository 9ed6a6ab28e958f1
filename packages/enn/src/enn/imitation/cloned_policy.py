"""Cloned policy: the image network with a Gaussian head that imitation fits, used and kept like any other policy."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from enn.model_file import FittedNetwork
from enn.networks.devices import device_of
from enn.networks.image_network import ImageNetwork, ImageSettings
from enn.networks.observation_spaces import require_keys
from enn.setting_kinds import Pixels, Units, UnitsOrNone, settings

KEYS = ("image", "mask", "sequential")
_LOG_STD_RANGE = (-4.0, 1.0)  # a deterministic expert would drive the likelihood to infinity


@settings
class CloningNetworkSettings:
    """What shapes of weights depend on."""

    # image observations, stacked as channels: "image" alone as in the thesis, ("image", "mask"),
    keys: tuple[str, ...] = ("image",)
    shape: tuple[Units, Pixels, Pixels] = (1, 80, 80)  # channels of all together, height, width
    actions: Units = 2
    variant: str = "desk"  # "thesis" or "desk", see `enn.networks.image_network`
    features: Units = 128  # Z of the student
    expert_features: UnitsOrNone = 0  # size of the expert's Z that is matched; 0: none

    def __post_init__(self) -> None:
        if not self.keys or any(key not in KEYS for key in self.keys):
            raise ValueError(f"a cloned policy sees some of {', '.join(KEYS)}, got {', '.join(self.keys) or 'none'}")


class CloningNetwork(nn.Module):
    """Images to features Z, and these to the mean of a Gaussian over actions."""

    def __init__(self, settings: CloningNetworkSettings) -> None:
        super().__init__()
        self.settings = settings
        channels, height, width = settings.shape
        self.images = ImageNetwork(ImageSettings((channels, height, width), settings.variant, settings.features))
        self.head = nn.Linear(settings.features, settings.actions)
        self._log_std = nn.Parameter(torch.full((settings.actions,), -0.5))
        self.matching: nn.Module = (
            nn.Linear(settings.features, settings.expert_features) if settings.expert_features else nn.Identity()
        )

    @property
    def log_std(self) -> Tensor:
        """Logarithm of the Gaussian's standard deviation, the same for all states. Shape (actions,)."""
        return self._log_std.clamp(*_LOG_STD_RANGE)

    def features(self, images: Tensor) -> Tensor:
        """Z of images (N, channels, height, width). Shape (N, features)."""
        features: Tensor = self.images(images)
        return features

    def forward(self, images: Tensor) -> Tensor:
        """Mean action. Shape (N, actions)."""
        mean: Tensor = self.head(self.features(images))
        return mean

    def layers(self) -> nn.Sequential:
        """From image to action scores as one sequence, as the thesis's table lists it."""
        return nn.Sequential(*self.images.layers, self.head)


class ClonedPolicy(FittedNetwork[CloningNetwork]):
    """A student: image observations to actions."""

    FORMAT, KIND, VERB = "enn-cloned-policy-1", "cloned policy", "clone"
    action_repeat = 1

    @classmethod
    def build(cls, settings: dict[str, Any]) -> CloningNetwork:
        """The network with fresh weights, from the fields of its settings."""
        return CloningNetwork(CloningNetworkSettings(**settings))

    @property
    def keys(self) -> tuple[str, ...]:
        """Names of the observations that it sees."""
        return self.network.settings.keys

    def act(
        self,
        observation: Mapping[str, NDArray[Any]],
        deterministic: bool = True,
        generator: np.random.Generator | None = None,
    ) -> NDArray[np.float32]:
        """The action for one observation.

        Returns:
            Within -1 and 1. Shape (actions,).

        Raises:
            ValueError: as `act_batch`.
        """
        require_keys(self.keys, observation)
        return self.act_batch({key: observation[key][None] for key in self.keys}, deterministic, generator)[0]

    def act_batch(
        self,
        observations: Mapping[str, NDArray[Any]],
        deterministic: bool = True,
        generator: np.random.Generator | None = None,
    ) -> NDArray[np.float32]:
        """Actions for observations with a leading N. Shape (N, actions).

        Raises:
            ValueError: an observation is missing, has another shape than in training, or is not finite; a draw
                without a generator.
        """
        with torch.inference_mode():
            mean = self.network(self._images(observations)).cpu().numpy()
            if not deterministic:
                if generator is None:
                    raise ValueError("a stochastic action needs a seeded numpy Generator")
                spread = self.network.log_std.exp().cpu().numpy()
                mean = mean + spread * generator.standard_normal(mean.shape, np.float32)
        return np.clip(mean, -1.0, 1.0)

    def features(self, observations: Mapping[str, NDArray[Any]]) -> NDArray[np.float32]:
        """Z of observations with a leading N. Shape (N, features)."""
        with torch.inference_mode():
            features: NDArray[np.float32] = self.network.features(self._images(observations)).cpu().numpy()
        return features

    def controller(
        self, deterministic: bool = True, seed: int = 0
    ) -> Callable[[Mapping[str, NDArray[Any]], Any], NDArray[np.float32]]:
        """The policy as a function of observation and info."""
        generator = np.random.default_rng(seed)

        def control(observation: Mapping[str, NDArray[Any]], info: Any = None) -> NDArray[np.float32]:
            return self.act(observation, deterministic, generator)

        return control

    def _images(self, observations: Mapping[str, NDArray[Any]]) -> Tensor:
        require_keys(self.keys, observations)
        images = np.concatenate([observations[key] for key in self.keys], axis=1)
        if images.shape[1:] != tuple(self.network.settings.shape):
            raise ValueError(
                f"the policy was trained with images of shape {tuple(self.network.settings.shape)}, got "
                f"{images.shape[1:]}: make the environment with that image_size"
            )
        if images.dtype.kind == "f" and not np.isfinite(images).all():
            raise ValueError("an image is not finite: look at what makes the observations")
        return torch.as_tensor(images).to(device_of(self.network))
