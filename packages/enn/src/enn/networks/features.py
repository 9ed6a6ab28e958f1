"""Feature extractors of image, mask and joints, and their fusion: the thesis's networks and light ones for a CPU."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
import torch
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import nn

VARIANTS = ("thesis", "desk", "baselines")
IMAGE_FEATURES = (128, 256)  # the thesis's table, its text
FUSED = (256, 128)  # units of the fusion MLP, whose sizes the thesis does not print; the last is that of Z
DESK_FUSED = (128, 128)


def _dense(sizes: Sequence[int]) -> list[nn.Module]:
    layers: list[nn.Module] = []
    for before, after in itertools.pairwise(sizes):
        layers += [nn.Linear(before, after), nn.ReLU()]
    return layers


def _with_dense(convolutions: Sequence[nn.Module], shape: tuple[int, ...], units: Sequence[int]) -> nn.Sequential:
    """Convolutions, then dense layers on what they leave of an image."""
    body = nn.Sequential(*convolutions, nn.Flatten())
    try:
        with torch.no_grad():
            flat = body(torch.zeros(1, *shape)).shape[1]
    except RuntimeError as error:
        raise ValueError(f"images of shape {shape} are too small for these convolutions: use at least 36 px") from error
    return nn.Sequential(*body, *_dense((flat, *units)))


def nature_convolutions(channels: int) -> list[nn.Module]:
    """The three convolutions that every image network of the thesis begins with."""
    return [
        nn.Conv2d(channels, 32, 8, 4),
        nn.ReLU(),
        nn.Conv2d(32, 64, 4, 2),
        nn.ReLU(),
        nn.Conv2d(64, 64, 3, 1),
        nn.ReLU(),
    ]


def thesis_cnn(shape: tuple[int, ...], features: int = 128) -> nn.Sequential:
    """The thesis's CNN for one image stream.

    Args:
        shape: of the images (channels, height, width).
        features: 128 as in its table; 256 as in its text, which leaves the last layer out.

    Raises:
        ValueError: another number of features, or images that are too small.

    Source: thesis, chapter ENN, table of network architectures.
    """
    if features not in IMAGE_FEATURES:
        raise ValueError(f"image_features is 128 (the thesis's table) or 256 (its text), got {features}")
    return _with_dense(nature_convolutions(shape[0]), shape, (256, 128) if features == 128 else (256,))


def thesis_mlp(inputs: int) -> nn.Sequential:
    """The thesis's MLP for joint positions and velocities: 256, 128. Source: as `thesis_cnn`."""
    return nn.Sequential(*_dense((inputs, 256, 128)))


def nature_cnn(shape: tuple[int, ...]) -> nn.Sequential:
    """The CNN of the reinforcement-learning chapter, which ends in 512 units; shape is (channels, height, width)."""
    return _with_dense(nature_convolutions(shape[0]), shape, (512,))


def desk_cnn(shape: tuple[int, ...]) -> nn.Sequential:
    """A light CNN, about a tenth of the thesis's cost, for image and mask as channels of one picture."""
    convolutions = [
        nn.Conv2d(shape[0], 16, 6, 4, 1),
        nn.ReLU(),
        nn.Conv2d(16, 32, 3, 2, 1),
        nn.ReLU(),
        nn.Conv2d(32, 32, 3, 2, 1),
        nn.ReLU(),
    ]
    return _with_dense(convolutions, shape, (128,))


def desk_mlp(inputs: int) -> nn.Sequential:
    """A small MLP; the normalisation takes joint angles, metres and velocities to one scale."""
    return nn.Sequential(nn.Linear(inputs, 128), nn.LayerNorm(128), nn.ReLU(), nn.Linear(128, 64), nn.ReLU())


def is_image(space: gymnasium.Space[Any]) -> bool:
    """Whether a space holds pictures: three axes of bytes, channels first."""
    return isinstance(space, gymnasium.spaces.Box) and len(space.shape) == 3 and space.dtype == np.uint8


def require_keys(space: gymnasium.Space[Any], keys: Sequence[str]) -> gymnasium.spaces.Dict:
    """The space itself, once it is sure that it is a Dict and has the keys.

    Raises:
        ValueError: says what the observation has.
    """
    if not isinstance(space, gymnasium.spaces.Dict):
        raise ValueError(f"expected a Dict observation with {', '.join(keys)}, got {space}")
    missing = [key for key in keys if key not in space.spaces]
    if missing or not keys:
        needed = f"'{', '.join(missing)}'" if missing else "at least one key"
        raise ValueError(f"the network wants {needed}, but the observation has {', '.join(space.spaces)}")
    return space


