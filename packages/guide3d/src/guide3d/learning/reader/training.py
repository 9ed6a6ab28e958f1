"""Trains the reader network on random fluoroscopy; resumable, and the same for the same seed on the same machine."""

from __future__ import annotations

import hashlib
import json
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional
from torch.utils.data import DataLoader, Dataset

from guide3d.learning.model_file import read_content, write_content
from guide3d.learning.precision import bfloat16_on_processor, has_bfloat16
from guide3d.modeling.reader_network import ReaderNetwork, reader_input
from guide3d.opencv import cv2
from guide3d.random_fluoroscopy.random_fluoroscopy import RandomFluoroscopy, RandomImage
from guide3d.random_fluoroscopy.settings import FluoroscopySettings
from guide3d.setting_kinds import Count, LearningRate, Pixels, Positive, Share, Units, Weight, settings

_AHEAD = 6  # batches that each process draws in advance


CHECKPOINT = "reader_fit.pt"
_KEPT_EVERY_S = 60.0
_TOLD_EVERY = 100  # steps
_TIP_MASS_PX = 2 * math.pi * 3.0**2  # of one tip's Gaussian


class ReaderTiles(Dataset):
    """The network's input and target of random tiles by index."""

    def __init__(
        self,
        settings: FluoroscopySettings,
        seed: int,
        tile_px: int,
        courses: Sequence[NDArray[np.floating]] = (),
        backgrounds: Sequence[NDArray[np.floating]] = (),
    ) -> None:
        """Args:
        courses: and backgrounds: see `guide3d.random_fluoroscopy.random_fluoroscopy.RandomFluoroscopy`.
        """
        self.fluoroscopy = RandomFluoroscopy(settings, seed, courses, backgrounds)
        self.tile_px = tile_px

    def __getitem__(self, index: int) -> tuple[Tensor, Tensor]:
        """Input (2, h, w) and target (3, h, w) of a tile, 16 bits each, which halves what passes between processes."""
        drawn = self.fluoroscopy.tile(index, self.tile_px)
        return torch.from_numpy(reader_input(drawn.image)).half(), torch.from_numpy(reader_target(drawn)).half()


def reader_target(drawn: RandomImage) -> NDArray[np.float32]:
    """What the network is to give for an image: (3, h, w), 0 to 1, of wire, catheter and tip."""
    return np.stack((drawn.wire / np.float32(255), drawn.catheter / np.float32(255), drawn.tip))


def tile_batches(
    tiles: ReaderTiles, first_step: int, steps: int, batch_size: int, processes: int
) -> Iterator[tuple[Tensor, Tensor]]:
    """Batches of the steps `first_step` to `steps` - 1, float32, the same whatever the number of processes.

    Args:
        processes: that draw; 0: this one.
    """
    indices = range(first_step * batch_size, steps * batch_size)
    loader = DataLoader(
        tiles, batch_size, sampler=indices, num_workers=processes, worker_init_fn=_one_thread,
        prefetch_factor=_AHEAD if processes else None,
    )  # fmt: skip
    for images, targets in loader:
        yield images.float(), targets.float()


def _one_thread(_: int) -> None:
    cv2.setNumThreads(1)
    torch.set_num_threads(1)


@settings
class ReaderRecipe:
    """How the reader is trained.

    Attributes:
        block_px: and widths: of `guide3d.modeling.reader_network.ReaderNetwork`.
        tile_px: side of the tiles.
        steps: of the optimiser, each with `batch_size` tiles.
        warm_up: share of the steps in which the learning rate rises; then it falls like a cosine to 1 % of it.
        average: decay of the moving average of the weights, which is what is kept.
        wire_weight: of a pixel of wire or catheter in the binary cross-entropy, against one of background.
        tip_weight: of a pixel of a tip, likewise.
        dice, catheter, tip: weights of these terms, that of the wire's entropy being 1.
        precision: of the convolutions: "float32", "bfloat16", or "auto": bfloat16 where the processor has it.
    """

    block_px: Pixels = 2
    widths: tuple[Units, ...] = (16, 32, 64, 96, 96)
    tile_px: Pixels = 256
    steps: Count = 8600
    batch_size: Count = 8
    learning_rate: LearningRate = 3e-3
    weight_decay: Weight = 0.01
    warm_up: Share = 0.03
    average: Share = 0.998
    wire_weight: Positive = 3.0
    tip_weight: Positive = 8.0
    dice: Weight = 0.5
    catheter: Weight = 0.4
    tip: Weight = 0.05
    clip: Positive = 5.0
    precision: Literal["auto", "float32", "bfloat16"] = "auto"
    fluoroscopy: FluoroscopySettings = field(default_factory=FluoroscopySettings)

    def __post_init__(self) -> None:
        """Refuses tiles that the network cannot take."""
        multiple = self.block_px * 2 ** (len(self.widths) - 1)
        if self.tile_px % multiple:
            raise ValueError(f"tile_px must be a multiple of {multiple}, got {self.tile_px}")


def smoke_recipe() -> ReaderRecipe:
    """A recipe of seconds, for tests."""
    return ReaderRecipe(widths=(8, 8, 8), tile_px=64, steps=12, batch_size=4, precision="float32")


