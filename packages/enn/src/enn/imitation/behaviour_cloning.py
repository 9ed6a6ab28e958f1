"""Behaviour cloning: an expert's episodes distilled into a policy that sees fluoroscopic images alone."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from enn.fitting import EpisodeFitProgress, EpisodeFitSettings, FitReport, digest_of, fit
from enn.imitation.cloned_policy import ClonedPolicy, CloningNetwork, CloningNetworkSettings
from enn.networks.devices import bfloat16_on_processor, seeded
from enn.networks.image_network import shifted
from enn.networks.normalisation import standardised
from enn.setting_kinds import PixelsOrNone, Weight, settings
from enn.trajectory import Trajectory, episode_numbers, join


@settings
class BehaviourCloningSettings:
    """How an expert is cloned.

    Source: thesis, section Downstream Tasks, Imitation Learning.
    """

    network: CloningNetworkSettings = field(default_factory=CloningNetworkSettings)
    fit: EpisodeFitSettings = field(default_factory=EpisodeFitSettings)
    entropy: Weight = 1e-3  # beta, weight of the policy's entropy
    l2: Weight = 0.0  # lambda, weight of the sum of the squared weights
    # weight of the mean squared difference to the expert's features, both normalised, where these are given
    feature_matching: Weight = 0.1
    shift_px: PixelsOrNone = 0  # images are moved by up to this much either way, as augmentation


# Thesis, table of behaviour cloning's hyper-parameters.
THESIS_CLONING = BehaviourCloningSettings(
    network=CloningNetworkSettings(variant="thesis"),
    fit=EpisodeFitSettings(
        epochs=800,
        batch_size=32,
        learning_rate=1e-3,
        schedule="constant",
        validation_share=0.0,
        checkpoint_seconds=60.0,
    ),
    l2=1e-5,
)
DESK_CLONING = BehaviourCloningSettings(
    network=CloningNetworkSettings(variant="desk"),
    fit=EpisodeFitSettings(epochs=10, batch_size=64, learning_rate=2e-3, weight_decay=1e-2, schedule="one_cycle"),
    shift_px=1,
)


def cloning_preset(variant: str) -> BehaviourCloningSettings:
    """The settings of a variant, "thesis" or "desk"."""
    presets = {"thesis": THESIS_CLONING, "desk": DESK_CLONING}
    if variant not in presets:
        raise ValueError(f"unknown variant '{variant}'; there are {', '.join(presets)}")
    return presets[variant]


def cloning_settings(
    variant: str, observations: tuple[str, ...], feature_matching: float, epochs: int = 0
) -> BehaviourCloningSettings:
    """The preset of a variant for other observations and feature matching; 0 epochs are the variant's own."""
    preset = cloning_preset(variant)
    return replace(
        preset,
        fit=replace(preset.fit, epochs=epochs or preset.fit.epochs),
        network=replace(preset.network, keys=observations),
        feature_matching=feature_matching,
    )


def clone(
    trajectories: Sequence[Trajectory],
    settings: BehaviourCloningSettings = DESK_CLONING,
    *,
    expert_features: Sequence[NDArray[np.float32]] | None = None,
    initial: ClonedPolicy | None = None,
    seed: int = 0,
    samples: str = "",
    folder: Path | str | None = None,
    progress: Callable[[EpisodeFitProgress], None] | None = None,
    device: torch.device | str = "cpu",
) -> tuple[ClonedPolicy, FitReport]:
    """Clones an expert.

    Args:
        trajectories: its episodes; `actions` are what the expert wanted done, whatever was done.
        settings: of network, loss and fit; the network's image shape and actions are taken from the episodes.
        expert_features: Z of each episode's moments, (T, z) or (T + 1, z); without, features are not matched.
        initial: student to go on from instead of fresh weights.
        samples: digest of what the episodes are made of, where some were played for this fit; "": of all of them.
        folder: for a checkpoint, from which an interrupted fit goes on if the samples are the same.

    Returns:
        The student, and what the fit was like.

    Raises:
        ValueError: no episodes, episodes of different kinds, or features that do not fit them.
        FitError: a checkpoint of something else.
    """
    keys = settings.network.keys
    seen, actions, _ = join(trajectories, keys)
    images = torch.as_tensor(np.concatenate([seen[key] for key in keys], axis=1))
    expert_actions = torch.as_tensor(actions)
    episodes = episode_numbers(trajectories)
    target = None if expert_features is None else normalised_features(trajectories, expert_features)

    channels, height, width = images.shape[1:]
    network_settings = replace(
        settings.network,
        shape=(channels, height, width),
        actions=actions.shape[1],
        expert_features=0 if target is None else target.shape[1],
    )
    with seeded(seed, device):
        network = CloningNetwork(network_settings)
        network.images.fit_background(images)
        if initial is not None:
            take_over(network, initial)
        network.to(device)
        loss = _loss(network, settings, images, expert_actions, target)
        samples = samples or samples_digest(trajectories, settings)
        report = fit(
            network, loss, episodes, settings.fit, seed=seed, samples=samples, folder=folder, progress=progress
        )
    return ClonedPolicy(network), report


