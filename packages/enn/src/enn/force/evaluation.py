"""Evaluation of force prediction: errors beside those of the mean and of an untrained network, and calibration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from enn.force.prediction import ForceNetwork, ForcePredictor
from enn.force.samples import ForceSamples
from enn.networks.devices import device_of, seeded


def evaluate_predictor(
    predictor: ForcePredictor, training: ForceSamples, test: ForceSamples, *, seed: int = 0
) -> dict[str, Any]:
    """Tests a predictor on samples that it was not fitted to.

    Args:
        training: samples that it was fitted to; their mean force is what it is compared with.

    Returns:
        ``test_samples``; ``mse_n2``, ``variance_n2``, ``mean_mse_n2`` and ``untrained_mse_n2`` in N²; ``share_pct`` of
        the variance, None where all forces are the same; ``correlation``; ``force_mean_n``, ``force_p95_n`` and
        ``force_max_n`` in N; ``calibration`` as of `calibration`, in lists.
    """
    forces = test.forces.astype(np.float64)
    predicted = predictor.predict(test.images, test.vectors)
    result = score(predicted, test.forces)
    mean = np.full(len(test), float(training.forces.astype(np.float64).mean()))
    with seeded(seed):
        fresh = ForceNetwork(predictor.network.settings)  # its scales are those of no data: newtons
    untrained = ForcePredictor(fresh.to(device_of(predictor.network))).predict(test.images, test.vectors)
    return {
        "test_samples": result.samples,
        "mse_n2": result.mse_n2,
        "variance_n2": result.variance_n2,
        # forces that are all the same have none, e.g. where no episode touches the wall
        "share_pct": 100.0 * result.share_of_variance if result.variance_n2 > 0 else None,
        "correlation": result.correlation,
        "mean_mse_n2": score(mean, test.forces).mse_n2,
        "untrained_mse_n2": score(untrained, test.forces).mse_n2,
        "force_mean_n": float(forces.mean()),
        "force_p95_n": float(np.percentile(forces, 95)),
        "force_max_n": float(forces.max()),
        "calibration": {name: values.tolist() for name, values in calibration(predicted, forces).items()},
    }


@dataclass(frozen=True)
class ForceScore:
    """How well forces are predicted."""

    mse_n2: float  # mean squared error, N²
    variance_n2: float  # of the true forces, N²: the error of always predicting their own mean
    correlation: float  # of predicted and true forces; 0 where one of them is constant
    samples: int

    @property
    def share_of_variance(self) -> float:
        """Mean squared error as a share of the variance; NaN where all forces are the same."""
        return self.mse_n2 / self.variance_n2 if self.variance_n2 > 0 else float("nan")


def score(predicted: NDArray[Any], true: NDArray[Any]) -> ForceScore:
    """Compares predicted with true forces.

    Args:
        predicted: (N,) N.
        true: (N,) N.

    Raises:
        ValueError: another shape, or no sample.
    """
    a, b = np.asarray(predicted, np.float64), np.asarray(true, np.float64)
    if a.shape != b.shape or a.ndim != 1 or len(a) == 0:
        raise ValueError(f"expected as many predicted as true forces, one at least, got {a.shape} and {b.shape}")
    spread = float(a.std() * b.std())
    correlation = float(((a - a.mean()) * (b - b.mean())).mean() / spread) if spread > 0 else 0.0
    return ForceScore(float(np.square(a - b).mean()), float(b.var()), correlation, len(a))


def calibration(predicted: NDArray[Any], true: NDArray[Any], bins: int = 10) -> dict[str, NDArray[np.float64]]:
    """Predicted against true forces in bins of equally many samples, by predicted force.

    Args:
        predicted: (N,) N.
        true: (N,) N.
        bins: how many, at most one a sample.

    Returns:
        `predicted` and `true`, means in N, and `true_sd`, N, an entry a bin.
    """
    order = np.argsort(predicted, kind="stable")
    parts: Sequence[NDArray[np.int64]] = np.array_split(order, min(bins, len(order)))
    return {
        "predicted": np.array([float(np.mean(predicted[part])) for part in parts]),
        "true": np.array([float(np.mean(true[part])) for part in parts]),
        "true_sd": np.array([float(np.std(true[part])) for part in parts]),
    }
