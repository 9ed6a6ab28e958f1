"""Losses: of the shape network (tip, spherical or Cartesian offsets, stop, curve), of 3D-FGRN, and of segmentation."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from guide3d.modeling.shape_network import PredictedShapes, expected_position
from guide3d.setting_kinds import Weight, settings

_SMALLEST = 1e-6
_NEAR_CM2 = 0.01  # below, a robust distance falls like its square
_MM_PER_CM, _MM_PER_M = 10.0, 1000.0
_HUBER = 1000.0  # weight of the Huber loss of 3D-FGRN, whose threshold is 1 m: it is quadratic throughout


@settings
class ShapeLoss:
    """Weights of the shape network's loss; lengths count in cm, angles in rad.

    Attributes:
        offset: of the offsets' mean squared error; Cartesian offsets are points, in cm.
        stop: of the binary cross-entropy of each position's stop.
        curve: of the mean squared distance of the decoded curve from the true one; 0 as in the thesis.
        length: of the distance of the mean stop from the true one, in positions; 0 as in the thesis.
        robust: whether tip and curve count by their distance, not its square: one lost loop must not drown the rest.
    """

    tip: Weight = 1.0
    offset: Weight = 1.0
    stop: Weight = 1.0
    curve: Weight = 0.0
    length: Weight = 0.0
    robust: bool = False

    def __call__(
        self, predicted: PredictedShapes, points_mm: Tensor, offsets: Tensor, last: Tensor, anchor: str = "tip"
    ) -> Tensor:
        """Compares predicted with true curves; gives (n,) a loss a curve.

        Args:
            points_mm: (n, M, 3) from the anchor on, padded.
            offsets: (n, M - 1, 2 or 3), padded as they are.
            last: (n,) index of each curve's last point.
            anchor: of `modeling.shape_network.ANCHORS`: the first point is the tip, or the last.
        """
        positions = torch.arange(points_mm.shape[1], device=last.device)
        inside = (positions <= last[:, None]).float()
        steps = inside[:, 1:]
        cm = 1.0 if predicted.offsets.shape[-1] == 2 else 1.0 / _MM_PER_CM
        tips = points_mm[:, 0] if anchor == "tip" else points_mm[torch.arange(len(last), device=last.device), last]
        tip = self._counted(((predicted.tip_mm - tips) / _MM_PER_CM).square().sum(-1))
        offset = (cm * (predicted.offsets - offsets)).square().sum(-1)
        total = self.tip * tip + self.offset * (offset * steps).sum(1) / steps.sum(1)
        if self.curve:
            apart = self._counted(((predicted.points_mm - points_mm) / _MM_PER_CM).square().sum(-1))
            total = total + self.curve * (apart * inside).sum(1) / inside.sum(1)
        if self.length:
            total = total + self.length * (expected_position(predicted.stop_logits) - last).abs()
        return total + self.stop * stop_loss(predicted.stop_logits, last)

    def _counted(self, squared_cm2: Tensor) -> Tensor:
        return (squared_cm2 + _NEAR_CM2).sqrt() - _NEAR_CM2**0.5 if self.robust else squared_cm2


def stop_loss(logits: Tensor, last: Tensor) -> Tensor:
    """Binary cross-entropy of the softmax over positions against the one where the curve ends.

    Args:
        logits: (n, M).
        last: (n,) index of the end.

    Returns:
        (n,) summed over positions.
    """
    chance = logits.softmax(-1).clamp(max=1.0 - _SMALLEST)
    others = torch.log1p(-chance)
    column = last[:, None]
    right = logits.log_softmax(-1).gather(1, column).squeeze(1)
    return -(right + others.sum(1) - others.gather(1, column).squeeze(1))


def fgrn_loss(predicted_mm: Tensor, points_mm: Tensor, last: Tensor, *, spacing_mm: float = 2.0) -> Tensor:
    """Huber loss of the points and the deviation of their spacing, both in metres, as 3D-FGRN is trained with.

    Args:
        predicted_mm: (n, points, 3).
        points_mm: (n, points, 3), padded.
        last: (n,) index of each curve's last point: those beyond do not count.

    Returns:
        (n,) a loss a curve.
    """
    inside = (torch.arange(points_mm.shape[1], device=last.device) <= last[:, None]).float()
    huber = functional.huber_loss(predicted_mm / _MM_PER_M, points_mm / _MM_PER_M, reduction="none", delta=1.0).mean(-1)
    gaps = (predicted_mm[:, 1:] - predicted_mm[:, :-1]).norm(dim=-1)
    spacing = (gaps - spacing_mm).abs() / _MM_PER_M
    steps = inside[:, 1:]
    return _HUBER * (huber * inside).sum(1) / inside.sum(1) + (spacing * steps).sum(1) / steps.sum(1).clamp(min=1)


def segmentation_loss(logits: Tensor, masks: Tensor, *, dice: float = 0.5) -> Tensor:
    """Binary cross-entropy and, with the share `dice`, the complement of the soft Dice coefficient over the batch.

    Args:
        logits: (batch, 1, h, w).
        masks: (batch, 1, h, w) share of each pixel that is wire, 0 to 1.
    """
    logits = logits.float()
    entropy = functional.binary_cross_entropy_with_logits(logits, masks)
    chance = logits.sigmoid()
    overlap = (2.0 * (chance * masks).sum() + 1.0) / (chance.sum() + masks.sum() + 1.0)
    return (1.0 - dice) * entropy + dice * (1.0 - overlap)
