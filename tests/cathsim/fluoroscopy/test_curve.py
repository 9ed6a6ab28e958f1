"""The smooth curve through nodes against circles, lines and odd input."""

import numpy as np
import pytest

from cathsim.fluoroscopy.curve import smooth_curve, split


@pytest.mark.parametrize("links", [[0.004] * 15, [0.004] * 6 + [0.016] * 3, [0.003, 0.012] * 5])
def test_curve_follows_a_circle(links):
    radius = 0.03
    angle = np.concatenate(([0.0], np.cumsum(links))) / radius
    nodes = radius * np.column_stack((np.cos(angle), np.sin(angle), np.zeros_like(angle)))
    points, arc = smooth_curve(nodes, 2e-4)
    # of a link of length h the parabolic slopes at its ends leave an error of the order of h^4 / r^3
    assert np.abs(np.hypot(points[:, 0], points[:, 1]) - radius).max() < 0.01 * max(links) ** 2 / radius
    assert arc[-1] == pytest.approx(radius * angle[-1], rel=5e-3)
    assert np.linalg.norm(np.diff(points, axis=0), axis=1).max() < 2.4e-4


def test_curve_passes_through_its_nodes():
    nodes = np.random.default_rng(0).normal(size=(9, 3)).cumsum(axis=0)
    points, arc = smooth_curve(nodes, 0.1)
    for node in nodes:
        assert np.linalg.norm(points - node, axis=1).min() < 1e-12
    assert arc[0] == 0
    assert (np.diff(arc) > 0).all()


def test_line_repeated_nodes_and_few_nodes():
    line = np.array([[0.0, 0, 0], [0, 0, 0], [0, 0, 1.0], [0, 0, 1.0]])
    points, arc = smooth_curve(line, 0.25)
    np.testing.assert_allclose(points[:, 2], np.linspace(0, 1, 5))
    np.testing.assert_allclose(arc, points[:, 2])
    for count in (0, 1):
        points, arc = smooth_curve(np.zeros((count, 3)), 0.1)
        assert points.shape == (count, 3)
        assert arc.shape == (count,)


def test_bad_input_is_refused():
    with pytest.raises(ValueError, match=r"shape \(n, 3\)"):
        smooth_curve(np.zeros((3, 2)), 0.1)
    with pytest.raises(ValueError, match="not finite"):
        smooth_curve([[0.0, 0, 0], [np.inf, 0, 0]], 0.1)
    with pytest.raises(ValueError, match="spacing"):
        smooth_curve(np.zeros((3, 3)), 0.0)


def test_a_cut_has_the_node_at_its_distance_in_both_parts():
    nodes = np.array([[0.0, 0, 0], [1, 0, 0], [1, 2, 0], [1, 2, 3]])
    before, behind = split(nodes, 1.5)
    assert before == pytest.approx(np.array([[0.0, 0, 0], [1, 0, 0], [1, 0.5, 0]]))
    assert behind == pytest.approx(np.array([[1, 0.5, 0], [1, 2, 0], [1, 2, 3.0]]))
    before, behind = split(nodes, 3.0)
    assert (len(before), len(behind)) == (3, 2), "a cut at a node repeats none"
    assert len(split(nodes, 7.0)[1]) == len(split(nodes[:1], 1.0)[1]) == 0
