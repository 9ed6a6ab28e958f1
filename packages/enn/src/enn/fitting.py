"""Fitting: epochs of shuffled batches with validation by episode, the best weights kept, resumable by epoch."""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
from annotated_types import Interval
from numpy.typing import NDArray
from torch import Tensor, nn

from enn.model_file import UNFIT, read_model, write_model
from enn.setting_kinds import Count, CountOrNone, LearningRate, Seconds, Weight, settings

SCHEDULES = ("constant", "one_cycle")
FORMAT = "enn-fit-1"
FILE = "fit.pt"
_RISE = 0.3  # share of a one-cycle schedule in which the rate rises, from a 25th


@settings
class EpisodeFitSettings:
    """How a network is fitted to samples."""

    epochs: Count = 30  # passes over the training samples at most
    batch_size: Count = 64
    learning_rate: LearningRate = 1e-3  # of Adam; the highest one of a schedule
    weight_decay: Weight = 0.0  # decoupled, of AdamW; the L2 term of a loss is another thing
    schedule: str = "one_cycle"  # "constant", or "one_cycle" (rises, then falls to nothing along a cosine)
    # share of the episodes that is held out to choose the best epoch; 0: the last epoch is kept
    validation_share: Annotated[float, Interval(ge=0, lt=1)] = 0.1
    patience: CountOrNone = 0  # epochs without a better validation after which fitting stops; 0: never
    checkpoint_seconds: Seconds = 20.0  # between checkpoints; 0: after every epoch

    def __post_init__(self) -> None:
        if self.schedule not in SCHEDULES:
            raise ValueError(f"unknown schedule '{self.schedule}'; there are {', '.join(SCHEDULES)}")


@dataclass(frozen=True)
class EpisodeFitProgress:
    """How far a fit is."""

    epoch: int  # finished ones
    epochs: int
    loss: float  # mean over the last epoch
    validation: float | None
    remaining_s: float


@dataclass
class FitReport:
    """What a fit left behind.

    Attributes:
        rows: an epoch each: epoch, loss, validation (None without), cpu_s.
        cpu_s: spent in all, of every start.
    """

    rows: list[dict[str, float | None]] = field(default_factory=list)
    best_epoch: int = 0
    cpu_s: float = 0.0
    samples: int = 0


class FitError(ValueError):
    """A fit cannot go on: its checkpoint is of something else, or its loss is no number."""


Loss = Callable[[NDArray[np.int64], bool, np.random.Generator], Tensor]  # samples, training, generator -> mean loss
# Order of images in memory, for `Module.to`: with channels last, convolutions are 1.0 to 1.4 times as fast.
CHANNELS_LAST: dict[str, Any] = {"memory_format": torch.channels_last}
CHANNELS_FIRST: dict[str, Any] = {"memory_format": torch.contiguous_format}


def fit(
    module: nn.Module,
    loss: Loss,
    episodes: NDArray[Any],
    settings: EpisodeFitSettings,
    *,
    seed: int = 0,
    folder: Path | str | None = None,
    progress: Callable[[EpisodeFitProgress], None] | None = None,
) -> FitReport:
    """Fits a module in place and leaves it with the weights of its best epoch.

    Args:
        loss: mean loss of samples given by their indices; augmentation only where the flag says training.
        episodes: (N,) number of the episode that each sample is from: whole episodes are held out for validation.
        folder: for the checkpoint, gone at the end; None: it cannot be resumed.
        progress: called after every epoch; what it raises stops the fit, after a checkpoint.

    Returns:
        What the fit was like.

    Raises:
        FitError: a checkpoint of another architecture or other samples, or a loss that is not finite.
    """
    module.to(**CHANNELS_LAST)
    generator = np.random.default_rng(seed)
    training, held_out = split(episodes, settings.validation_share, generator)
    report = FitReport(samples=len(training))
    optimiser = torch.optim.AdamW(
        module.parameters(), settings.learning_rate, weight_decay=settings.weight_decay, fused=True
    )
    best = copy.deepcopy(module.state_dict())
    identity = {
        "weights": {name: list(value.shape) for name, value in module.state_dict().items()},
        "samples": [len(training), len(held_out)],
        "settings": {k: v for k, v in asdict(settings).items() if k != "checkpoint_seconds"},
        "seed": seed,
    }
    file = None if folder is None else Path(folder) / FILE
    if file is not None and file.is_file():
        best = _resume(file, identity, module, optimiser, generator, report)
    batches = max(1, math.ceil(len(training) / settings.batch_size))
    began, resumed_at, written = time.monotonic(), len(report.rows), time.monotonic()
    while len(report.rows) < settings.epochs and not _out_of_patience(report, settings):
        epoch, started = len(report.rows), time.process_time()
        module.train()
        total = 0.0
        order = generator.permutation(training)
        for batch in range(batches):
            chosen = order[batch * settings.batch_size : (batch + 1) * settings.batch_size]
            rate = _rate(settings, (epoch + batch / batches) / settings.epochs)
            for group in optimiser.param_groups:
                group["lr"] = rate
            value = loss(chosen, True, generator)
            optimiser.zero_grad()
            value.backward()
            optimiser.step()
            total += float(value.detach()) * len(chosen)
        mean = total / len(training)
        if not math.isfinite(mean):
            raise FitError(f"the loss became {mean} in epoch {epoch + 1}: look for odd samples, or lower learning_rate")
        validation = validate(module, loss, held_out) if len(held_out) else None
        report.cpu_s += time.process_time() - started
        report.rows.append({"epoch": epoch + 1, "loss": mean, "validation": validation, "cpu_s": report.cpu_s})
        known = [row["validation"] for row in report.rows[:-1]]
        if validation is None or all(other is None or validation < other for other in known):
            report.best_epoch, best = epoch + 1, copy.deepcopy(module.state_dict())
        last = epoch + 1 == settings.epochs
        if file is not None and not last and time.monotonic() - written >= settings.checkpoint_seconds:
            _write(file, identity, module, best, optimiser, generator, report)
            written = time.monotonic()
        if progress is not None:
            done = epoch + 1 - resumed_at
            left = (time.monotonic() - began) / done * (settings.epochs - epoch - 1)
            try:
                progress(EpisodeFitProgress(epoch + 1, settings.epochs, mean, validation, left))
            except BaseException:
                if file is not None:
                    _write(file, identity, module, best, optimiser, generator, report)
                raise
    module.load_state_dict(best)
    module.to(**CHANNELS_FIRST).eval()
    if file is not None:
        file.unlink(missing_ok=True)
    return report


