"""Losses: those SplineFormer was published with, and those of the ordered variant."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import torch
from torch import Tensor
from torch.nn import functional as F

from splineformer.decoding import decode
from splineformer.modeling.curve_network import ImageKind
from splineformer.modeling.ordered import OrderedPrediction
from splineformer.modeling.published import TaughtTokens

_ONE_WIRE = 1
_SOFT = 0.1  # hundredths of the side: below, a distance falls like its square
_SLIDE = 0.05  # of the length: so far from its own place a refined point may belong
_ON_WIRE = 0.6  # hundredths of the side: so near a point lies on the wire
_FAR = 1e3

# Weights of the published loss, and samples of a decoded curve.
_KNOTS = 100.0  # of the Huber loss of the knots
_POINTS = 100.0
_END = 1.0  # of the cross-entropy of the end of the sequence
_CURVE = 10.0  # of the squared error of samples of the decoded curve
_TIP = 100.0  # of the squared error of the first token
_KIND = 0.2  # of the kind of image, which is an addition
_SAMPLES = 20

# Weights of the ordered variant's loss; distances are in hundredths of the image's side.
_COURSE = 1.0  # of the distance of the course's points, up to the first beyond the tip
_LENGTH = 0.5  # of the error of the length, in steps
_OVERVIEW = 0.5  # of the distance of the course's points at shares of the length
_HEAT = 1.0  # of the cross-entropy of the heat map with the four cells round the tip
_OFFSET = 0.2  # of the distance from those cells' places to the tip
_REVISED = 1.0  # of the distance of the revised points from their own places
_REFINED = 1.0  # of the distance of the refined points from the wire
_OF_CONTROL = 0.1  # of the distance of the curve of the control points
_SPREAD = 0.1  # of the likelihood of the distances under their predicted spread
_LIES_ON_WIRE = 0.1  # of the cross-entropy of whether points lie on the wire
_ORDERED_KIND = 0.4


def kind_loss(kind: ImageKind, wires: Tensor, inverted: Tensor) -> Tensor:
    """Cross-entropy of the number of `wires` (B,), 0 to 2, and of the inversion (B,), 0 or 1."""
    return F.cross_entropy(kind.wires, wires) + F.binary_cross_entropy_with_logits(kind.inverted, inverted)


def published_loss(taught: TaughtTokens, batch: Mapping[str, Tensor]) -> Tensor:
    """The published loss; images without exactly one wire count only for the kind of image.

    The batch holds "tokens" (B, limit, 3), "lengths", "wires" and "inverted" (B,).
    """
    tokens, lengths = batch["tokens"], batch["lengths"]
    one = (batch["wires"] == _ONE_WIRE).to(tokens.dtype)
    place = torch.arange(1, tokens.shape[1], device=tokens.device)[None]
    valid = (place < lengths[:, None]) * one[:, None]
    count = valid.sum().clamp_min(1.0)
    predicted, true = taught.following.tokens, tokens[:, 1:]
    knots = (F.huber_loss(predicted[..., 0], true[..., 0], reduction="none") * valid).sum() / count
    points = ((predicted[..., 1:] - true[..., 1:]).square().mean(-1) * valid).sum() / count
    last = (place == lengths[:, None] - 1).to(tokens.dtype)
    end = F.binary_cross_entropy_with_logits(taught.following.end, last, reduction="none")
    tip = ((taught.first - tokens[:, 0]).square().mean(-1) * one).sum() / one.sum().clamp_min(1.0)
    whole = torch.cat([taught.first[:, None], predicted], 1).float()
    curves = decode(whole, lengths, _SAMPLES) - decode(tokens, lengths, _SAMPLES)
    curve = (curves.square().mean((1, 2)) * one).sum() / one.sum().clamp_min(1.0)
    return (
        _KNOTS * knots
        + _POINTS * points
        + _END * (end * valid).sum() / count
        + _CURVE * curve
        + _TIP * tip
        + _KIND * kind_loss(taught.kind, batch["wires"], batch["inverted"])
    )


def attention_loss(logits: Tensor, points: Tensor) -> Tensor:
    """(B, n) cross-entropy of attention with the four cells round each true place, by their bilinear shares.

    The logits are (B, n, side²), row by row; the points (B, n, 2) shares of the side.
    """
    side = round(logits.shape[-1] ** 0.5)
    place = (points * side - 0.5).clamp(0.0, side - 1.0)
    low = place.floor().clamp(max=side - 2.0)
    share = place - low
    column, row = low.long().unbind(-1)
    corners = torch.stack([row * side + column, row * side + column + 1], -1)
    x, y = share.unbind(-1)
    upper = logits.gather(2, corners) * torch.stack([(1 - x) * (1 - y), x * (1 - y)], -1)
    lower = logits.gather(2, corners + side) * torch.stack([(1 - x) * y, x * y], -1)
    return logits.logsumexp(-1) - upper.sum(-1) - lower.sum(-1)


def offset_loss(offsets: Tensor, points: Tensor) -> Tensor:
    """(B,) distances of true places from those that the four cells round them predict, in hundredths of the side.

    The offsets are (B, side², 2) from the centres of cells, in cells; the points (B, 2) shares of the side.
    """
    side = round(offsets.shape[1] ** 0.5)
    low = (points * side - 0.5).floor().clamp(0.0, side - 2.0).long()
    total = torch.zeros_like(points[:, 0])
    for down, right in itertools.product((0, 1), repeat=2):
        column, row = low[:, 0] + right, low[:, 1] + down
        predicted = offsets.gather(1, (row * side + column)[:, None, None].expand(-1, 1, 2))[:, 0]
        centre = torch.stack([column, row], -1) + 0.5
        total = total + distance((centre + predicted) / side, points) / 4
    return total


def distance(a: Tensor, b: Tensor) -> Tensor:
    """Distances of (..., 2) points, in hundredths of the side.

    They count as such and not by their squares: one lost curve must not drown the others.
    """
    return ((100.0 * (a - b)).square().sum(-1) + _SOFT**2).sqrt() - _SOFT


def nearest_on_curve(points: Tensor, curve: Tensor, shares: Tensor | None = None, within: float = 1.0) -> Tensor:
    """The places (B, n, 2) of curves that lie nearest to points.

    Args:
        points: (B, n, 2).
        curve: (B, S, 2) polylines, at equal shares of their length.
        shares: (n,) of the length, where the points belong; None: anywhere.
        within: so far from there, as a share of the length, places are looked for: what runs beside is another strand.
    """
    start, step = curve[:, None, :-1], (curve[:, 1:] - curve[:, :-1])[:, None]
    along = ((points[:, :, None] - start) * step).sum(-1) / step.square().sum(-1).clamp_min(1e-12)
    places = start + along.clamp(0.0, 1.0)[..., None] * step
    apart = (places - points[:, :, None]).square().sum(-1)
    if shares is not None:
        middles = (torch.arange(step.shape[2], device=points.device) + 0.5) / step.shape[2]
        apart = apart + _FAR * ((middles - shares[:, None]).abs() > within)
    best = apart.argmin(-1)
    return places.gather(2, best[..., None, None].expand(-1, -1, 1, 2))[:, :, 0]


def ordered_loss(
    predicted: OrderedPrediction,
    batch: Mapping[str, Tensor],
    bases: Tensor,
    shares: Tensor,
    sights: Sequence[float],
) -> Tensor:
    """The ordered variant's loss; images without exactly one wire, or turned over, count only for their kind.

    Revisions are to bring points to their own places. What a refinement is to learn is the way from a point to the
    wire, wherever along it: a point that slid along the wire cannot see by how much. Tip and end are to reach their
    own places. Points out of its sight do not count.

    Args:
        batch: "course" (B, steps, 2), "length" (B,), "points" (B, queries, 2) true places, "curve" (B, S, 2), the true
            curve at equal shares of its length, "wires" and "inverted" (B,).
        bases: (S, control points), takes control points to curve points.
        shares: (queries,) of the length.
        sights: of the refinements, shares of the side.
    """
    points, curve = batch["points"], batch["curve"]
    one = ((batch["wires"] == _ONE_WIRE) & (batch["inverted"] < 0.5)).to(points.dtype)
    share = one / one.sum().clamp_min(1.0)
    true = batch["length"]
    steps = torch.arange(predicted.course.shape[1], device=true.device)
    valid = (steps < true[:, None] + 1.0) * one[:, None]
    total = _COURSE * (distance(predicted.course, batch["course"]) * valid).sum() / valid.sum().clamp_min(1.0)
    total = total + _LENGTH * (F.smooth_l1_loss(predicted.length, true, reduction="none", beta=0.1) * share).sum()
    total = total + _OVERVIEW * (distance(predicted.overview, points).mean(-1) * share).sum()
    # what looks from near by is learnt from the first images of the batch
    near = len(predicted.tip.place)
    points, curve, one = points[:near], curve[:near], one[:near]
    share = one / one.sum().clamp_min(1.0)
    tip = attention_loss(predicted.tip.logits[:, None], points[:, :1])[:, 0]
    total = total + _HEAT * (tip * share).sum()
    total = total + _OFFSET * (offset_loss(predicted.tip.offsets, points[:, 0]) * share).sum()
    for revised in predicted.revised:
        total = total + _REVISED * (distance(revised, points).mean(-1) * share).sum()
    target = points
    for sight, former, stage in zip(sights, predicted.begun, predicted.stages, strict=True):
        target = nearest_on_curve(former.detach(), curve, shares, _SLIDE)
        target = torch.cat([points[:, :1], target[:, 1:-1], points[:, -1:]], 1)
        seen = ((target - former).norm(dim=-1) < sight) * one[:, None]
        total = total + _REFINED * (distance(stage, target) * seen).sum() / seen.sum().clamp_min(1.0)
    total = total + _OF_CONTROL * (distance(bases @ predicted.control, curve).mean(-1) * share).sum()
    off = (100 * (predicted.stages[-1] - target).norm(dim=-1)).detach()
    likelihood = off * torch.exp(-predicted.spread) + predicted.spread
    total = total + _SPREAD * (likelihood.mean(-1) * share).sum()
    right = (off < _ON_WIRE).to(off.dtype)
    on_wire = F.binary_cross_entropy_with_logits(predicted.on_wire, right, reduction="none").mean(-1)
    total = total + _LIES_ON_WIRE * (on_wire * share).sum()
    return total + _ORDERED_KIND * kind_loss(predicted.kind, batch["wires"], batch["inverted"])
