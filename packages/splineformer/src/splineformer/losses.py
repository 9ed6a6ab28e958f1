"""Losses: those SplineFormer was published with, and those of the parallel variant."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional as F

from splineformer.decoding import decode
from splineformer.modeling.image_head import ImageKind
from splineformer.modeling.ordered import Ordered
from splineformer.modeling.splineformer import Taught

_ONE_WIRE = 1
_WIRE_CELLS = 4.0  # so much more does a cell with wire count
_WIRE_SCALE = 10.0  # brings the mean over mostly empty cells to the size of the other terms


@dataclass(frozen=True)
class PublishedWeights:
    """Weights of the published loss.

    Attributes:
        knots: of the Huber loss of the knots.
        points: of the squared error of the control points.
        end: of the cross-entropy of the end of the sequence.
        curve: of the squared error of samples of the decoded curve.
        tip: of the squared error of the first token.
        kind: of the kind of image, which is an addition.
        samples: of the decoded curve.
    """

    knots: float = 100.0
    points: float = 100.0
    end: float = 1.0
    curve: float = 10.0
    tip: float = 100.0
    kind: float = 0.2
    samples: int = 20


@dataclass(frozen=True)
class OrderedWeights:
    """Weights of the parallel variant's loss.

    Attributes:
        attention: of the cross-entropy of each query's attention with the cells round its true place.
        tip: of the tip's query in that, beside 1 of every other.
        wire: of the cross-entropy of where wire lies at all.
        points: of the distance of the points after the attention, in hundredths of the image's side.
        refined: of the distance of the refined points from the wire.
        curve: of the distance of the curve of the control points.
        step: of the distance of the walker's steps, in cells.
        end: of the cross-entropy of whether the tip lies within a step.
        spread: of the likelihood of the distances under their predicted spread.
        kind: of the kind of image.
    """

    attention: float = 1.0
    tip: float = 8.0
    wire: float = 2.0
    points: float = 0.5
    refined: float = 2.0
    curve: float = 0.1
    step: float = 2.0
    end: float = 2.0
    spread: float = 0.1
    kind: float = 0.2


def kind_loss(kind: ImageKind, wires: Tensor, inverted: Tensor) -> Tensor:
    """Cross-entropy of the number of wires and of the inversion.

    Args:
        kind: logits.
        wires: (B,) 0, 1 or 2.
        inverted: (B,) 0 or 1.
    """
    return F.cross_entropy(kind.wires, wires) + F.binary_cross_entropy_with_logits(kind.inverted, inverted)


def published_loss(taught: Taught, batch: Mapping[str, Tensor], weights: PublishedWeights) -> Tensor:
    """The published loss; images without exactly one wire count only for the kind of image.

    Args:
        taught: what the network says.
        batch: "tokens" (B, limit, 3), "lengths", "wires" and "inverted" (B,).
        weights: of the terms.
    """
    tokens, lengths = batch["tokens"], batch["lengths"]
    one = (batch["wires"] == _ONE_WIRE).to(tokens.dtype)
    place = torch.arange(1, tokens.shape[1], device=tokens.device)[None]
    there = (place < lengths[:, None]) * one[:, None]
    count = there.sum().clamp_min(1.0)
    said, true = taught.following.tokens, tokens[:, 1:]
    knots = (F.huber_loss(said[..., 0], true[..., 0], reduction="none") * there).sum() / count
    points = ((said[..., 1:] - true[..., 1:]).square().mean(-1) * there).sum() / count
    last = (place == lengths[:, None] - 1).to(tokens.dtype)
    end = F.binary_cross_entropy_with_logits(taught.following.end, last, reduction="none")
    tip = ((taught.first - tokens[:, 0]).square().mean(-1) * one).sum() / one.sum().clamp_min(1.0)
    whole = torch.cat([taught.first[:, None], said], 1).float()
    curves = decode(whole, lengths, weights.samples) - decode(tokens, lengths, weights.samples)
    curve = (curves.square().mean((1, 2)) * one).sum() / one.sum().clamp_min(1.0)
    return (
        weights.knots * knots
        + weights.points * points
        + weights.end * (end * there).sum() / count
        + weights.curve * curve
        + weights.tip * tip
        + weights.kind * kind_loss(taught.kind, batch["wires"], batch["inverted"])
    )


def attention_loss(logits: Tensor, points: Tensor) -> Tensor:
    """Cross-entropy of attention with the four cells round each true place, by their bilinear shares.

    Args:
        logits: (B, n, side²), row by row.
        points: (B, n, 2) shares of the side.

    Returns:
        (B, n).
    """
    side = round(logits.shape[-1] ** 0.5)
    place = (points * side - 0.5).clamp(0.0, side - 1.0)
    low = place.floor().clamp(max=side - 2.0)
    share = place - low
    column, row = low.long().unbind(-1)
    chosen = torch.stack([row * side + column, row * side + column + 1], -1)
    x, y = share.unbind(-1)
    upper = logits.gather(2, chosen) * torch.stack([(1 - x) * (1 - y), x * (1 - y)], -1)
    lower = logits.gather(2, chosen + side) * torch.stack([(1 - x) * y, x * y], -1)
    return logits.logsumexp(-1) - upper.sum(-1) - lower.sum(-1)


def nearest_on_curve(points: Tensor, curve: Tensor) -> Tensor:
    """The (B, n, 2) places of (B, S, 2) polylines that lie nearest to (B, n, 2) points."""
    start, step = curve[:, None, :-1], (curve[:, 1:] - curve[:, :-1])[:, None]
    along = ((points[:, :, None] - start) * step).sum(-1) / step.square().sum(-1).clamp_min(1e-12)
    places = start + along.clamp(0.0, 1.0)[..., None] * step
    best = (places - points[:, :, None]).square().sum(-1).argmin(-1)
    return places.gather(2, best[..., None, None].expand(-1, -1, 1, 2))[:, :, 0]


def wire_loss(logits: Tensor, curve: Tensor, wires: Tensor) -> Tensor:
    """Cross-entropy of the cells that wire lies in; images with several wires do not count, for one is not annotated.

    Args:
        logits: (B, side²), row by row.
        curve: (B, S, 2) dense, shares of the side.
        wires: (B,) 0, 1 or 2.
    """
    side = round(logits.shape[-1] ** 0.5)
    column, row = (curve * side).long().clamp(0, side - 1).unbind(-1)
    true = torch.zeros_like(logits).scatter_(1, row * side + column, 1.0) * (wires == _ONE_WIRE)[:, None]
    # few cells hold wire: those that do count for more
    every = F.binary_cross_entropy_with_logits(logits, true, reduction="none") * (1.0 + _WIRE_CELLS * true)
    known = (wires <= _ONE_WIRE).to(logits.dtype)
    return (every.mean(-1) * known).sum() / known.sum().clamp_min(1.0) * _WIRE_SCALE


def ordered_loss(
    said: Ordered, batch: Mapping[str, Tensor], weights: OrderedWeights, bases: Tensor, reach: float
) -> Tensor:
    """The parallel variant's loss; images without exactly one wire count only for their kind and for the cells of wire.

    What a refinement is to learn is the way from a point to the wire, wherever along it: a point that slid along the
    wire cannot see by how much. Tip and end are to reach their own places. Points out of its sight do not count.

    Args:
        said: by the network.
        batch: "points" (B, queries, 2) true places, "curve" (B, S, 2) the true curve at the rows of `bases`,
            "ways" (B, K, 2) and "ends" (B, K) of the walker, in cells, "wires" and "inverted" (B,).
        weights: of the terms.
        bases: (S, control points), takes control points to curve points.
        reach: of a refinement, share of the side.
    """
    points, curve = batch["points"], batch["curve"]
    one = (batch["wires"] == _ONE_WIRE).to(points.dtype)
    share = one / one.sum().clamp_min(1.0)

    def distance(a: Tensor, b: Tensor) -> Tensor:
        # in hundredths of the side; linear far away, so that one lost curve does not drown the others
        return F.smooth_l1_loss(100 * a, 100 * b, reduction="none", beta=0.1).sum(-1)

    query = torch.ones_like(points[0, :, 0])
    query[0] = weights.tip
    attended = (attention_loss(said.attention, points) * query).sum(-1) / query.sum()
    total = weights.attention * (attended * share).sum()
    total = total + weights.points * (distance(said.stages[0], points).mean(-1) * share).sum()
    for former, stage in itertools.pairwise(said.stages):
        former = former.detach()
        target = nearest_on_curve(former, curve)
        target = torch.cat([points[:, :1], target[:, 1:-1], points[:, -1:]], 1)
        seen = ((target - former).norm(dim=-1) < reach) * one[:, None]
        total = total + weights.refined * (distance(stage, target) * seen).sum() / seen.sum().clamp_min(1.0)
    total = total + weights.curve * (distance(bases @ said.control, curve).mean(-1) * share).sum()
    total = total + weights.wire * wire_loss(said.wire, curve, batch["wires"])
    if said.steps is not None:
        steps = F.smooth_l1_loss(said.steps.offsets, batch["ways"], reduction="none", beta=0.2).sum(-1).mean(-1)
        ends = F.binary_cross_entropy_with_logits(said.steps.end, batch["ends"], reduction="none").mean(-1)
        total = total + ((weights.step * steps + weights.end * ends) * share).sum()
    off = 100 * (said.stages[-1] - points).detach().norm(dim=-1)
    likelihood = off * torch.exp(-said.spread) + said.spread
    total = total + weights.spread * (likelihood.mean(-1) * share).sum()
    return total + weights.kind * kind_loss(said.kind, batch["wires"], batch["inverted"])
