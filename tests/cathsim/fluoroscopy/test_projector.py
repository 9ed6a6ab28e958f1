"""Camera geometry: directions on the image, magnification, fit, round trips."""

import numpy as np
import pytest

from cathsim.fluoroscopy import VIEWS, Projector

BOUNDS = np.array([[-0.06, -0.04, -0.11], [0.05, 0.05, 0.12]])
CENTRE = BOUNDS.mean(axis=0)


def beside(x, y, z):
    return CENTRE + np.array([x, y, z])


def corners(bounds):
    return np.array([[bounds[i, 0], bounds[j, 1], bounds[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])


def test_frontal_view_is_radiological():
    camera = Projector.frontal(BOUNDS, 80)
    centre, left, up = camera.project([CENTRE, beside(0.02, 0, 0), beside(0, 0, 0.02)])
    assert centre == pytest.approx([39.5, 39.5])
    assert left[0] > centre[0]
    assert left[1] == pytest.approx(centre[1])
    assert up[1] < centre[1]
    assert up[0] == pytest.approx(centre[0])
    assert camera.source[1] < BOUNDS[0, 1]


def test_magnification_follows_the_distances():
    camera = Projector.c_arm(
        centre=CENTRE, field_of_view=0.2, size=(200, 100), source_detector_distance=1.0, source_object_distance=0.8
    )
    assert (camera.width, camera.height) == (200, 100)
    here, there = camera.project([CENTRE, beside(0.01, 0, 0)])
    assert there[0] - here[0] == pytest.approx(5.0)  # 100 px over 0.2 m
    assert camera.pixels_per_metre(CENTRE) == pytest.approx(500.0)
    assert camera.pixels_per_metre(beside(0, 0.08, 0)) == pytest.approx(500.0 * 0.8 / 0.88)
    assert np.linalg.norm(camera.source - CENTRE) == pytest.approx(0.8)


@pytest.mark.parametrize(("primary", "secondary", "axis", "sign"), [(90, 0, 0, 1), (-90, 0, 0, -1), (0, 80, 2, 1)])
def test_angles_turn_the_arm_as_named(primary, secondary, axis, sign):
    camera = Projector.c_arm(centre=CENTRE, field_of_view=0.2, size=64, primary_deg=primary, secondary_deg=secondary)
    direction = (camera.source - CENTRE) / 0.75
    assert sign * direction[axis] > 0.98
    assert np.linalg.det(camera.R) == pytest.approx(1.0)
    up = camera.project([beside(0, 0, 0.01)])[0]
    assert up[1] < 31.5


@pytest.mark.parametrize("name", VIEWS)
@pytest.mark.parametrize("size", [80, 128, (320, 200)])
def test_the_whole_box_is_in_view_and_fills_it(name, size):
    camera = Projector.view(name, BOUNDS, size)
    pixels = camera.project(corners(BOUNDS))
    extent = np.array([camera.width, camera.height])
    assert (pixels > -0.5).all()
    assert (pixels < extent - 0.5).all()
    assert (np.abs(pixels - (extent - 1) / 2).max(axis=0) / extent).max() > 0.45
    assert camera.name == name


def test_matrix_and_method_agree():
    camera = Projector.view("lao_45", BOUNDS, 128)
    points = np.random.default_rng(0).uniform(*BOUNDS, size=(50, 3))
    homogeneous = np.column_stack([points, np.ones(50)]) @ camera.P.T
    assert camera.P.shape == (3, 4)
    np.testing.assert_allclose(camera.project(points), homogeneous[:, :2] / homogeneous[:, 2:], atol=1e-9)


def test_rays_go_back_to_the_point():
    camera = Projector.view("caudal_30", BOUNDS, 512)
    point = beside(0.02, -0.03, 0.05)
    ray = camera.rays @ np.append(camera.project([point])[0], 1.0)
    offset = point - camera.source
    np.testing.assert_allclose(np.cross(ray, offset), 0, atol=1e-9)
    assert ray @ offset > 0


def test_two_views_triangulate():
    cameras = [Projector.view(name, BOUNDS, 1024) for name in ("frontal", "lateral")]
    point = beside(0.01, 0.02, -0.04)
    rows = []
    for camera in cameras:
        u, v = camera.project([point])[0]
        rows += [u * camera.P[2] - camera.P[0], v * camera.P[2] - camera.P[1]]
    solution = np.linalg.svd(np.array(rows))[2][-1]
    np.testing.assert_allclose(solution[:3] / solution[3], point, atol=1e-9)


def test_resized_view_keeps_its_field():
    small = Projector.frontal(BOUNDS, 80)
    large = small.resized(320)
    points = corners(BOUNDS)
    np.testing.assert_allclose((small.project(points) + 0.5) * 4, large.project(points) + 0.5, atol=1e-9)
    assert large.key == Projector.frontal(BOUNDS, 320).resized(320).key
    assert large.key != small.key


def test_bad_geometry_is_refused():
    with pytest.raises(ValueError, match="unknown view 'oblique': expected one of frontal, lateral"):
        Projector.view("oblique", BOUNDS, 80)
    with pytest.raises(ValueError, match="lowest and the highest corner"):
        Projector.frontal(BOUNDS[::-1], 80)
    with pytest.raises(ValueError, match="between source and detector"):
        Projector.c_arm(centre=CENTRE, field_of_view=0.2, size=80, source_object_distance=2.0)
    with pytest.raises(ValueError, match="field of view"):
        Projector.c_arm(centre=CENTRE, field_of_view=0.0, size=80)
    with pytest.raises(ValueError, match="secondary angle"):
        Projector.c_arm(centre=CENTRE, field_of_view=0.2, size=80, secondary_deg=90)
    with pytest.raises(ValueError, match="width must lie in 1 to 32768 px, got 0"):
        Projector.frontal(BOUNDS, 0)
    with pytest.raises(ValueError, match="must be a rotation"):
        Projector(np.eye(3), np.diag([1.0, 1.0, -1.0]), np.zeros(3), 8, 8)
    camera = Projector.frontal(BOUNDS, 80)
    with pytest.raises(ValueError, match=r"shape \(n, 3\)"):
        camera.project(np.zeros(3))
    with pytest.raises(ValueError, match="in front of the X-ray source"):
        camera.project([camera.source - np.array([0, 0.1, 0])])
