"""Samples of shape prediction: clips of consecutive frames of camera A, and the curve in space at each of them."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from guide3d.geometry.polyline import Array, resample
from guide3d.learning.losses import ShapeLoss, fgrn_loss
from guide3d.learning.picture_store import PictureStore, replace_unreadable
from guide3d.modeling.shape_network import PredictedShapes
from guide3d.modeling.spherical import SphericalForm, steps_of_radius
from guide3d.setting_kinds import Grey, Logarithm, settings

if TYPE_CHECKING:
    from guide3d.dataset.dataset import Dataset
    from guide3d.dataset.frame import Frame

CAMERA = "a"

_LOGGER = logging.getLogger(__name__)


def curve_of(frame: Frame) -> Array | None:
    """The curve (n, 3) mm that camera A sees, tip first: the true one, or else its reconstruction; None for neither."""
    return frame.visible_curve_mm(CAMERA) if frame.truth is not None else frame.reconstruction_mm


def walks_of(data: Dataset, step_mm: float, *, chords: bool = True) -> dict[int, Array]:
    """Curves in steps of one length.

    Args:
        chords: whether a step's straight length counts, or its arc.

    Returns:
        Frame to (n, 3) points, tip first; frames without a curve of two steps are left out.

    Raises:
        ValueError: no frame has a curve.
    """
    walks: dict[int, Array] = {}
    for index, frame in enumerate(data.frames):
        curve = curve_of(frame)
        if curve is None or len(curve) < 2 or np.linalg.norm(np.diff(curve, axis=0), axis=1).sum() < 2.5 * step_mm:
            continue
        walks[index] = steps_of_radius(curve, step_mm) if chords else resample(curve, spacing=step_mm)
    if not walks:
        raise ValueError(
            f"{data.root} holds no curve in space: run the stage guide3d on it first, which reconstructs them"
        )
    if len(walks) < len(data.frames):
        _LOGGER.info("%d of %d frames have no curve in space and are not used", len(data) - len(walks), len(data))
    return walks


@dataclass(frozen=True)
class Clips:
    """Windows of frames that follow each other.

    Attributes:
        frames: (n, frames - 1 + targets) indices of frames in time order; an acquisition's first is repeated.
        targets: (n, targets) indices of the frames whose curves are predicted: the last of `frames`.
    """

    frames: NDArray[np.int64]
    targets: NDArray[np.int64]


def clips_of(
    data: Dataset, acquisitions: Sequence[str], known: Mapping[int, Array], frames: int, targets: int
) -> Clips:
    """Cuts acquisitions into clips: neighbouring windows share frames, which an image network then sees only once.

    Args:
        targets: windows a clip.
    """
    seen, predicted = [], []
    for name in acquisitions:
        # the frames between may be without a curve: they are seen, not predicted
        order = data.acquisitions[name]
        places = [place for place, index in enumerate(order) if index in known]
        for start in range(0, len(places), targets):
            chosen = places[start : start + targets]
            together = chosen[-1] - chosen[0] == len(chosen) - 1
            for group in [chosen] if together else [[place] for place in chosen]:
                group = group + [group[-1]] * (targets - len(group))
                first = [max(group[0] - back, 0) for back in range(frames - 1, 0, -1)]
                seen.append([order[place] for place in (*first, *group)])
                predicted.append([order[place] for place in group])
    return Clips(
        np.array(seen, np.int64).reshape(-1, frames - 1 + targets), np.array(predicted, np.int64).reshape(-1, targets)
    )


@settings
class ShapeAugmentation:
    """How samples are varied in training.

    Attributes:
        gain: the grey values are multiplied by a factor of exp(±gain).
        noise: largest standard deviation of noise added to grey values, of 255.
    """

    gain: Logarithm = 0.3
    noise: Grey = 6.0


class ShapeObjective:
    """What the shape network and 3D-FGRN learn: clips to curves."""

    def __init__(
        self,
        store: PictureStore,
        clips: Clips,
        training: int,
        walks: Mapping[int, Array],
        positions: int,
        *,
        form: SphericalForm | None = None,
        loss: ShapeLoss | None = None,
        augmentation: ShapeAugmentation | None = None,
        spacing_mm: float = 2.0,
        anchor: str = "tip",
    ) -> None:
        """Args:
        clips: to learn from, then those to validate with.
        training: how many of them are learnt from.
        form: of the curve; None: Cartesian.
        loss: of the shape network; None: that of 3D-FGRN.
        spacing_mm: of the points, for 3D-FGRN.
        anchor: of `modeling.shape_network.ANCHORS`, from which positions are counted.
        """
        self.anchor = anchor
        self.store, self.clips, self.walks, self.positions = store, clips, walks, positions
        self.form, self.weights, self.spacing_mm = form, loss, spacing_mm
        self.augmentation = augmentation or ShapeAugmentation(0.0, 0.0)
        ids = np.arange(len(clips.frames))
        self.training_items, self.validation_items = ids[:training], ids[training:]
        if not training:
            raise ValueError("there is no clip to learn from: the data set's training part has no curve in space")
        columns = 3 if form is None else 2
        self._points = np.zeros((len(store.frames), positions, 3), np.float32)
        self._offsets = np.zeros((len(store.frames), positions - 1, columns), np.float32)
        self._last = np.zeros(len(store.frames), np.int64)
        for index, walk in walks.items():
            cut = walk[:positions] if anchor == "tip" else walk[::-1][:positions]
            offsets = cut[1:] - cut[0] if form is None else form.encode(walk)
            if form is not None:
                offsets = (offsets if anchor == "tip" else offsets[::-1])[: positions - 1]
            self._points[index, : len(cut)] = cut
            self._offsets[index, : len(offsets)] = offsets
            self._last[index] = len(cut) - 1

    def batch(self, items: NDArray[np.int64], generator: np.random.Generator | None) -> dict[str, Tensor]:
        """Clips and their curves as tensors; clips with an image that cannot be read are replaced by others."""
        items = replace_unreadable(self, items, generator)
        frames, targets = self.clips.frames[items], self.clips.targets[items].reshape(-1)
        pictures = self.store.pictures(frames).astype(np.float32)
        if generator is not None:
            pictures = self._varied(pictures, generator)
        return {
            "pictures": torch.from_numpy(pictures),
            "points": torch.from_numpy(self._points[targets]),
            "offsets": torch.from_numpy(self._offsets[targets]),
            "last": torch.from_numpy(self._last[targets]),
        }

    def healthy(self, items: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Returns whether all images of each clip can be read, (n,)."""
        return np.asarray(self.store.healthy(self.clips.frames[items]).all(axis=1))

    @property
    def damaged(self) -> list[str]:
        """Names of the frames whose image could not be read so far."""
        return self.store.damaged

    def loss(self, module: nn.Module, batch: Mapping[str, Tensor]) -> Tensor:
        """Mean loss of a batch."""
        if self.weights is None:
            predicted = module(batch["pictures"][:, -1])
            return fgrn_loss(predicted, batch["points"], batch["last"], spacing_mm=self.spacing_mm).mean()
        # the true end leads the curve to its tip in training; in validation the network's own does
        shapes: PredictedShapes = module(batch["pictures"], batch["last"] if module.training else None)
        return self.weights(shapes, batch["points"], batch["offsets"], batch["last"], self.anchor).mean()

    def statistics(self) -> dict[str, Tensor]:
        """Means and scales of what is learnt from, which become buffers of the network."""
        targets = np.unique(self.clips.targets[self.training_items])
        offsets, last = self._offsets[targets], self._last[targets]
        firsts, lasts = self._points[targets, 0], self._points[targets, last]
        tips, entries = (firsts, lasts) if self.anchor == "tip" else (lasts, firsts)
        inside = np.arange(self.positions - 1) < last[:, None]
        weight = inside[..., None] / np.maximum(inside.sum(0), 1)[:, None]
        mean = (offsets * weight).sum(0)
        spread = np.sqrt((np.square(offsets - mean) * weight).sum(0))
        # Positions that few curves reach borrow from their neighbours nearer the anchor.
        few = inside.sum(0) < max(4, 0.02 * len(targets))
        if few.any() and not few.all():
            source = int(np.flatnonzero(~few)[-1])
            mean[few], spread[few] = mean[source], spread[source]
        points = np.concatenate((np.zeros((1, 3)), mean)) if self.form is None else None
        sample = self.store.pictures(targets[:: max(1, len(targets) // 64)]).astype(np.float32)
        values = {
            "tip_mean": tips.mean(0), "tip_scale": np.maximum(tips.std(0), 1.0),
            "entry_mean": entries.mean(0), "entry_scale": np.maximum(entries.std(0), 1.0),
            "offset_mean": mean, "offset_scale": np.maximum(spread, 1e-2),
            "pixel_mean": sample.mean(), "pixel_scale": max(float(sample.std()), 1.0),
        }  # fmt: skip
        if points is not None:
            values["point_mean"] = points + firsts.mean(0)
            values["point_scale"] = max(float(tips.std(0).mean()), 1.0)
        return {name: torch.as_tensor(np.asarray(value, np.float32)) for name, value in values.items()}

    def _varied(self, pictures: NDArray[np.float32], generator: np.random.Generator) -> NDArray[np.float32]:
        """Varies clips (n, length, h, w)."""
        with_ = self.augmentation
        count = len(pictures)
        if with_.gain:
            pictures = pictures * np.exp(generator.uniform(-with_.gain, with_.gain, (count, 1, 1, 1))).astype(
                np.float32
            )
        if with_.noise:
            spread = generator.uniform(0, with_.noise, (count, 1, 1, 1)).astype(np.float32)
            pictures = pictures + spread * generator.standard_normal(pictures.shape, np.float32)
        return np.clip(pictures, 0, 255)
