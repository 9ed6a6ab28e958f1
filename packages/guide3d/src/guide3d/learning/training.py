"""Training: epochs of shuffled batches, validated by acquisition, the best weights kept, exactly resumable by epoch.

One code path serves one process and many (torchrun), with and without GPUs; on GPUs numbers are mixed precision. In the
folder of a training lie, while it goes on::

    last.pt   weights, optimiser, schedule and table after a finished epoch
    best.pt   weights of the epoch with the best validation until then

They are written after every epoch, but for networks so large that this would take more than a twentieth of the time; a
training that ends by an exception of its caller writes what it has. A process killed at any moment loses the epochs
since: every epoch draws from generators of its own, seeded by the training's seed and the epoch's number, so what
follows is what would have followed.
"""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any, Protocol

import numpy as np
import torch
from annotated_types import Interval
from numpy.typing import NDArray
from torch import Tensor, nn

from guide3d.learning.distributed import Ranks
from guide3d.learning.model_file import UNFIT, read_content, write_content
from guide3d.setting_kinds import Count, CountOrNone, LearningRate, Weight, settings

OPTIMISERS = ("nadam", "adamw", "sgd")
SCHEDULES = ("plateau", "one_cycle", "polynomial", "constant")
FORMAT = "guide3d-training-1"
LAST, BEST = "last.pt", "best.pt"
_RISE = 0.2  # share of a one-cycle schedule in which the rate rises
_PRIME = 1_000_003
_BETWEEN_CHECKPOINTS = 20.0  # times what writing one took, at least
# Order in memory: with channels last, convolutions are 1.0 to 1.5 times as fast on a processor.
_CHANNELS_LAST: dict[str, Any] = {"memory_format": torch.channels_last}
_CHANNELS_FIRST: dict[str, Any] = {"memory_format": torch.contiguous_format}

Indices = NDArray[np.int64]
Batch = Mapping[str, Tensor]


@settings
class NetworkFitSettings:
    """How a network is trained; the defaults are those of the thesis's shape network.

    Attributes:
        batch_size: items an update, over all processes.
        optimiser: "nadam", "adamw" or "sgd" (momentum 0.9).
        learning_rate: the first, or the highest of a one-cycle schedule.
        schedule: "plateau" (times `factor` after `plateau_patience` epochs without a better validation), "one_cycle",
            "polynomial" (to nothing, power 0.9) or "constant".
        patience: epochs without a better validation after which training stops; 0: never.
        clip: largest norm of the gradient; 0: any.
    """

    epochs: Count = 400
    batch_size: Count = 16
    optimiser: str = "nadam"
    learning_rate: LearningRate = 1e-4
    weight_decay: Weight = 0.0
    schedule: str = "plateau"
    factor: Annotated[float, Interval(gt=0, lt=1)] = 0.1
    plateau_patience: CountOrNone = 10
    patience: CountOrNone = 30
    clip: Weight = 0.0

    def __post_init__(self) -> None:
        """Refuses unknown names."""
        for name, known in (("optimiser", OPTIMISERS), ("schedule", SCHEDULES)):
            if getattr(self, name) not in known:
                raise ValueError(f"unknown {name} '{getattr(self, name)}'; there are {', '.join(known)}")


class Objective(Protocol):
    """What a network learns from: items to learn from and others to validate with, and the loss of a batch."""

    training_items: Indices
    validation_items: Indices

    def batch(self, items: Indices, generator: np.random.Generator | None) -> Batch:
        """Tensors of items; augmented where there is a generator. Items that cannot be read are replaced."""

    def loss(self, module: nn.Module, batch: Batch) -> Tensor:
        """Mean loss of a batch."""


@dataclass(frozen=True)
class FitProgress:
    """How far a training is."""

    epoch: int  # finished ones
    epochs: int
    loss: float
    validation: float | None


@dataclass
class FitReport:
    """What a training was like.

    Attributes:
        rows: an epoch each: epoch, loss, validation (None without), learning_rate, cpu_s.
        best_epoch: whose weights are kept.
    """

    rows: list[dict[str, Any]] = field(default_factory=list)
    best_epoch: int = 0

    @property
    def cpu_s(self) -> float:
        """Processor time of this process, of every start."""
        return float(self.rows[-1]["cpu_s"]) if self.rows else 0.0


class TrainingError(ValueError):
    """A training cannot go on: its checkpoint is of something else, or its loss is no number."""