class MultimodalExtractor(BaseFeaturesExtractor):
    """One network a modality, concatenated, then an MLP to the compact vector Z.

    Any observation will do: pictures get a CNN, everything else an MLP. `networks` holds them by name, `fusion` their
    MLP.

    Args:
        observation_space: of the environment; keys that are not named are ignored.
        keys: of the observations to look at, in the order of concatenation; all when None.
        variant: "thesis": its CNN a picture, its MLP, concatenation and fusion; "desk": pictures of one size as
            channels of one light CNN, small MLPs; "baselines": the reinforcement-learning chapter's CNN of 512 units
            without any fusion, vectors passed on as they are.
        image_features: of the thesis's CNN, 128 (its table) or 256 (its text).

    Raises:
        ValueError: an unknown variant or number of features, a key that the observation has not.

    Source: thesis, chapter ENN, "Multimodal Feature Fusion"; chapter CathSim, "Network Architectures".
    """

    def __init__(
        self,
        observation_space: gymnasium.spaces.Dict,
        keys: Sequence[str] | None = None,
        variant: str = "thesis",
        image_features: int = 128,
    ) -> None:
        if variant not in VARIANTS:
            raise ValueError(f"unknown variant '{variant}'; there are {', '.join(VARIANTS)}")
        names = tuple(observation_space.spaces if keys is None else keys)
        space = require_keys(observation_space, names)
        groups = _groups(space, names, together=variant == "desk")
        networks: dict[str, nn.Module] = {}
        width = 0
        for name, members in groups.items():
            networks[name], features = _network(space, members, variant, image_features)
            width += features
        units = {"thesis": FUSED, "desk": DESK_FUSED, "baselines": ()}[variant]
        super().__init__(observation_space, units[-1] if units else width)
        self.keys, self.variant, self._members = names, variant, groups
        self.networks = nn.ModuleDict(networks)
        self.fusion = nn.Sequential(*_dense((width, *units)))

    def forward(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        """Features of a batch.

        Args:
            observations: pictures as floats from 0 to 1, as stable-baselines3 prepares them. Shapes (n, ...).

        Returns:
            Z. Shape (n, features_dim).
        """
        parts = []
        for name, members in self._members.items():
            seen = [observations[member] for member in members]
            parts.append(self.networks[name](seen[0] if len(seen) == 1 else torch.cat(seen, dim=1)))
        return self.fusion(parts[0] if len(parts) == 1 else torch.cat(parts, dim=1))


def _groups(space: gymnasium.spaces.Dict, keys: Sequence[str], *, together: bool) -> dict[str, tuple[str, ...]]:
    """Which observations share a network, by the network's name."""
    groups: dict[str, tuple[str, ...]] = {}
    sizes: dict[tuple[int, ...], str] = {}
    for key in keys:
        box = space[key]
        if together and is_image(box):
            name = sizes.setdefault(box.shape[1:], key)  # type: ignore[index]
            groups[name] = (*groups.get(name, ()), key)
        else:
            groups[key] = (key,)
    return groups


def _network(
    space: gymnasium.spaces.Dict, members: Sequence[str], variant: str, image_features: int
) -> tuple[nn.Module, int]:
    """A network for some observations, and how many features it gives."""
    first = space[members[0]]
    if is_image(first):
        channels = sum(space[member].shape[0] for member in members)  # type: ignore[index,misc]
        shape = (channels, *first.shape[1:])  # type: ignore[index]
        if variant == "thesis":
            return thesis_cnn(shape, image_features), image_features
        return (desk_cnn(shape), 128) if variant == "desk" else (nature_cnn(shape), 512)
    if not isinstance(first, gymnasium.spaces.Box):
        raise ValueError(f"expected a Box for '{members[0]}', got {first}")
    inputs = int(np.prod(first.shape))
    if variant == "thesis":
        return nn.Sequential(nn.Flatten(), *thesis_mlp(inputs)), 128
    return (nn.Sequential(nn.Flatten(), *desk_mlp(inputs)), 64) if variant == "desk" else (nn.Flatten(), inputs)


# What `layer_table` tells of a layer.
LAYER_COLUMNS = ("output_shape", "parameters", "nonlinearity", "kernel", "stride", "padding")


def layer_table(module: nn.Module, inputs: tuple[int, ...] | torch.Tensor) -> dict[str, list[Any]]:
    """A network's layers as the thesis's tables list them, measured by a forward pass.

    Args:
        inputs: shape of one sample, or a batch.

    Returns:
        By name (input, conv_1, flatten, linear_1, ...): output shape such as "32 × 19 × 19", number of parameters,
        nonlinearity ("none" where a layer with parameters has none; None where a layer could have none), kernel,
        stride, padding.
    """
    batch = inputs if isinstance(inputs, torch.Tensor) else torch.zeros(1, *inputs)
    rows: dict[str, list[Any]] = {"input": [_shape_text(batch), 0, None, None, None, None]}
    counts: dict[str, int] = {}

    def note(layer: nn.Module, _: Any, output: torch.Tensor) -> None:
        if isinstance(layer, nn.ReLU | nn.Tanh | nn.SiLU):
            last = rows[list(rows)[-1]]
            if last[1]:
                last[2] = type(layer).__name__
            return
        parameters = sum(parameter.numel() for parameter in layer.parameters())
        kind = {nn.Conv2d: "conv", nn.Linear: "linear", nn.Flatten: "flatten"}.get(type(layer), "")
        kind = kind or type(layer).__name__.lower()
        if kind == "flatten" and output.ndim == 2 and rows[list(rows)[-1]][0] == _shape_text(output):
            return  # a vector was flat before
        counts[kind] = counts.get(kind, 0) + 1
        geometry: list[Any] = [None, None, None]
        if isinstance(layer, nn.Conv2d):
            geometry = [layer.kernel_size[0], layer.stride[0], layer.padding[0]]
        name = kind if kind == "flatten" else f"{kind}_{counts[kind]}"
        rows[name] = [_shape_text(output), parameters, "none" if parameters else None, *geometry]

    leaves = [layer for layer in module.modules() if not list(layer.children())]
    hooks = [layer.register_forward_hook(note) for layer in leaves]
    try:
        with torch.no_grad():
            module(batch.to(next(iter(module.parameters()), batch).device))
    finally:
        for hook in hooks:
            hook.remove()
    return rows


def _shape_text(batch: torch.Tensor) -> str:
    return " × ".join(str(size) for size in batch.shape[1:])
