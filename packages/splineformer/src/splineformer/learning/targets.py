"""Targets of each variant: what a batch's curves become for it, its loss, and where its training starts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from guide3d.geometry.polyline import arc_length, at_length
from splineformer.decoding import collocation, padded
from splineformer.learning.augmentation import at_shares, perturbed
from splineformer.learning.losses import OrderedWeights, PublishedWeights, ordered_loss, published_loss
from splineformer.modeling.ordered import OrderedSplineFormer
from splineformer.modeling.published import SplineFormer
from splineformer.tokens import TokenSettings, tokens_of_polyline

_CURVE_SAMPLES = 128  # of the ordered variant's curve loss
_NEAR_PCT = 40  # of a batch's images teach what looks from near by: it learns sooner than the overview, and costs more
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
    """Tokens of smoothing splines, in network units: "tokens" (B, limit, 3) and "lengths" (B,)."""

    def __init__(self, network: SplineFormer, weights: Any, source_px: int) -> None:
        self.network, self.source_px = network, source_px
        self.weights = weights if isinstance(weights, PublishedWeights) else PublishedWeights()
        self.tokens = TokenSettings(limit=network.limit)

    def __call__(self, curves: Sequence[Curve], generator: np.random.Generator | None) -> dict[str, Tensor]:
        sequences = []
        for curve in curves:
            fitted = tokens_of_polyline(curve * self.source_px, self.tokens)
            units = np.array([fitted[-1, 0], self.source_px, self.source_px])
            sequences.append(torch.from_numpy((fitted / units).astype(np.float32)))
        tokens, lengths = padded(sequences, self.tokens.limit)
        return {"tokens": tokens, "lengths": lengths}

    def loss(self, module: nn.Module, batch: Mapping[str, Tensor]) -> Tensor:
        return published_loss(module(batch["images"], batch["tokens"][:, :-1]), batch, self.weights)

    def start(self, targets: Mapping[str, Tensor]) -> None:
        self.network.tip.start_at(targets["tokens"][:, 0].mean(0))


class OrderedTargets:
    """Points of the curves at fixed places.

    "points" (B, queries, 2) at the queries' shares, "curve" (B, S, 2) at equal shares, "course" (B, steps, 2) in equal
    steps from the end on, "length" (B,) in steps, "starts" (n, queries, 2) and "begins" (n,) of the first n images.
    """

    def __init__(self, network: OrderedSplineFormer, weights: Any, source_px: int) -> None:
        self.network = network
        self.weights = weights if isinstance(weights, OrderedWeights) else OrderedWeights()
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
        return ordered_loss(prediction, batch, self.weights, bases, self.network.shares, self.sights)

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
