"""Simulated forces against real ones: each test finds its own difference, the verdict follows the figures, heat."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from cathsim.metrics.forces import HEAT_WIDTH, ForceComparison, compare_forces, verdict, wall_heat

REAL = {"real_mean_n": 0.40, "real_sd_n": 0.19}
PUSHED = np.array([0.02, 0.04])


@pytest.fixture
def drawn() -> np.ndarray:
    return np.random.default_rng(3).normal(0.40, 0.19, 400)


def comparison_of(forces: np.ndarray) -> ForceComparison:
    return compare_forces(forces, **REAL, generator=np.random.default_rng(0))


def words(forces: np.ndarray) -> tuple[str, str]:
    return verdict(comparison_of(forces), PUSHED, operators={"sampling_expert"}, free_force_n=0.15)


def test_forces_of_the_real_distribution_agree_with_it(drawn: np.ndarray) -> None:
    result = comparison_of(drawn)
    assert min(result.mann_whitney_p, result.levene_p, result.shapiro_p) > 0.05
    assert result.exceedance == pytest.approx(0.5, abs=0.05)
    assert result.u_statistic == pytest.approx(0.5 * 400**2, rel=0.1)
    agrees, differs = words(drawn)
    assert differs == "Nothing."
    assert "no difference in location" in agrees
    assert "may be normal" in agrees


def test_each_test_finds_its_own_difference(drawn: np.ndarray) -> None:
    shifted, narrow = comparison_of(drawn + 0.1), comparison_of(0.40 + 0.5 * (drawn - drawn.mean()))
    skew = comparison_of(np.random.default_rng(1).exponential(0.4, 400))
    assert shifted.mann_whitney_p < 1e-6 < shifted.levene_p
    assert narrow.levene_p < 1e-6 < narrow.mann_whitney_p
    assert skew.shapiro_p < 1e-6 < shifted.shapiro_p
    assert shifted == comparison_of(drawn + 0.1)  # the draws are seeded


def test_verdict_names_size_and_side_of_the_difference_and_what_was_not_tested() -> None:
    small = np.abs(np.random.default_rng(2).normal(0.0, 0.05, 300))
    small[:90] = 0.0
    result = comparison_of(small)
    assert result.contact_share == pytest.approx(0.7)
    agrees, differs = words(small)
    assert f"{result.mean_n:.3f} N, lies below the real 0.40 N by a factor of {0.40 / result.mean_n:.1f}" in differs
    assert "30 % of the steps have no contact force" in differs
    assert "sampling expert, which pays for forces above 0.15 N" in differs
    assert f"0.030 ± 0.010 N, {0.03 / result.mean_n:.1f} times as much: so much the steering can explain" in differs
    assert "was not tested" in differs
    assert "100 % of the simulated forces lie below 2 N" in agrees
    assert "never presses on the wall" in words(np.zeros(50))[1]


def test_large_samples_and_bad_ones() -> None:
    result = comparison_of(np.random.default_rng(4).normal(0.4, 0.19, 12_000))
    assert result.shapiro_p > 1e-3  # thinned to what scipy vouches for, and no warning
    with pytest.raises(ValueError, match=r"at least 8 finite forces to compare, got shape \(3,\)"):
        comparison_of(np.ones(3))
    with pytest.raises(ValueError, match="finite"):
        comparison_of(np.full(20, np.nan))


def test_heat_lies_where_the_contacts_are() -> None:
    wall = trimesh.creation.icosphere(subdivisions=4, radius=0.02)
    vertices = np.asarray(wall.vertices)
    points = np.array([[0.0, 0.0, 0.02], [0.0, 0.0, 0.02], [0.02, 0.0, 0.0]])
    largest, total = wall_heat(vertices, points, np.array([0.3, 0.1, 0.2]))
    top, side, back = (
        np.linalg.norm(vertices - place, axis=1).argmin() for place in (points[0], points[2], [0, 0.02, 0])
    )
    assert largest[[top, side, back]] == pytest.approx([0.3, 0.2, 0.0], rel=0.05)
    assert total[[top, side, back]] == pytest.approx([0.4, 0.2, 0.0], rel=0.05)
    away = np.linalg.norm(vertices - points[0], axis=1)
    beyond = (away > 3 * HEAT_WIDTH) & (np.linalg.norm(vertices - points[2], axis=1) > 3 * HEAT_WIDTH)
    assert largest[beyond].max() == 0.0
    assert np.array_equal(wall_heat(vertices, np.zeros((0, 3)), np.zeros(0))[0], np.zeros(len(vertices)))
