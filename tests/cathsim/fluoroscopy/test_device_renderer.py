"""A wire and a catheter in the simple frontal image: attenuation of a tube, of both, the marker, masks."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from cathsim.fluoroscopy import DeviceRenderer, FluoroscopyRenderer, Projector, catheter_material
from cathsim.fluoroscopy.attenuation import GAMMA
from cathsim.fluoroscopy.device_renderer import EMPHASIS

RADIUS, INNER, WIRE_RADIUS = 0.835e-3, 0.6e-3, 0.445e-3
WALL, MARKER, MARKER_LENGTH = 149.4, 1409.4, 4e-3
TUBE = catheter_material(
    RADIUS, INNER, wall=WALL + 20.6, marker=MARKER + 20.6, marker_length=MARKER_LENGTH
)  # over water, of 20.6 /m
SIZE = 400
PROJECTOR = Projector.frontal(np.array([[-0.015, -0.005, -0.015], [0.015, 0.005, 0.015]]), SIZE)
BACKGROUND = np.full((SIZE, SIZE), 200.0, np.float32)
NOTHING = np.empty((0, 3))


def line(start: float, end: float, x: float = 0.0) -> np.ndarray:
    """Nodes of an upright device from its tip at a height (m) downwards."""
    return np.stack((np.full(8, x), np.zeros(8), np.linspace(start, end, 8)), axis=1)


def drawn(wire: np.ndarray, catheter: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    out = [np.empty((SIZE, SIZE), np.uint8) for _ in range(3)]
    renderer = DeviceRenderer(PROJECTOR, BACKGROUND, wire_radius=WIRE_RADIUS, catheter=TUBE)
    renderer.render_into(wire, catheter, *out)
    return out[0], out[1], out[2]


def column(x: float) -> int:
    return round(float(PROJECTOR.project(np.array([[x, 0.0, 0.0]]))[0, 0]))


def test_a_tube_attenuates_by_its_wall_and_its_edges_are_darkest() -> None:
    image, _, mask = drawn(NOTHING, line(0.012, -0.015))
    row, middle = SIZE // 2, column(0.0)
    expected = 200.0 * np.exp(-GAMMA * EMPHASIS * WALL * 2 * (RADIUS - INNER))
    assert image[row, middle] == pytest.approx(expected, abs=2.0)
    # tangential to the lumen the way through the wall is longest
    thickest = 200.0 * np.exp(-GAMMA * EMPHASIS * WALL * 2 * np.sqrt(RADIUS**2 - INNER**2))
    assert image[row].min() == pytest.approx(thickest, abs=8.0)
    assert abs(abs(int(image[row].argmin()) - middle) - INNER * PROJECTOR.pixels_per_metre(np.zeros(3))) < 2
    assert mask[row].sum() == pytest.approx(2 * RADIUS * PROJECTOR.pixels_per_metre(np.zeros(3)), abs=1.5)


def test_attenuation_of_both_adds() -> None:
    wire, catheter = line(0.012, -0.015, 0.2e-3), line(0.005, -0.015)
    both, tube, bare = (
        drawn(*pair)[0].astype(float) for pair in ((wire, catheter), (NOTHING, catheter), (wire, NOTHING))
    )
    assert both == pytest.approx(tube * bare / 200.0, abs=1.5)
    row = SIZE - 100
    assert both[row].min() < min(tube[row].min(), bare[row].min()) - 3


def test_the_wire_shows_within_the_catheter_and_in_its_own_mask() -> None:
    image, wire_mask, catheter_mask = drawn(line(0.012, -0.015), line(0.005, -0.015))
    row, ahead, middle = SIZE - 100, SIZE // 2 - 120, column(0.0)
    assert wire_mask[ahead, middle]
    assert not catheter_mask[ahead].any()
    assert wire_mask[row, middle]
    assert catheter_mask[row].sum() > wire_mask[row].sum() > 0
    assert (catheter_mask[row] >= wire_mask[row]).all()
    assert image[row, middle] < image[row, middle + int(catheter_mask[row].sum() / 2) - 2]


def test_the_marker_covers_its_own_length_behind_the_tip() -> None:
    image, _, mask = drawn(NOTHING, line(0.010, -0.015))
    middle, scale = column(0.0), PROJECTOR.pixels_per_metre(np.zeros(3))
    grey = 200.0 * np.exp(-GAMMA * EMPHASIS * MARKER * 2 * (RADIUS - INNER))
    shaft = 200.0 * np.exp(-GAMMA * EMPHASIS * WALL * 2 * (RADIUS - INNER))
    assert grey < 60 < shaft
    area = np.count_nonzero(image[:, middle - 3 : middle + 4] < (grey + shaft) / 2) / 7
    assert area / scale == pytest.approx(MARKER_LENGTH, abs=0.4e-3)
    top = float(PROJECTOR.project(np.array([[0.0, 0.0, 0.010]]))[0, 1])
    assert np.flatnonzero(mask.any(axis=1))[0] == pytest.approx(top, abs=0.25e-3 * scale)


def test_without_a_catheter_it_is_the_bare_wire_bit_for_bit() -> None:
    wire = line(0.012, -0.015, 0.3e-3)
    bare = FluoroscopyRenderer(PROJECTOR, BACKGROUND, wire_radius=WIRE_RADIUS)
    image, wire_mask, catheter_mask = drawn(wire, NOTHING)
    assert np.array_equal(wire_mask, bare.mask(wire))
    assert not catheter_mask.any()
    assert np.array_equal(image, bare.render(wire)), "a background of whole grey levels"


def test_a_copy_draws_the_same_and_bad_points_are_refused() -> None:
    renderer = DeviceRenderer(PROJECTOR, BACKGROUND, wire_radius=WIRE_RADIUS, catheter=TUBE)
    pictures = [[np.empty((SIZE, SIZE), np.uint8) for _ in range(3)] for _ in range(2)]
    for one, out in zip((renderer, pickle.loads(pickle.dumps(renderer))), pictures, strict=True):
        one.render_into(line(0.012, -0.015), line(0.0, -0.015), *out)
    assert np.array_equal(*pictures)
    with pytest.raises(ValueError, match="not finite"):
        renderer.render_into(NOTHING, np.full((4, 3), np.nan), *pictures[0])
    with pytest.raises(ValueError, match="shape \\(n, 3\\)"):
        renderer.render_into(np.zeros((4, 2)), NOTHING, *pictures[0])
