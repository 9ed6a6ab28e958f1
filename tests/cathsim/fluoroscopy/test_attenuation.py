"""Path lengths through solids of known shape, and grey levels by Beer and Lambert's law."""

from types import SimpleNamespace

import numpy as np
import pytest

from cathsim.fluoroscopy import Ellipsoid, Projector, background_image, expose, lumen_path_length
from cathsim.fluoroscopy.body import body_depth
from cathsim.lattice.node_blocks import NodeBlocks

RADIUS = 0.012
CENTRE = np.array([0.004, -0.003, 0.002])


def ball(spacing=1e-3, clamp=-0.01):
    """Distance grid of a ball, clamped far outside as those of phantoms are."""
    half = 0.03
    axis = np.arange(-half, half + spacing / 2, spacing)
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    distance = RADIUS - np.sqrt((x - CENTRE[0]) ** 2 + (y - CENTRE[1]) ** 2 + (z - CENTRE[2]) ** 2)
    values = np.maximum(distance, clamp).astype(np.float32)
    return SimpleNamespace(blocks=NodeBlocks.from_dense(values), origin=np.full(3, -half), spacing=spacing)


def camera(size=64, **angles):
    return Projector.c_arm(centre=(0, 0, 0), field_of_view=0.06, size=size, **angles)


def chords(projector, radius):
    u, v = np.meshgrid(np.arange(projector.width), np.arange(projector.height))
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ projector.rays.T
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    offset = CENTRE - projector.source
    miss2 = offset @ offset - (rays @ offset) ** 2
    return 2 * np.sqrt(np.maximum(radius**2 - miss2, 0))


@pytest.mark.parametrize("angles", [{}, {"primary_deg": 90}, {"primary_deg": 37, "secondary_deg": -21}])
def test_path_through_a_ball_is_its_chord(angles):
    projector = camera(**angles)
    lengths = lumen_path_length(ball(), projector, samples=1)
    expected = chords(projector, RADIUS)
    assert lengths.shape == (64, 64)
    inside = expected > 0.006
    np.testing.assert_allclose(lengths[inside], expected[inside], atol=1.5e-4)
    assert lengths[expected == 0].max() < 2e-3  # grazing rays only
    assert lengths.sum() == pytest.approx(expected.sum(), rel=0.01)


def test_level_adds_a_wall():
    projector = camera()
    lengths = lumen_path_length(ball(), projector, level=-2e-3, samples=1)
    assert lengths.max() == pytest.approx(2 * (RADIUS + 2e-3), abs=1.5e-4)


def test_more_rays_smooth_the_edge_and_keep_the_volume():
    coarse, fine = (lumen_path_length(ball(), camera(16), samples=n) for n in (1, 8))
    pixel = 0.06 / 16
    volume = 4 / 3 * np.pi * RADIUS**3
    assert fine.sum() * pixel**2 == pytest.approx(volume, rel=0.02)
    assert (fine > 0).sum() > (coarse > 0).sum()


def test_rays_that_miss_the_grid_meet_nothing():
    away = Projector.c_arm(centre=(0.3, 0, 0), field_of_view=0.06, size=16)
    assert not lumen_path_length(ball(), away).any()


def test_grid_with_nan_is_refused():
    grid = ball()
    values = grid.blocks.dense()
    values[3, 3, 3] = np.nan
    grid.blocks = NodeBlocks.from_dense(values, -0.01)
    with pytest.raises(ValueError, match="finite"):
        lumen_path_length(grid, camera())


def test_body_depth_of_a_ball_is_its_chord():
    projector = camera(32, primary_deg=20)
    solid = Ellipsoid(tuple(CENTRE), (RADIUS,) * 3, 50.0)
    np.testing.assert_allclose(
        body_depth(projector, (solid,), np.zeros(3)), 50.0 * chords(projector, RADIUS), atol=1e-5
    )


def test_flat_ellipsoid_is_as_deep_as_thick():
    projector = camera(33)
    solid = Ellipsoid((0, 0, 0), (0.02, 0.005, 0.03), 100.0)
    depth = body_depth(projector, (solid,), np.zeros(3))
    assert depth[16, 16] == pytest.approx(100.0 * 0.01, rel=1e-5)
    with pytest.raises(ValueError, match=r"semi_axes\[0\] must lie in"):
        Ellipsoid((0, 0, 0), (0.0, 1.0, 1.0), 1.0)


def test_exposure_multiplies_what_depths_add():
    depth = np.full((20, 20), 3.0, dtype=np.float32)
    depth[5:8, 5:8] += 0.8
    image = expose(depth, middle=200.0, gamma=0.5)
    assert image[0, 0] == pytest.approx(200.0, rel=1e-5)
    assert image[6, 6] == pytest.approx(200.0 * np.exp(-0.4), rel=1e-5)
    np.testing.assert_allclose(expose(depth + 2, middle=200.0, gamma=0.5), image, rtol=1e-5)  # automatic brightness


def test_vessel_is_darker_than_the_tissue_beside_it():
    image = background_image(ball(), camera(48))
    u, v = np.rint(camera(48).project([CENTRE])[0]).astype(int)
    assert image.dtype == np.float32
    assert image.min() >= 0
    assert image.max() <= 255
    assert image[v, u] < 0.92 * image[v, 2]
    plain = background_image(ball(), camera(48), contrast=0.0)
    assert image[v, u] < plain[v, u]


def test_background_is_deterministic_and_computed_once_by_key():
    grid, projector = ball(), camera(40)
    first = background_image(grid, projector, key="ball")
    assert background_image(grid, camera(40), key="ball") is first
    assert background_image(grid, camera(41), key="ball") is not first
    assert background_image(grid, projector, key="ball", contrast=5.0) is not first
    np.testing.assert_array_equal(background_image(grid, projector), first)
    with pytest.raises(ValueError, match="read-only"):
        first[0, 0] = 0
