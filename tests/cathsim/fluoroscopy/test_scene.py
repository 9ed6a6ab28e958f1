"""What attenuates: scenes, materials, bodies, vessels."""

import numpy as np
import pytest

from cathsim.fluoroscopy import (
    SCENES,
    Projector,
    Section,
    background_image,
    catheter_material,
    coil_tipped_wire,
    jacketed_wire,
    lumen_path_length,
    scene,
    steel_wire,
    wire_material,
)
from cathsim.fluoroscopy.materials import ATTENUATION
from cathsim.guidewire import load_guidewire
from tests.cathsim.fluoroscopy.ball import CENTRE, RADIUS, ball_grid


def test_section_attenuates_as_nested_cylinders():
    section = Section(0.1, ((0.3e-3, 800.0), (0.5e-3, 300.0)))
    middle = 800 * 0.6e-3 + 300 * 0.4e-3
    jacket_only = 300 * 2 * np.sqrt(0.5e-3**2 - 0.4e-3**2)
    np.testing.assert_allclose(section.depth([0.0, 0.4e-3, 0.6e-3]), [middle, jacket_only, 0.0])


def test_wires_have_the_radius_and_the_tip_they_should():
    for make in (jacketed_wire, coil_tipped_wire):
        wire = make(0.445e-3)
        assert wire.radius == pytest.approx(0.445e-3)
        assert wire.starts[0] == 0
    depths = [section.depth(0.0) for section in jacketed_wire(0.445e-3).sections]
    assert depths == sorted(depths)  # the core thins towards the tip
    tip, shaft = (section.depth(0.0) for section in coil_tipped_wire(0.445e-3).sections)
    assert tip > 1.3 * shaft  # the coil is radiopaque
    assert wire_material("nitrex_straight", 4e-4) == coil_tipped_wire(4e-4)
    assert wire_material("default", 4e-4) == jacketed_wire(4e-4)


def test_steel_wires_are_as_full_of_steel_as_their_density_says():
    section = steel_wire(0.445e-3).sections[-1]
    inner, filled = 0.0, 0.0
    for radius, attenuation in section.layers:
        filled += attenuation / ATTENUATION["steel"] * (radius**2 - inner**2) / section.radius**2
        inner = radius
    for name in ("floppy", "amplatz", "stiff"):
        assert load_guidewire(name).density / 7900 == pytest.approx(filled, rel=0.02)
        assert wire_material(name, 4e-4) == steel_wire(4e-4)


def test_fillings():
    assert scene("bath").filling == 0
    assert scene("bath", "air").filling == -SCENES["bath"].surroundings
    assert scene("patient", "contrast").filling == pytest.approx(30.4)
    with pytest.raises(ValueError, match="unknown filling"):
        scene("bath", "beer")


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
    lengths = lumen_path_length(ball_grid(), projector, samples=1)
    expected = chords(projector, RADIUS)
    assert lengths.shape == (64, 64)
    inside = expected > 0.006
    np.testing.assert_allclose(lengths[inside], expected[inside], atol=1.5e-4)
    assert lengths[expected == 0].max() < 2e-3  # grazing rays only
    assert lengths.sum() == pytest.approx(expected.sum(), rel=0.01)


def test_vessel_is_darker_than_the_tissue_beside_it():
    image = background_image(ball_grid(), camera(48))
    u, v = np.rint(camera(48).project([CENTRE])[0]).astype(int)
    assert image.dtype == np.float32
    assert image.min() >= 0
    assert image.max() <= 255
    assert image[v, u] < 0.92 * image[v, 2]
    plain = background_image(ball_grid(), camera(48), contrast=0.0)
    assert image[v, u] < plain[v, u]


WATER = ATTENUATION["water"]


def material(marker_length: float = 3e-3, lumen: str = "water"):
    return catheter_material(1e-3, 0.6e-3, wall=170.0, marker=1430.0, marker_length=marker_length, lumen=lumen)


def test_a_tube_counts_over_the_water_that_it_displaces() -> None:
    marker, shaft = material().sections
    assert shaft.depth(0.0) == pytest.approx((170.0 - WATER) * 0.8e-3)
    assert marker.depth(0.0) == pytest.approx((1430.0 - WATER) * 0.8e-3)
    assert shaft.depth(0.8e-3) == pytest.approx((170.0 - WATER) * 2 * np.sqrt(1 - 0.64) * 1e-3)
    assert shaft.depth(1.1e-3) == 0.0
    assert material(lumen="blood").sections[-1].depth(0.0) > shaft.depth(0.0)
