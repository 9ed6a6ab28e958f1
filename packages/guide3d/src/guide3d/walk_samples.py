"""Lessons of walking along a wire: true walks with errors put in, and the walker's own, with the right next step."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import TYPE_CHECKING, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from guide3d.modeling.wire_walker import WireWalker
from guide3d.polyline import Array
from guide3d.shape_samples import Clips, ShapeAugmentation, readable

_LOGGER = logging.getLogger(__name__)

if TYPE_CHECKING:
    from guide3d.camera import Camera
    from guide3d.picture_store import PictureStore

_START_MM = 5.0  # standard deviation of where wires enter the image that is worth a word
_STEPPING, _STOPPING, _RESTING = 20.0, 10.0, 0.2  # weights: of steps, of having arrived, of what is left
_MM_PER_CM = 10.0
_FAR_CM = 2.0  # a curve that is farther off has lost the wire: how far says nothing
_BEYOND = 8  # places beyond the tip that a true walk is carried on to
_RETURN = (0.3, 0.3, 0.1)  # share of a walker's distance from the wire that the right step takes away; less in depth
_LOST_MM = (4.0, 15.0)  # farther from the wire, aside and in depth, there is nothing to learn
_BAND = 16  # steps by which a walker may be ahead of the true walk or behind it
_DEPTH = 0.15  # weight of depth where the nearest place of the wire is looked for
_ASIDE_MM, _DEPTH_MM = 1.0, 3.0  # largest standard deviations of errors put into true walks
_MEMORY = (0.97, 0.97, 0.99)  # by which they are like those of the step before
_TURNED = (0.12, 0.12, 0.4)  # largest standard deviations of errors of the heading: without them it is merely kept up
_TURN_MEMORY = (0.8, 0.8, 0.95)


class WalkObjective:
    """What the walker learns: clips of one frame to the walk along its wire, in the camera's frame, tip last."""

    def __init__(
        self,
        store: PictureStore,
        clips: Clips,
        training: int,
        walks: Mapping[int, Array],
        camera: Camera,
        *,
        augmentation: ShapeAugmentation | None = None,
        own_walks: float = 0.5,
    ) -> None:
        """Args:
        store: of the pictures.
        clips: of one frame, to learn from, then those to validate with.
        training: how many of them are learnt from.
        walks: curves of frames, tip first, world.
        camera: that sees them.
        augmentation: of the pictures.
        own_walks: share of the lessons that are the walker's own walks.
        """
        if not training:
            raise ValueError("there is no clip to learn from: the data set's training part has no curve in space")
        self.store, self.clips, self.camera, self.own_walks = store, clips, camera, own_walks
        self.augmentation = augmentation or ShapeAugmentation(0.0, 0.0, 0)
        ids = np.arange(len(clips.frames))
        self.training_items, self.validation_items = ids[:training], ids[training:]
        self.walks = {
            index: (walk[::-1] @ camera.R.T + camera.t_mm).astype(np.float32) for index, walk in walks.items()
        }

    @property
    def positions(self) -> int:
        """M: places of the longest walk that is learnt from, and some."""
        return max(len(walk) for walk in self._learnt()) + _BEYOND

    def statistics(self) -> dict[str, Tensor]:
        """Camera, start, means and scales of what is learnt from, which become buffers of the network."""
        learnt = self._learnt()
        starts, firsts = np.stack([walk[0] for walk in learnt]), np.stack([walk[1] - walk[0] for walk in learnt])
        spread = float(starts.std(axis=0).max())
        if spread > _START_MM:
            _LOGGER.warning(
                "wires enter the image at places %.0f mm apart (standard deviation): the wire walker starts at their "
                "mean; the architecture vit does not depend on it",
                spread,
            )
        places, steps = np.concatenate(learnt), np.concatenate([np.diff(walk, axis=0) for walk in learnt])
        frames = self.clips.frames[self.training_items, -1]
        frames = frames[:: max(1, len(frames) // 32)]
        sample = self.store.pictures(frames[self.store.healthy(frames)])
        told = {
            "intrinsics": self.camera.K, "rotation": self.camera.R, "translation_mm": self.camera.t_mm,
            "start_mm": starts.mean(axis=0),
            "start_heading": firsts.mean(axis=0) / np.linalg.norm(firsts.mean(axis=0)),
            "pixel_scale": max(float(np.percentile(sample, 99.5)) if sample.size else 0.0, 1.0),
            "place_mean": places.mean(axis=0), "place_scale": np.maximum(1.5 * places.std(axis=0), 1.0),
            "step_mean": steps.mean(axis=0), "step_scale": np.maximum(steps.std(axis=0), 1e-2),
        }  # fmt: skip
        return {name: torch.as_tensor(np.asarray(value, np.float32)) for name, value in told.items()}

    def _learnt(self) -> list[NDArray[np.float32]]:
        return [self.walks[int(index)] for index in np.unique(self.clips.targets[self.training_items])]

    def batch(self, items: NDArray[np.int64], generator: np.random.Generator | None) -> dict[str, Tensor]:
        """Pictures, walks, their last places, and the errors to put in (none without a generator)."""
        items = readable(self, items, generator)
        pictures = self.store.pictures(self.clips.frames[items][:, -1]).astype(np.float32)
        walks = [self.walks[int(index)] for index in self.clips.targets[items, -1]]
        last = np.array([len(walk) - 1 for walk in walks])
        longest = int(last.max()) + 1 + _BEYOND
        points = np.stack([carried_on(walk, longest) for walk in walks])
        errors, turns = np.zeros_like(points), np.zeros_like(points)
        if generator is not None:
            with_ = self.augmentation
            gains = np.exp(generator.uniform(-with_.gain, with_.gain, (len(items), 1, 1))).astype(np.float32)
            spread = generator.uniform(0, with_.noise, (len(items), 1, 1)).astype(np.float32)
            pictures = pictures * gains + spread * generator.standard_normal(pictures.shape, np.float32)
            pictures = np.clip(pictures, 0, 255)
            errors = drifts(points.shape, (_ASIDE_MM, _ASIDE_MM, _DEPTH_MM), _MEMORY, generator)
            turns = drifts(points.shape, _TURNED, _TURN_MEMORY, generator)
        return {
            "pictures": torch.from_numpy(pictures),
            "points": torch.from_numpy(points),
            "last": torch.from_numpy(last),
            "errors": torch.from_numpy(errors),
            "turns": torch.from_numpy(turns),
            "own": torch.tensor(generator is None or generator.random() < self.own_walks),
        }

    def loss(self, module: nn.Module, batch: Mapping[str, Tensor]) -> Tensor:
        """Mean loss of a batch; in validation the mean distance of the predicted curves in cm, each at most 2."""
        walker = cast("WireWalker", getattr(module, "module", module))
        points, last, pictures = batch["points"], batch["last"], batch["pictures"]
        if not module.training:
            return torch.stack(
                [
                    _distance_cm(curve, walk[: end + 1].flip(0))
                    for curve, walk, end in zip(walker.found(pictures), points, last.tolist(), strict=True)
                ]
            ).mean()
        if bool(batch["own"]):
            walked = walker.walk(pictures, points.shape[1])
            places, headings, seen = walked.places_mm[:, :-1], walked.headings, walked.seen
        else:
            places = points + batch["errors"]
            made = functional.normalize(places[:, 1:] - places[:, :-1], dim=-1)
            headings = functional.normalize(torch.cat((made[:, :1], made), dim=1) + batch["turns"], dim=-1)
            seen = walker.look(walker.levels(pictures), places, headings)
        steps, stop = module(seen, headings)
        return self.compared(walker, places, headings, steps, stop, points, last).mean()

    def compared(
        self,
        walker: WireWalker,
        places: Tensor,
        headings: Tensor,
        steps: Tensor,
        stop: Tensor,
        points: Tensor,
        last: Tensor,
    ) -> Tensor:
        """Compares told steps and stops with the right ones.

        Args:
            walker: that told them.
            places: (n, k, 3) mm, where it was, the camera's frame.
            headings: (n, k, 3) unit.
            steps: (n, k, 3) mm.
            stop: (n, k, 2) as `Walked.stop`.
            points: (n, k, 3) mm, the true walks, carried on.
            last: (n,) indices of the tips.

        Returns:
            (n,) a loss a walk.
        """
        count = points.shape[1]
        order = torch.arange(count, device=points.device)
        weight = torch.tensor([1.0, 1.0, _DEPTH], device=points.device)
        apart = torch.cdist(places * weight, points * weight)
        apart = apart.masked_fill((order[:, None] - order).abs() > _BAND, torch.inf)
        nearest = apart.argmin(dim=-1)
        there = points.gather(1, nearest[..., None].expand(-1, -1, 3))
        following = points.gather(1, (nearest + 1).clamp(max=count - 1)[..., None].expand(-1, -1, 3))
        away = there - places
        near = (away[..., :2].norm(dim=-1) < _LOST_MM[0]) & (away[..., 2].abs() < _LOST_MM[1])
        near = near & ((nearest - order).abs() < _BAND)  # farther ahead or behind the nearest place is another
        near = near.cumprod(dim=1).bool()  # who was lost knows the way by chance only
        right = walker.step_mm * functional.normalize(following - there + points.new_tensor(_RETURN) * away, dim=-1)
        on_wire = near & (nearest < last[:, None])
        error = ((steps - right) / walker.step_mm).square().sum(-1)
        arrived = nearest >= last[:, None]
        early = near & (nearest < last[:, None] + 4)
        stopping = functional.binary_cross_entropy_with_logits(stop[..., 0], arrived.float(), reduction="none")
        tip = points.gather(1, last[:, None, None].expand(-1, 1, 3))
        left = ((tip - places) * headings).sum(-1) / walker.step_mm
        close = near & (left.abs() < 1.5) & ((nearest - last[:, None]).abs() <= 2)
        rest = (stop[..., 1] - left).square()

        def mean(value: Tensor, where: Tensor) -> Tensor:
            return (value * where).sum(1) / where.sum(1).clamp(min=1)

        return _STEPPING * mean(error, on_wire) + _STOPPING * mean(stopping, early) + _RESTING * mean(rest, close)


def _distance_cm(curve_mm: Tensor, true_mm: Tensor) -> Tensor:
    """Mean distance at equal numbers of steps from the tip, as far as both curves go."""
    count = min(len(curve_mm), len(true_mm))
    return ((curve_mm[:count] - true_mm[:count]).norm(dim=-1).mean() / _MM_PER_CM).clamp(max=_FAR_CM)


def carried_on(walk_mm: NDArray[np.float32], count: int) -> NDArray[np.float32]:
    """Carries a walk on, straight, beyond its last place.

    Args:
        walk_mm: (n, 3).
        count: of places.

    Returns:
        (count, 3).
    """
    more = np.arange(1, count - len(walk_mm) + 1, dtype=np.float32)[:, None]
    return np.concatenate((walk_mm, walk_mm[-1] + more * (walk_mm[-1] - walk_mm[-2])))


def drifts(
    shape: tuple[int, ...], largest: tuple[float, ...], memory: tuple[float, ...], generator: np.random.Generator
) -> NDArray[np.float32]:
    """Errors that change slowly along walks, in the camera's frame.

    Args:
        shape: (n, k, 3).
        largest: standard deviation along each axis; a walk has a tenth of it to all.
        memory: by which an error is like that of the step before.
        generator: of chance.

    Returns:
        (n, k, 3) in the unit of `largest`.
    """
    kept = np.array(memory)
    fresh = generator.standard_normal(shape) * np.sqrt(1.0 - kept**2)
    drift = np.empty(shape)
    now = generator.standard_normal((shape[0], 3))
    for place in range(shape[1]):
        now = kept * now + fresh[:, place]
        drift[:, place] = now
    return np.asarray(drift * np.array(largest) * generator.uniform(0.1, 1.0, (shape[0], 1, 1)), np.float32)