def samples_digest(trajectories: Sequence[Trajectory], settings: BehaviourCloningSettings, *further: Any) -> str:
    """A digest of episodes' actions and of the settings but for those of the fit; of what else decides, too."""
    return digest_of(*(one.actions for one in trajectories), replace(settings, fit=EpisodeFitSettings()), *further)


def _loss(
    network: CloningNetwork,
    settings: BehaviourCloningSettings,
    images: Tensor,
    expert_actions: Tensor,
    target: Tensor | None,
) -> Callable[[NDArray[np.int64], bool, np.random.Generator], Tensor]:
    def loss(samples: NDArray[np.int64], training: bool, generator: np.random.Generator) -> Tensor:
        index, device = torch.as_tensor(samples), network.images.background.device
        batch = images[index].to(device)
        if training:
            batch = augmented(batch, settings, network.images.background, generator)
        with bfloat16_on_processor():
            features = network.features(batch)
        features = features.float()
        value = negative_log_likelihood(network.head(features), network.log_std, expert_actions[index].to(device))
        if target is not None and settings.feature_matching:
            value = value + settings.feature_matching * nn.functional.mse_loss(
                network.matching(features), target[index].to(device)
            )
        if training:
            value = value - settings.entropy * entropy(network.log_std)
            if settings.l2:
                value = value + settings.l2 * sum(weights.square().sum() for weights in network.parameters())
        return value

    return loss


def negative_log_likelihood(mean: Tensor, log_std: Tensor, actions: Tensor) -> Tensor:
    """Mean over samples of -log pi(a | s) of a Gaussian with diagonal covariance.

    Args:
        mean: (N, a).
        log_std: (a,).
        actions: (N, a).
    """
    normal = torch.distributions.Normal(mean, log_std.exp())
    return -normal.log_prob(actions).sum(dim=1).mean()


def entropy(log_std: Tensor) -> Tensor:
    """Entropy of a Gaussian with diagonal covariance, nats."""
    return (log_std + 0.5 * np.log(2 * np.pi * np.e)).sum()


def augmented(
    images: Tensor, settings: BehaviourCloningSettings, background: Tensor, generator: np.random.Generator
) -> Tensor:
    """Images moved as the settings say."""
    reach = settings.shift_px
    if not reach:
        return images
    return shifted(images, torch.as_tensor(generator.integers(-reach, reach + 1, (len(images), 2))), background)


def normalised_features(trajectories: Sequence[Trajectory], features: Sequence[NDArray[np.float32]]) -> Tensor:
    """The expert's features of every sample, each with mean 0 and standard deviation 1.

    Args:
        features: of each, (T, z) or (T + 1, z).

    Returns:
        (N, z).

    Raises:
        ValueError: features of another number of episodes or steps, or not finite.
    """
    if len(features) != len(trajectories):
        raise ValueError(f"expected features of each of {len(trajectories)} episodes, got {len(features)}")
    for trajectory, values in zip(trajectories, features, strict=True):
        if values.ndim != 2 or len(values) not in (len(trajectory), len(trajectory) + 1):
            raise ValueError(
                f"features of {trajectory.label} must have shape ({len(trajectory)}, z) or ({len(trajectory) + 1}, z), "
                f"got {values.shape}"
            )
        if not np.isfinite(values).all():
            raise ValueError(f"the expert's features of {trajectory.label} are not finite: check its observations")
    joined = np.concatenate([v[: len(t)] for t, v in zip(trajectories, features, strict=True)]).astype(np.float32)
    return torch.as_tensor(standardised(joined))


def take_over(network: CloningNetwork, student: ClonedPolicy) -> None:
    """Copies a student's weights into a network of the same architecture.

    Raises:
        ValueError: it is of another architecture.
    """
    state, mine = student.network.state_dict(), network.state_dict()
    weights = {name: value for name, value in state.items() if not name.startswith("matching.")}
    differing = [n for n, value in weights.items() if n not in mine or mine[n].shape != value.shape]
    if differing:
        raise ValueError(f"the student to go on from is of another architecture ({differing[0]}): start from none")
    network.load_state_dict(mine | weights)
