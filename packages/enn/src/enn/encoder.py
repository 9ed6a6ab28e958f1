"""The desk variant's frozen features: training an encoder to read the wire near the tip off observations."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from enn.exploration import FEEDER_SCALES, Samples, scripted_samples
from enn.networks.devices import device_of
from enn.networks.encoder_network import POINT_SCALE, Encoder, EncoderSettings
from enn.reinforcement.encoded import EncodedEnvs

__all__ = ["EncodedEnvs", "Encoder", "EncoderSettings", "Samples", "encoder_report", "fit_encoder", "scripted_samples"]

logger = logging.getLogger(__name__)

INSERTION_SCALE = 30.0  # mm, of insertions and lead
FRONTAL = (0, 2)  # axes of the plane that the frontal image shows
_AT_ONCE = 500  # samples that pass the network together where nothing is learnt
PICTURE_EPOCHS, VECTOR_EPOCHS = 10, 30  # a vector costs less, so that it may be looked at more often


def _targets(samples: Samples) -> Tensor:
    columns = (
        samples.points_mm.reshape(len(samples), -1) / POINT_SCALE,
        samples.direction,
        samples.feeder / np.where(np.array(FEEDER_SCALES[samples.feeder.shape[1]]) > 1, INSERTION_SCALE, 1.0),
        np.sign(samples.force) * np.sqrt(np.abs(samples.force)),
    )
    return torch.from_numpy(np.concatenate(columns, axis=1, dtype=np.float32))


def _split(samples: Samples, share: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows to train with and rows held out, whole roll-outs each."""
    episodes = np.unique(samples.episode)
    if len(episodes) < 2:
        raise ValueError(f"expected samples of at least two roll-outs, got {len(episodes)}: draw more samples")
    count = min(max(round(share * len(episodes)), 1), len(episodes) - 1)
    out = np.random.default_rng(seed).choice(episodes, count, replace=False)
    held = np.isin(samples.episode, out)
    return np.flatnonzero(~held), np.flatnonzero(held)