def reader_loss(logits: Tensor, target: Tensor, recipe: ReaderRecipe) -> Tensor:
    """Weighted binary cross-entropy of the three maps, and the Dice coefficient's complement of wire and catheter.

    Args:
        logits: (batch, 3, h, w); target: the same, 0 to 1.
    """
    weight = torch.tensor([recipe.wire_weight, recipe.wire_weight, recipe.tip_weight]).view(1, 3, 1, 1)
    entropy = functional.binary_cross_entropy_with_logits(logits, target, pos_weight=weight, reduction="none")
    wire, catheter, tip = entropy.sum(dim=(0, 2, 3)).unbind()
    pixels = logits.numel() / 3
    chance, true = logits[:, :2].sigmoid(), target[:, :2]
    overlap = 2 * (chance * true).sum(dim=(0, 2, 3)) + 1
    dice = 1 - overlap / (chance.sum(dim=(0, 2, 3)) + true.sum(dim=(0, 2, 3)) + 1)
    tips = target[:, 2].sum() / _TIP_MASS_PX + 1.0
    loss: Tensor = (
        wire / pixels + recipe.dice * dice[0]
        + recipe.catheter * (catheter / pixels + recipe.dice * dice[1])
        + recipe.tip * tip / (tips * _TIP_MASS_PX)
    )  # fmt: skip
    return loss


def train_reader(
    recipe: ReaderRecipe,
    folder: Path,
    *,
    seed: int = 0,
    processes: int = 1,
    courses: Sequence[NDArray[np.floating]] = (),
    backgrounds: Sequence[NDArray[np.floating]] = (),
    start: Mapping[str, Tensor] | None = None,
    progress: Callable[[int, float], None] | None = None,
) -> tuple[ReaderNetwork, dict[str, Any]]:
    """Trains the reader; goes on from the checkpoint in `folder`, if there is one of the same recipe and seed.

    Args:
        seed: of the weights and of what is drawn.
        processes: that draw tiles; 0: this one.
        start: weights to begin with, of a network of the same sizes; None: random ones.
        progress: called after every hundredth step, or tenth of the steps, with the step and the mean loss since then.

    Returns:
        The averaged network, and steps, seconds (of this run), processor seconds and the last loss.

    Raises:
        ValueError: the checkpoint in `folder` is of another recipe, seed, courses, backgrounds or start, or the loss is
            not finite.
    """
    torch.manual_seed(seed)
    network = _made(recipe)
    if start is not None:
        try:
            network.load_state_dict(start)
        except RuntimeError as error:
            why = str(error).splitlines()[-1].strip()
            raise ValueError(f"the weights to start from are of another network: {why}") from None
    averaged = _made(recipe)
    averaged.load_state_dict(network.state_dict())
    optimiser = torch.optim.AdamW(network.parameters(), lr=recipe.learning_rate, weight_decay=recipe.weight_decay)
    digest = _digest([*courses, *backgrounds, *(value.numpy() for value in (start or {}).values())])
    counts = [len(courses), len(backgrounds), len(start or {})]
    identity = json.dumps({"recipe": asdict(recipe), "seed": seed, "counts": counts, "given": digest})
    path = folder / CHECKPOINT
    step = 0
    if path.is_file():
        checkpoint = read_content(path)
        if checkpoint["identity"] != identity:
            raise ValueError(f"{path} belongs to a training with other settings: remove it, or give another folder")
        network.load_state_dict(checkpoint["network"])
        averaged.load_state_dict(checkpoint["averaged"])
        optimiser.load_state_dict(checkpoint["optimiser"])
        step = checkpoint["step"]
    reduced = recipe.precision == "bfloat16" or (recipe.precision == "auto" and has_bfloat16())
    tiles = ReaderTiles(recipe.fluoroscopy, seed, recipe.tile_px, courses, backgrounds)
    began, own, last_kept, recent = time.monotonic(), time.process_time(), time.monotonic(), []
    mean, every = float("nan"), max(1, min(_TOLD_EVERY, recipe.steps // 10))
    network.train()
    for images, target in tile_batches(tiles, step, recipe.steps, recipe.batch_size, processes):
        for group in optimiser.param_groups:
            group["lr"] = recipe.learning_rate * _rate(step / recipe.steps, recipe.warm_up)
        with bfloat16_on_processor(reduced):
            logits = network(images.contiguous(memory_format=torch.channels_last))
        loss = reader_loss(logits.float(), target, recipe)
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), recipe.clip)
        optimiser.step()
        step += 1
        _average(averaged, network, min(recipe.average, step / (step + 10)))
        recent.append(loss.item())
        if step % every == 0 or step == recipe.steps:
            mean, recent = float(np.mean(recent)), []
            if not math.isfinite(mean):
                raise ValueError(f"the loss is no longer finite after {step} steps: lower the learning rate")
            if progress is not None:
                progress(step, mean)
        if time.monotonic() - last_kept > _KEPT_EVERY_S or step == recipe.steps:
            last_kept = time.monotonic()
            states = {"averaged": averaged.state_dict(), "optimiser": optimiser.state_dict()}
            write_content(path, {"identity": identity, "step": step, "network": network.state_dict(), **states})
    report = {
        "seed": seed, "steps": step, "loss": mean, "seconds": time.monotonic() - began,
        "processor_seconds": time.process_time() - own, "bfloat16": reduced,
    }  # fmt: skip
    return averaged.eval(), report


def _digest(arrays: Sequence[NDArray[Any]]) -> str:
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(f"{array.shape} {array.dtype}".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def _made(recipe: ReaderRecipe) -> ReaderNetwork:
    network = ReaderNetwork(block_px=recipe.block_px, widths=tuple(recipe.widths))
    layout: Any = {"memory_format": torch.channels_last}
    return network.to(**layout)


def _rate(share: float, warm_up: float) -> float:
    if share < warm_up:
        return 0.05 + 0.95 * share / warm_up
    return 0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * (share - warm_up) / (1 - warm_up)))


@torch.no_grad()
def _average(averaged: ReaderNetwork, network: ReaderNetwork, decay: float) -> None:
    mean, new = averaged.state_dict(), network.state_dict()
    for name, value in mean.items():
        if value.dtype.is_floating_point:
            value.lerp_(new[name], 1 - decay)
        else:
            value.copy_(new[name])