def split(
    episodes: NDArray[Any], share: float, generator: np.random.Generator
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Holds whole episodes out.

    Args:
        episodes: (N,) number of the episode of each sample.
        share: of the episodes; one at least where there are two, unless it is zero.

    Returns:
        Indices to train with, and indices held out.
    """
    names = np.unique(episodes)
    count = 0 if share == 0 or len(names) < 2 else min(max(1, round(share * len(names))), len(names) - 1)
    held = np.isin(episodes, generator.permutation(names)[:count])
    return np.flatnonzero(~held), np.flatnonzero(held)


def validate(module: nn.Module, loss: Loss, samples: NDArray[np.int64], batch: int = 512) -> float:
    """Mean loss of samples, without augmentation and gradients."""
    module.eval()
    unused = np.random.default_rng(0)
    with torch.no_grad():
        parts = [
            float(loss(samples[k : k + batch], False, unused)) * len(samples[k : k + batch])
            for k in range(0, len(samples), batch)
        ]
    return sum(parts) / len(samples)


def _rate(settings: EpisodeFitSettings, share: float) -> float:
    if settings.schedule == "constant":
        return settings.learning_rate
    if share < _RISE:
        return settings.learning_rate * (0.04 + 0.96 * 0.5 * (1 - math.cos(math.pi * share / _RISE)))
    return settings.learning_rate * 0.5 * (1 + math.cos(math.pi * (share - _RISE) / (1 - _RISE)))


def _out_of_patience(report: FitReport, settings: EpisodeFitSettings) -> bool:
    return bool(settings.patience) and len(report.rows) - report.best_epoch >= settings.patience


def _write(
    file: Path,
    identity: dict[str, Any],
    module: nn.Module,
    best: dict[str, Tensor],
    optimiser: torch.optim.Optimizer,
    generator: np.random.Generator,
    report: FitReport,
) -> None:
    content = {
        "format": FORMAT,
        "identity": identity,
        "module": module.state_dict(),
        "best": best,
        "optimiser": optimiser.state_dict(),
        "generator": generator.bit_generator.state,
        "torch": torch.get_rng_state(),
        "report": asdict(report),
    }
    write_model(file, content)


def _resume(
    file: Path,
    identity: dict[str, Any],
    module: nn.Module,
    optimiser: torch.optim.Optimizer,
    generator: np.random.Generator,
    report: FitReport,
) -> dict[str, Tensor]:
    try:
        content = read_model(file, FORMAT, kind="checkpoint of a fit", verb="fit")
        for name, mine in identity.items():
            if content["identity"][name] != mine:
                what = "another architecture" if name == "weights" else f"a fit with other {name}"
                raise FitError(f"{file} is of {what}: remove it to start again, or take another folder")
        module.load_state_dict(content["module"])
        optimiser.load_state_dict(content["optimiser"])
        generator.bit_generator.state = content["generator"]
        torch.set_rng_state(content["torch"])
        for name, value in content["report"].items():
            setattr(report, name, value)
        best: dict[str, Tensor] = content["best"]
    except FitError:
        raise
    except UNFIT as error:
        raise FitError(f"{file} is damaged or no checkpoint of a fit: remove it to start again") from error
    return best