def fit_encoder(
    samples: Samples,
    keys: Sequence[str],
    settings: EncoderSettings | None = None,
    progress: Callable[[float, dict[str, float]], None] | None = None,
    device: torch.device | str = "cpu",
) -> tuple[Encoder, dict[str, Any]]:
    """Trains an encoder to tell where the wire is.

    Each target is weighted by the inverse of its running error, so that what cannot be seen, such as the depth in a
    single view, does not drown what can.

    Args:
        settings: choices of network and training; keys, shapes, feeder and epochs of 0 are filled in.
        progress: called after every epoch with the share done and the errors of its batches (`loss`).

    Returns:
        The encoder, frozen and in evaluation mode, and a report: `encoder_report` of the held-out roll-outs, and
        cpu_s, samples, epochs.

    Raises:
        ValueError: a key is missing in the samples, an observation is not finite, or there is only one roll-out.
    """
    missing = [key for key in keys if key not in samples.observations]
    if missing or not keys:
        needed = f"'{', '.join(missing)}'" if missing else "at least one key"
        raise ValueError(f"the encoder wants {needed}, but the samples have {', '.join(samples.observations)}")
    for key in keys:
        if not np.isfinite(samples.observations[key]).all():
            raise ValueError(f"the observation '{key}' of the samples has numbers that are not finite")
    start = time.process_time()
    shapes = tuple(samples.observations[key].shape[1:] for key in keys)
    pictures = any(len(shape) == 3 for shape in shapes)
    settings = settings or EncoderSettings()
    epochs = settings.epochs or (PICTURE_EPOCHS if pictures else VECTOR_EPOCHS)
    settings = replace(settings, keys=tuple(keys), shapes=shapes, feeder=samples.feeder.shape[1], epochs=epochs)
    train, held = _split(samples, settings.held_out, settings.seed)
    with torch.random.fork_rng(devices=()):
        torch.manual_seed(settings.seed)
        encoder = Encoder(settings)
    encoder.adapt(samples.take(train[:: max(len(train) // 2000, 1)]))
    encoder.to(device)
    seen = {key: torch.from_numpy(samples.observations[key]) for key in keys}
    prepared = _prepared(encoder, seen)
    _optimise(encoder, prepared, _targets(samples), torch.from_numpy(train), progress)
    _normalise(encoder, prepared, torch.from_numpy(train))
    encoder.eval().requires_grad_(False)
    report = encoder_report(encoder, samples.take(held))
    report |= {"cpu_s": time.process_time() - start, "samples": len(samples), "epochs": settings.epochs}
    logger.info("encoder of %s: tip within %.2f mm in the frontal plane", ", ".join(keys), report["tip_frontal_mm"])
    return encoder, report


@torch.no_grad()
def _prepared(encoder: Encoder, seen: dict[str, Tensor]) -> dict[str, Tensor]:
    """Inputs of all samples, prepared once instead of every epoch; in half precision, since pictures are many."""
    count = len(next(iter(seen.values())))
    parts = [
        {name: values.half().cpu() for name, values in encoder.prepare(_moved(seen, at, encoder)).items()}
        for at in range(0, count, _AT_ONCE)
    ]
    return {name: torch.cat([part[name] for part in parts]) for name in parts[0]}


def _moved(seen: Mapping[str, Tensor], first: int, encoder: Encoder) -> dict[str, Tensor]:
    """The next `_AT_ONCE` samples, on the encoder's device."""
    device = device_of(encoder)
    return {name: tensor[first : first + _AT_ONCE].to(device) for name, tensor in seen.items()}


def _batch(prepared: Mapping[str, Tensor], rows: Tensor, encoder: Encoder) -> dict[str, Tensor]:
    device = device_of(encoder)
    return {name: tensor[rows].to(device).float() for name, tensor in prepared.items()}


def _optimise(
    encoder: Encoder,
    prepared: dict[str, Tensor],
    targets: Tensor,
    rows: Tensor,
    progress: Callable[[float, dict[str, float]], None] | None,
) -> None:
    settings = encoder.settings
    encoder.target_mean.copy_(targets[rows].mean(0))
    targets = targets - encoder.target_mean.cpu()
    size = min(settings.batch_size, len(rows))
    per_epoch = len(rows) // size
    optimiser = torch.optim.AdamW(
        encoder.parameters(), lr=settings.learning_rate, weight_decay=settings.weight_decay, fused=True
    )
    steps = settings.epochs * per_epoch
    # With ten steps the first phase would have no step.
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, settings.learning_rate, total_steps=steps + (steps == 10), pct_start=0.1
    )
    generator = torch.Generator().manual_seed(settings.seed)
    device = device_of(encoder)
    error = torch.ones(targets.shape[1], device=device)
    encoder.train()
    for epoch in range(settings.epochs):
        order = rows[torch.randperm(len(rows), generator=generator)]
        total = 0.0
        for batch in order[: per_epoch * size].split(size):
            predicted = encoder.head(encoder.bottleneck(_batch(prepared, batch, encoder)))
            squares = functional.mse_loss(predicted, targets[batch].to(device), reduction="none").mean(0)
            error.lerp_(squares.detach(), 0.03)
            loss = (squares / error.clamp(min=1e-4)).mean()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            schedule.step()
            total += float(squares.detach().mean())
        if progress is not None:
            progress((epoch + 1) / settings.epochs, {"loss": total / per_epoch})


@torch.no_grad()
def _normalise(encoder: Encoder, prepared: dict[str, Tensor], rows: Tensor) -> None:
    some = rows[:: max(len(rows) // 4000, 1)]
    features = torch.cat([encoder.bottleneck(_batch(prepared, batch, encoder)) for batch in some.split(_AT_ONCE)])
    encoder.feature_mean.copy_(features.mean(0))
    encoder.feature_scale.copy_(1.0 / features.std(0, correction=0).clamp(min=1e-6))


@torch.no_grad()
def encoder_report(encoder: Encoder, samples: Samples) -> dict[str, float]:
    """Errors of an encoder.

    Returns:
        tip_mm, tip_p95_mm: distance of the predicted tip from the true one, mean and 95th percentile; tip_frontal_mm,
        tip_frontal_p95_mm: the same in the plane of the frontal image (x, z); points_mm: mean over all points.
    """
    seen = {key: torch.from_numpy(samples.observations[key]) for key in encoder.keys}
    parts = [encoder.wire_points_mm(_moved(seen, at, encoder)).cpu() for at in range(0, len(samples), _AT_ONCE)]
    offset = torch.cat(parts).numpy() - samples.points_mm
    distance, frontal = np.linalg.norm(offset, axis=2), np.linalg.norm(offset[..., FRONTAL], axis=2)
    return {
        "tip_mm": float(distance[:, 0].mean()),
        "tip_p95_mm": float(np.quantile(distance[:, 0], 0.95)),
        "tip_frontal_mm": float(frontal[:, 0].mean()),
        "tip_frontal_p95_mm": float(np.quantile(frontal[:, 0], 0.95)),
        "points_mm": float(distance.mean()),
    }
