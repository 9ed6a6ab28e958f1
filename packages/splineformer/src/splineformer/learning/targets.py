"""Targets of each variant: what a batch's curves become for it, its loss, and where its training starts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from guide3d.geometry.polyline import arc_length, at_length
from splineformer.decoding import collocation
from splineformer.learning.augmentation import at_shares, perturbed
from splineformer.learning.losses import ordered_loss, published_loss
from splineformer.modeling.ordered import OrderedSplineFormer
from splineformer.modeling.published import SplineFormer

_CURVE_SAMPLES = 128  # of the ordered variant's curve loss
_NEAR_PCT = 40  # of a batch's images teach what looks from near by: it learns sooner than the overview, and costs more
_FITTED_A_TOKEN = 8  # points of a curve
_DISTURBED = 0.2  # largest standard deviation, shares of the length and of the side
_BEGINS = 0.4  # share of samples whose tip and refinements begin near the true curve, not where the overview says

Curve = NDArray[np.float64]


class Targets(Protocol):
    """What a variant learns from curves."""

    def __call__(self, curves: Sequence[Curve], generator: np.random.Generator | None) -> dict[str, Tensor]:
        """Tensors of (n, 2) curves, shares of the side, tip first; a generator draws what only training needs."""

    def loss(self, module: nn.Module, batch: Mapping[str, Tensor]) -> Tensor:
        """Mean loss of a batch of "images" (B, 1, s, s), "wires" and "inverted" (B,), and these tensors."""

    def start(self, targets: Mapping[str, Tensor]) -> None:
        """Sets the network's biases so that, untrained, it predicts the mean of these targets."""


class PublishedTargets:
    """Tokens in network units: "tokens" (B, limit, 3), "lengths" (B,), and "given" (B, limit - 1, 3) to go on from.

    Control points are fitted to equal knots by least squares. Given tokens are disturbed: from true ones the decoder
    would go on without looking at the image, and its own are never true.
    """

    def __init__(self, network: SplineFormer) -> None:
        self.network = network
        knots = torch.from_numpy(network.knots)
        self.shares = np.linspace(0.0, 1.0, _FITTED_A_TOKEN * network.limit)
        self.bases = collocation(knots, torch.from_numpy(self.shares)).numpy()
        self.to_control = np.linalg.pinv(self.bases[:, 1:-1])
        self.knots = network.knots[-network.limit :]

    def __call__(self, curves: Sequence[Curve], generator: np.random.Generator | None) -> dict[str, Tensor]:
        points = np.stack([at_shares(curve, self.shares) for curve in curves])
        ends = points[:, [0, -1]]  # the first and the last control point
        inner = self.to_control @ (points - self.bases[:, [0, -1]] @ ends)
        control = np.concatenate([ends[:, :1], inner, ends[:, 1:]], axis=1)
        knots = np.broadcast_to(self.knots[:, None], (*control.shape[:2], 1))
        tokens = torch.from_numpy(np.concatenate([knots, control], axis=2).astype(np.float32))
        inputs = disturbed(tokens[:, :-1], generator or np.random.default_rng(0))
        return {"tokens": tokens, "lengths": torch.full((len(curves),), self.network.limit), "given": inputs}

    def loss(self, module: nn.Module, batch: Mapping[str, Tensor]) -> Tensor:
        return published_loss(module(batch["images"], batch["given"]), batch)

    def start(self, targets: Mapping[str, Tensor]) -> None:
        self.network.tip.start_at(targets["tokens"][:, 0].mean(0))


def disturbed(tokens: Tensor, generator: np.random.Generator) -> Tensor:
    """Disturbs (B, M, 3) tokens but the first: a level for each sequence, for all of its tokens alike and for each."""
    batch, count = tokens.shape[:2]
    level = generator.uniform(0.0, _DISTURBED, (batch, 1, 1))
    offset = generator.standard_normal((batch, 1, 3)) + generator.standard_normal((batch, count, 3))
    offset[:, 0] = 0.0
    return tokens + torch.from_numpy((level * offset).astype(np.float32))


class OrderedTargets:
    """Points of the curves at fixed places.

    "points" (B, queries, 2) at the queries' shares, "curve" (B, S, 2) at equal shares, "course" (B, steps, 2) in equal
    steps from the end on, "length" (B,) in steps, "starts" (n, queries, 2) and "begins" (n,) of the first n images.
    """

    def __init__(self, network: OrderedSplineFormer) -> None:
        self.network = network
        self.shares = network.shares.double().cpu().numpy()
        self.steps, self.step = network.settings.steps, network.step
        parameters = torch.linspace(0, 1, _CURVE_SAMPLES, dtype=torch.float64)
        self.curve_shares = parameters.numpy()
        self.bases = collocation(network.knots.double().cpu(), parameters).float()
        self.sights = [step.sight for step in network.refinements()]

    def __call__(self, curves: Sequence[Curve], generator: np.random.Generator | None) -> dict[str, Tensor]:
        def at(shares: Curve) -> Tensor:
            return torch.from_numpy(np.stack([at_shares(curve, shares) for curve in curves]).astype(np.float32))

        points = at(self.shares)
        courses = [course_of(curve, self.steps, self.step) for curve in curves]
        lengths = torch.tensor([arc_length(curve)[-1] / self.step for curve in curves], dtype=torch.float32)
        targets = {
            "points": points,
            "curve": at(self.curve_shares),
            "course": torch.from_numpy(np.stack(courses).astype(np.float32)),
            "length": lengths.clamp(1.0, self.steps - 1.0),
        }
        if generator is None:
            return targets | {"starts": points, "begins": torch.zeros(len(curves), dtype=torch.bool)}
        near = -(-len(curves) * _NEAR_PCT // 100)
        begins = torch.from_numpy(generator.uniform(size=near) < _BEGINS)
        return targets | {"starts": perturbed(points[:near], generator), "begins": begins}

    def loss(self, module: nn.Module, batch: Mapping[str, Tensor]) -> Tensor:
        prediction = module(batch["images"], batch["starts"], batch["begins"])
        bases = self.bases.to(batch["images"].device)
        return ordered_loss(prediction, batch, bases, self.network.shares, self.sights)

    def start(self, targets: Mapping[str, Tensor]) -> None:
        self.network.start_at(targets["course"].mean(0), float(targets["length"].mean()))


TARGETS: dict[str, Any] = {"published": PublishedTargets, "ordered": OrderedTargets}


def course_of(curve: Curve, steps: int, step: float) -> Curve:
    """(steps, 2) points of an (n, 2) curve from its end on, a step apart; beyond the tip it goes straight on."""
    length = arc_length(curve)[-1]
    at = length - step * np.arange(steps)
    ahead = curve[0] - at_length(curve, min(step, length))
    ahead /= max(float(np.linalg.norm(ahead)), 1e-12)
    return at_length(curve, np.maximum(at, 0.0)) + np.maximum(-at, 0.0)[:, None] * ahead
