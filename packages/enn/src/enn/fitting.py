"""Fitting: epochs of shuffled batches with validation by episode, the best weights kept, resumable by epoch."""

from __future__ import annotations

import copy
import hashlib
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
    samples: str = "",
    folder: Path | str | None = None,
    progress: Callable[[EpisodeFitProgress], None] | None = None,
) -> FitReport:
    """Fits a module in place and leaves it with the weights of its best epoch.

    Args:
        loss: mean loss of samples given by their indices; augmentation only where the flag says training.
        episodes: (N,) number of the episode that each sample is from: whole episodes are held out for validation.
        samples: digest of the samples and of what the loss depends on; only a fit of the same is resumed.
        folder: for the checkpoint, gone at the end; None: it cannot be resumed.
        progress: called after every epoch; what it raises stops the fit, after a checkpoint.

    Returns:
        What the fit was like.

    Raises:
        FitError: a checkpoint of another architecture or other samples, or a loss that is not finite.
    """
    whole = _Fit(module, loss, episodes, settings, seed, samples, None if folder is None else Path(folder) / FILE)
    whole.run(progress)
    return whole.report


class _Fit:
    """A fit under way: what it needs from one epoch to the next."""

    def __init__(
        self, module: nn.Module, loss: Loss, episodes: NDArray[Any], settings: EpisodeFitSettings, seed: int,
        samples: str, file: Path | None,
    ) -> None:  # fmt: skip
        self.module, self.loss, self.settings, self.file = module.to(**CHANNELS_LAST), loss, settings, file
        self.generator = np.random.default_rng(seed)
        self.training, self.held_out = split(episodes, settings.validation_share, self.generator)
        self.report = FitReport(samples=len(self.training))
        self.optimiser = torch.optim.AdamW(
            module.parameters(), settings.learning_rate, weight_decay=settings.weight_decay, fused=True
        )
        self.best = copy.deepcopy(module.state_dict())
        self.identity = {
            "weights": {name: list(value.shape) for name, value in module.state_dict().items()},
            "samples": [digest_of(self.training, self.held_out), samples],
            "settings": {k: v for k, v in asdict(settings).items() if k != "checkpoint_seconds"},
            "seed": seed,
        }
        if file is not None and file.is_file():
            self._resume(file)

    def run(self, progress: Callable[[EpisodeFitProgress], None] | None) -> None:
        """Fits to the end, and leaves the module with its best weights."""
        epochs, resumed_at = self.settings.epochs, len(self.report.rows)
        began = written = time.monotonic()
        while len(self.report.rows) < epochs and not _out_of_patience(self.report, self.settings):
            self._epoch()
            done = len(self.report.rows)
            if done < epochs and time.monotonic() - written >= self.settings.checkpoint_seconds:
                self._write()
                written = time.monotonic()
            if progress is not None:
                left = (time.monotonic() - began) / (done - resumed_at) * (epochs - done)
                try:
                    progress(self._progress(left))
                except BaseException:
                    self._write()
                    raise
        self.module.load_state_dict(self.best)
        self.module.to(**CHANNELS_FIRST).eval()
        if self.file is not None:
            self.file.unlink(missing_ok=True)

    def _epoch(self) -> None:
        started, epoch = time.process_time(), len(self.report.rows) + 1
        mean = self._pass(epoch)
        if not math.isfinite(mean):
            raise FitError(f"the loss became {mean} in epoch {epoch}: look for odd samples, or lower learning_rate")
        validation = validate(self.module, self.loss, self.held_out) if len(self.held_out) else None
        known = [row["validation"] for row in self.report.rows]
        self.report.cpu_s += time.process_time() - started
        self.report.rows.append({"epoch": epoch, "loss": mean, "validation": validation, "cpu_s": self.report.cpu_s})
        if validation is None or all(other is None or validation < other for other in known):
            self.report.best_epoch, self.best = epoch, copy.deepcopy(self.module.state_dict())

    def _pass(self, epoch: int) -> float:
        """Learns from every sample once; gives the mean loss."""
        settings, count = self.settings, len(self.training)
        self.module.train()
        batches, total = max(1, math.ceil(count / settings.batch_size)), 0.0
        order = self.generator.permutation(self.training)
        for batch in range(batches):
            chosen = order[batch * settings.batch_size : (batch + 1) * settings.batch_size]
            rate = _rate(settings, (epoch - 1 + batch / batches) / settings.epochs)
            for group in self.optimiser.param_groups:
                group["lr"] = rate
            value = self.loss(chosen, True, self.generator)
            self.optimiser.zero_grad()
            value.backward()
            self.optimiser.step()
            total += float(value.detach()) * len(chosen)
        return total / count

    def _progress(self, left: float) -> EpisodeFitProgress:
        last: dict[str, Any] = self.report.rows[-1]
        return EpisodeFitProgress(last["epoch"], self.settings.epochs, last["loss"], last["validation"], left)

    def _write(self) -> None:
        """Writes a checkpoint, where there is a folder for it."""
        if self.file is None:
            return
        content = {
            "format": FORMAT,
            "identity": self.identity,
            "module": self.module.state_dict(),
            "best": self.best,
            "optimiser": self.optimiser.state_dict(),
            "generator": self.generator.bit_generator.state,
            "torch": torch.get_rng_state(),
            "report": asdict(self.report),
        }
        write_model(self.file, content)

    def _resume(self, file: Path) -> None:
        try:
            content = read_model(file, FORMAT, kind="checkpoint of a fit", verb="fit")
            for name, mine in self.identity.items():
                if content["identity"][name] != mine:
                    what = "another architecture" if name == "weights" else f"a fit with other {name}"
                    raise FitError(f"{file} is of {what}: remove it to start again, or take another folder")
            self.module.load_state_dict(content["module"])
            self.optimiser.load_state_dict(content["optimiser"])
            self.generator.bit_generator.state = content["generator"]
            torch.set_rng_state(content["torch"])
            for name, value in content["report"].items():
                setattr(self.report, name, value)
            self.best = content["best"]
        except FitError:
            raise
        except UNFIT as error:
            raise FitError(f"{file} is damaged or no checkpoint of a fit: remove it to start again") from error


def digest_of(*content: Any) -> str:
    """SHA-256 of arrays, and of the words of anything else."""
    digest = hashlib.sha256()
    for one in content:
        is_array = isinstance(one, np.ndarray)
        digest.update(f"{one.dtype} {one.shape}".encode() if is_array else repr(one).encode())
        digest.update(np.ascontiguousarray(one).data if is_array and one.size else b"")
    return digest.hexdigest()


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