def fit(
    module: nn.Module,
    objective: Objective,
    settings: NetworkFitSettings,
    *,
    folder: Path | str,
    seed: int = 0,
    recipe: Any = None,
    ranks: Ranks | None = None,
    progress: Callable[[FitProgress], None] | None = None,
) -> FitReport:
    """Trains a module in place and leaves it with the weights of its best epoch.

    Args:
        folder: for the checkpoints; `finished` removes them.
        seed: of shuffling, augmentation and dropout.
        recipe: all that the objective depends on, told apart by its `repr`; only a checkpoint of the same is gone on
            with.
        ranks: that train together; None: this process alone, on the processor.
        progress: called after every epoch; what it raises ends the training there, with its checkpoint written.

    Raises:
        TrainingError: a checkpoint of another architecture, other items or other settings; a loss that is not finite.
    """
    ranks = ranks or Ranks(0, 1, torch.device("cpu"))
    folder = Path(folder)
    module.to(ranks.device, **_CHANNELS_LAST)
    steps = _Steps(module, settings, ranks.device)
    report = FitReport()
    identity = {
        "weights": {name: list(value.shape) for name, value in module.state_dict().items()},
        "items": [_digest(items) for items in (objective.training_items, objective.validation_items)],
        "settings": asdict(settings) | {"recipe": repr(recipe)},
        "seed": seed,
    }
    if (folder / LAST).is_file():
        _resume(folder / LAST, identity, steps.parts, report)
    shared = ranks.wrapped(module)
    checkpoint = _Checkpoint(folder, identity, steps, report)
    while len(report.rows) < settings.epochs and not _out_of_patience(report, settings):
        epoch, started = len(report.rows), time.process_time()
        torch.manual_seed((seed * _PRIME + epoch) * 64 + ranks.rank)
        generator = np.random.default_rng((seed, epoch, ranks.rank))
        batches = _batches(objective.training_items, settings, np.random.default_rng((seed, epoch)), ranks)
        total, count = ranks.summed(*steps.epoch(shared, objective, batches, epoch, generator))
        mean = total / count
        if not math.isfinite(mean):
            raise TrainingError(
                f"the loss became {mean} in epoch {epoch + 1}: look for odd samples, or lower learning_rate"
            )
        validation = validate(module, objective, settings, ranks)
        if settings.schedule == "plateau":
            steps.plateau.step(mean if validation is None else validation)
        spent = time.process_time() - started + report.cpu_s
        known = [row["validation"] for row in report.rows]
        row = {"epoch": epoch + 1, "loss": mean, "validation": validation, "learning_rate": steps.rate, "cpu_s": spent}
        report.rows.append(row)
        better = validation is None or all(other is None or validation < other for other in known)
        if better:
            report.best_epoch = epoch + 1
        if ranks.rank == 0:
            checkpoint.keep(better)
        if progress is not None:
            try:
                progress(FitProgress(epoch + 1, settings.epochs, mean, validation))
            except BaseException:
                checkpoint.write()
                raise
    checkpoint.write()
    ranks.wait()
    try:
        module.load_state_dict(read_content(folder / BEST))
    except (OSError, *UNFIT) as error:
        raise TrainingError(f"{folder / BEST} is damaged or missing: remove {folder} to start again") from error
    module.to(**_CHANNELS_FIRST).eval()
    return report


def _digest(items: Indices) -> str:
    return hashlib.sha256(np.asarray(items, np.int64).tobytes()).hexdigest()


class _Checkpoint:
    """Files of a training, written as often as that costs little; the best weights wait in memory until then."""

    def __init__(self, folder: Path, identity: dict[str, Any], steps: _Steps, report: FitReport) -> None:
        self.folder, self.identity, self.steps, self.report = folder, identity, steps, report
        self._best: dict[str, Tensor] | None = None
        self._waits = False
        self._written, self._took = time.perf_counter(), 0.0

    def keep(self, better: bool) -> None:
        """An epoch has ended.

        Args:
            better: its weights are the best so far.
        """
        if better:
            weights = self.steps.module.state_dict()
            self._best = {name: value.detach().to("cpu", copy=True) for name, value in weights.items()}
        self._waits = True
        if time.perf_counter() - self._written >= _BETWEEN_CHECKPOINTS * self._took:
            self.write()

    def write(self) -> None:
        """Writes what has not been written."""
        if not self._waits:
            return
        began = time.perf_counter()
        if self._best is not None:
            write_content(self.folder / BEST, self._best)
        states = {name: part.state_dict() for name, part in self.steps.parts.items()}
        content = {"format": FORMAT, "identity": self.identity, "report": asdict(self.report), **states}
        write_content(self.folder / LAST, content)
        self._best, self._waits = None, False
        self._written = time.perf_counter()
        self._took = self._written - began


