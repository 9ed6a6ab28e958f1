"""Wires and devices drawn as X-rays show them."""

import numpy as np
import pytest
from scipy import ndimage

from cathsim.fluoroscopy import DeviceRenderer, FluoroscopyRenderer, Projector, catheter_material
from cathsim.fluoroscopy.attenuation import GAMMA
from cathsim.fluoroscopy.curve import smooth_curve, split
from cathsim.fluoroscopy.device_renderer import EMPHASIS
from cathsim.fluoroscopy.renderer import WIRE_ATTENUATION

BOUNDS = np.array([[-0.06, -0.04, -0.11], [0.06, 0.04, 0.11]])
WIRE = np.linspace([0, 0, -0.05], [0, 0, 0.05], 20)


def make(size=80, level=180.0, view="frontal", **options):
    projector = Projector.view(view, BOUNDS, size)
    return FluoroscopyRenderer(projector, np.full((projector.height, projector.width), level), **options)


def test_wire_attenuates_as_a_cylinder_when_the_image_resolves_it():
    renderer = make(1024, level=200.0, wire_radius=1e-3)
    width = renderer.wire_width_px
    assert width == pytest.approx(2e-3 * renderer.projector.pixels_per_metre([0, 0, 0]))
    image = renderer.render(WIRE)
    row = image[512].astype(float)
    centre = (renderer.projector.width - 1) / 2
    for column in range(512, 512 + int(width / 2)):
        edges = np.clip((column - centre + np.linspace(-0.5, 0.5, 201)) / (width / 2), -1, 1)
        chord = 2e-3 * np.sqrt(1 - edges**2).mean()
        assert row[column] == pytest.approx(200 * np.exp(-GAMMA * WIRE_ATTENUATION * chord), abs=1.5)
    assert row[512 + int(width / 2) + 2] == 200


@pytest.mark.parametrize("links", [[0.016] * 9, [0.004] * 6 + [0.016] * 8, [0.003, 0.017] * 7])
def test_long_links_are_drawn_as_a_smooth_curve(links):
    renderer = make(512)
    radius = 0.03
    angle = np.concatenate([[0], np.cumsum(links)]) / radius
    coarse = radius * np.column_stack([np.cos(angle), 0 * angle, np.sin(angle)])
    fine_angle = np.linspace(0, angle[-1], 600)
    fine = radius * np.column_stack([np.cos(fine_angle), 0 * fine_angle, np.sin(fine_angle)])
    drawn, truth = renderer.mask(coarse), renderer.mask(fine)
    away = ndimage.distance_transform_edt(truth == 0)
    assert away[drawn == 1].max() < 1.5  # a polyline would miss the arc by 2.6 px
    assert ndimage.distance_transform_edt(drawn == 0)[truth == 1].max() < 1.5


def test_bad_input_is_refused():
    renderer = make(80)
    for call, message in (
        (lambda: renderer.render(np.vstack([WIRE, [[np.nan, 0, 0]]])), "not finite"),
        (lambda: renderer.mask(np.vstack([WIRE, [[0, -2.0, 0]]])), "behind the X-ray source"),
        (lambda: renderer.render(np.zeros((4, 2))), r"shape \(n, 3\)"),
        (lambda: renderer.render_into(WIRE, np.zeros((80, 80)), None), r"uint8 array of shape \(80, 80\)"),
        (lambda: renderer.render_into(WIRE, None, np.zeros((80, 80), np.uint8).T[::2]), "C-ordered"),
        (lambda: FluoroscopyRenderer(renderer.projector, np.zeros((80, 81))), "camera's shape"),
        (lambda: FluoroscopyRenderer(renderer.projector, np.full((80, 80), 300.0)), "between 0 and 255"),
        (lambda: make(80, wire_radius=0.0), "must be positive"),
    ):
        with pytest.raises(ValueError, match=message):
            call()


RADIUS, INNER = 0.835e-3, 0.6e-3
WALL, WATER = 149.4, 20.6  # 1/m, of the wall over water
SIZE = 400
PROJECTOR = Projector.frontal(np.array([[-0.015, -0.005, -0.015], [0.015, 0.005, 0.015]]), SIZE)


def test_a_tube_attenuates_by_its_wall_and_its_edges_are_darkest() -> None:
    tube = catheter_material(RADIUS, INNER, wall=WALL + WATER, marker=1430.0, marker_length=4e-3)
    renderer = DeviceRenderer(PROJECTOR, np.full((SIZE, SIZE), 200.0, np.float32), wire_radius=4e-4, catheter=tube)
    image, wire_mask, mask = (np.empty((SIZE, SIZE), np.uint8) for _ in range(3))
    upright = np.stack((np.zeros(8), np.zeros(8), np.linspace(0.012, -0.015, 8)), axis=1)
    renderer.render_into(np.empty((0, 3)), upright, image, wire_mask, mask)
    row, middle = SIZE // 2, round(float(PROJECTOR.project(np.zeros((1, 3)))[0, 0]))
    expected = 200.0 * np.exp(-GAMMA * EMPHASIS * WALL * 2 * (RADIUS - INNER))
    assert image[row, middle] == pytest.approx(expected, abs=2.0)
    # tangential to the lumen the way through the wall is longest
    thickest = 200.0 * np.exp(-GAMMA * EMPHASIS * WALL * 2 * np.sqrt(RADIUS**2 - INNER**2))
    assert image[row].min() == pytest.approx(thickest, abs=8.0)
    assert abs(abs(int(image[row].argmin()) - middle) - INNER * PROJECTOR.pixels_per_metre(np.zeros(3))) < 2
    assert mask[row].sum() == pytest.approx(2 * RADIUS * PROJECTOR.pixels_per_metre(np.zeros(3)), abs=1.5)


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


def test_line_repeated_nodes_and_few_nodes():
    line = np.array([[0.0, 0, 0], [0, 0, 0], [0, 0, 1.0], [0, 0, 1.0]])
    points, arc = smooth_curve(line, 0.25)
    np.testing.assert_allclose(points[:, 2], np.linspace(0, 1, 5))
    np.testing.assert_allclose(arc, points[:, 2])
    for count in (0, 1):
        points, arc = smooth_curve(np.zeros((count, 3)), 0.1)
        assert points.shape == (count, 3)
        assert arc.shape == (count,)


def test_a_cut_has_the_node_at_its_distance_in_both_parts():
    nodes = np.array([[0.0, 0, 0], [1, 0, 0], [1, 2, 0], [1, 2, 3]])
    before, behind = split(nodes, 1.5)
    assert before == pytest.approx(np.array([[0.0, 0, 0], [1, 0, 0], [1, 0.5, 0]]))
    assert behind == pytest.approx(np.array([[1, 0.5, 0], [1, 2, 0], [1, 2, 3.0]]))
    before, behind = split(nodes, 3.0)
    assert (len(before), len(behind)) == (3, 2), "a cut at a node repeats none"
    assert len(split(nodes, 7.0)[1]) == len(split(nodes[:1], 1.0)[1]) == 0
