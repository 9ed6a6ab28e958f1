"""Simulated annotation: exact polylines, clicks with noise, and the part of a curve in view."""

from __future__ import annotations

import numpy as np
import pytest

from guide3d.dataset.simulated_annotation import annotate, click, fit_annotation, thin_by_turning, visible_part
from guide3d.geometry.polyline import arc_length, distances_to

SIZE = 256


def hook(count: int = 2000) -> np.ndarray:
    """(count, 2) px: a straight stretch and a tight bend of 12 px radius."""
    bend = np.pi * np.linspace(0.0, 1.0, count // 2)
    return np.concatenate(
        [
            np.column_stack([50 + 12 * np.sin(bend[::-1]), 40 - 12 * np.cos(bend[::-1])]),
            np.column_stack([np.linspace(50, -30, count // 2), np.full(count // 2, 28.0)]),
        ]
    )


def test_exact_annotations_stay_within_a_tenth_of_a_pixel() -> None:
    wire = hook()
    points = annotate(wire, 0.0, SIZE, np.random.default_rng(0))
    assert distances_to(points, wire).max() < 0.1
    assert np.array_equal(points[[0, -1]], wire[[0, -1]])
    assert len(points) < 60


def test_clicks_are_apart_noisy_and_reach_both_ends() -> None:
    wire = np.column_stack([np.linspace(10.0, 240.0, 4000), np.full(4000, 100.0)])
    drawn = [annotate(wire, 1.0, SIZE, np.random.default_rng(seed)) for seed in range(200)]
    assert np.array_equal(drawn[3], annotate(wire, 1.0, SIZE, np.random.default_rng(3)))
    assert all(8 <= len(points) <= 17 for points in drawn)
    off = np.concatenate([points[:, 1] - 100.0 for points in drawn])
    assert off.std() == pytest.approx(1.0, abs=0.06)
    ends = np.array([points[[0, -1], 0] for points in drawn])
    assert np.abs(ends.mean(axis=0) - [10.0, 240.0]).max() < 0.25
    bent = hook() + np.array([40.0, 0.0])
    assert distances_to(annotate(bent, 1e-9, SIZE, np.random.default_rng(0)), bent).max() < 1.5  # closer in a bend


def test_a_curve_is_cut_where_it_leaves_the_image() -> None:
    wire = hook()
    part = visible_part(wire, arc_length(wire), SIZE)
    assert part is not None
    assert part.points[-1] == pytest.approx([0.0, 28.0])
    assert part.length == pytest.approx(12 * np.pi + 50, abs=1e-3)
    assert visible_part(wire[::-1], arc_length(wire), SIZE) is None
    whole = visible_part(wire + np.array([40.0, 0.0]), arc_length(wire), SIZE)
    assert whole is not None
    assert len(whole.points) == len(wire)


def test_thinning_holds_its_bound_in_space() -> None:
    t = np.linspace(0.0, 4 * np.pi, 5000)
    helix = np.column_stack([20 * np.cos(t), 20 * np.sin(t), 5 * t])
    kept = thin_by_turning(helix, 5.0, 0.05)
    assert distances_to(kept, helix).max() < 5.0 * 0.05 / 32 + 1e-3
    assert len(kept) < 500


def test_clicks_on_an_annotation_are_as_near_as_their_noise() -> None:
    exact = annotate(hook() + np.array([40.0, 0.0]), 0.0, SIZE, np.random.default_rng(0))
    clicked = click(exact, 1.0, SIZE, np.random.default_rng(1))
    assert 0.2 < distances_to(exact, clicked).mean() < 1.5
    assert distances_to(fit_annotation(clicked, 1.0).sample(300), clicked).max() < 4.0
    assert distances_to(fit_annotation(exact, 0.0).sample(300), exact).max() < 0.3