class _Steps:
    """Steps of the optimiser, with its rates and, on a GPU, in mixed precision."""

    def __init__(self, module: nn.Module, settings: NetworkFitSettings, device: torch.device) -> None:
        self.module, self.settings, self.device = module, settings, device
        self.optimiser = _optimiser(module, settings)
        self.plateau = torch.optim.lr_scheduler.ReduceLROnPlateau(
            self.optimiser, factor=settings.factor, patience=settings.plateau_patience
        )
        self.on_gpu = device.type == "cuda"
        self.precision = torch.bfloat16 if self.on_gpu and torch.cuda.is_bf16_supported() else torch.float16
        self.scaler = torch.amp.GradScaler(device.type, enabled=self.on_gpu and self.precision == torch.float16)

    @property
    def parts(self) -> dict[str, Any]:
        """What a checkpoint holds the states of."""
        return {"module": self.module, "optimiser": self.optimiser, "plateau": self.plateau, "scaler": self.scaler}

    @property
    def rate(self) -> float:
        """The learning rate of the last step."""
        return float(self.optimiser.param_groups[0]["lr"])

    def epoch(
        self,
        network: nn.Module,
        objective: Objective,
        batches: Sequence[Indices],
        epoch: int,
        generator: np.random.Generator,
    ) -> tuple[float, float]:
        """A step for each batch.

        Args:
            network: the module, or what shares its gradients with other processes.

        Returns:
            The sum of the losses of all samples, and their number.
        """
        network.train()
        total = count = 0.0
        for number, items in enumerate(batches):
            _set_rate(self.optimiser, self.settings, (epoch + number / len(batches)) / self.settings.epochs)
            batch = _moved(objective.batch(items, generator), self.device)
            with torch.autocast(self.device.type, self.precision, enabled=self.on_gpu):
                value = objective.loss(network, batch)
            self.optimiser.zero_grad()
            self.scaler.scale(value).backward()
            if self.settings.clip:
                self.scaler.unscale_(self.optimiser)
                nn.utils.clip_grad_norm_(self.module.parameters(), self.settings.clip)
            self.scaler.step(self.optimiser)
            self.scaler.update()
            total, count = total + float(value.detach()) * len(items), count + len(items)
        return total, count


def finished(folder: Path | str) -> None:
    """Removes the checkpoints of a training whose network is safe elsewhere, and the folder if that is all in it."""
    folder = Path(folder)
    for name in (LAST, BEST):
        (folder / name).unlink(missing_ok=True)
    if folder.is_dir() and not any(folder.iterdir()):
        folder.rmdir()


@torch.no_grad()
def validate(module: nn.Module, objective: Objective, settings: NetworkFitSettings, ranks: Ranks) -> float | None:
    """Mean loss of the validation items, not augmented; None without items."""
    own = objective.validation_items[ranks.rank :: ranks.count]
    if not len(objective.validation_items):
        return None
    module.eval()
    total = 0.0
    size = max(1, settings.batch_size // ranks.count)
    for start in range(0, len(own), size):
        items = own[start : start + size]
        total += float(objective.loss(module, _moved(objective.batch(items, None), ranks.device))) * len(items)
    total, count = ranks.summed(total, len(own))
    return total / count


def _batches(
    items: Indices, settings: NetworkFitSettings, generator: np.random.Generator, ranks: Ranks
) -> list[Indices]:
    """This rank's batches of an epoch; every rank has as many of them, of the same sizes."""
    order = generator.permutation(items)
    missing = -len(order) % ranks.count
    own = np.concatenate((order, order[:missing]))[ranks.rank :: ranks.count]
    size = max(1, settings.batch_size // ranks.count)
    return [own[start : start + size] for start in range(0, len(own), size)]


def _optimiser(module: nn.Module, settings: NetworkFitSettings) -> torch.optim.Optimizer:
    weights = [weight for weight in module.parameters() if weight.requires_grad]
    if settings.optimiser == "nadam":
        return torch.optim.NAdam(weights, settings.learning_rate, weight_decay=settings.weight_decay)
    if settings.optimiser == "adamw":
        return torch.optim.AdamW(weights, settings.learning_rate, weight_decay=settings.weight_decay, fused=True)
    return torch.optim.SGD(weights, settings.learning_rate, momentum=0.9, weight_decay=settings.weight_decay)


def _set_rate(optimiser: torch.optim.Optimizer, settings: NetworkFitSettings, share: float) -> None:
    if settings.schedule == "one_cycle":
        if share < _RISE:
            factor = 0.04 + 0.96 * 0.5 * (1 - math.cos(math.pi * share / _RISE))
        else:
            factor = 0.5 * (1 + math.cos(math.pi * (share - _RISE) / (1 - _RISE)))
    elif settings.schedule == "polynomial":
        factor = (1.0 - share) ** 0.9
    else:
        return
    for group in optimiser.param_groups:
        group["lr"] = settings.learning_rate * max(factor, 1e-6)


def _moved(batch: Batch, device: torch.device) -> Batch:
    return {name: value.to(device, non_blocking=True) for name, value in batch.items()}


def _out_of_patience(report: FitReport, settings: NetworkFitSettings) -> bool:
    return bool(settings.patience) and len(report.rows) - report.best_epoch >= settings.patience


def _resume(file: Path, identity: dict[str, Any], parts: dict[str, Any], report: FitReport) -> None:
    try:
        content = read_content(file)
        if content["format"] != FORMAT:
            raise KeyError("format")
        for name, mine in identity.items():
            if content["identity"][name] != mine:
                what = "another architecture" if name == "weights" else f"a training with other {name}"
                raise TrainingError(f"{file} is of {what}: remove it to start again, or take another folder")
        for name, part in parts.items():
            part.load_state_dict(content[name])
        report.rows, report.best_epoch = content["report"]["rows"], content["report"]["best_epoch"]
    except TrainingError:
        raise
    except (OSError, *UNFIT) as error:
        raise TrainingError(f"{file} is damaged or no checkpoint of a training: remove it to start again") from error
