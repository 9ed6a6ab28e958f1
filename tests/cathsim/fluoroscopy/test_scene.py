"""What lies in the beam: sections of wire, solids, fillings and the detector's light, against values by hand."""

import numpy as np
import pytest

from cathsim.fluoroscopy import (
    SCENES,
    Box,
    Detector,
    Ellipsoid,
    Section,
    WireMaterial,
    XRayScene,
    coil_tipped_wire,
    jacketed_wire,
    scene,
    steel_wire,
    wire_material,
)
from cathsim.fluoroscopy.materials import ATTENUATION
from cathsim.guidewire import load_guidewire


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


@pytest.mark.parametrize(("material", "low", "high"), [("nitinol", 740, 780), ("silicone", 24, 28), ("water", 20, 22)])
def test_attenuation_lies_where_the_tables_put_it(material, low, high):
    assert low < ATTENUATION[material] < high


def test_chords_of_solids():
    source = np.array([0.0, -1.0, 0.0])
    ahead, aside = np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0])
    slanted = np.array([0.0, np.cos(0.02), np.sin(0.02)])
    box = Box((0, 0, 0), (0.1, 0.05, 0.2), 1.0)
    np.testing.assert_allclose(box.chord(source, np.stack((ahead, aside, slanted))), [0.1, 0, 0.1 / np.cos(0.02)])
    ball = Ellipsoid((0, 0, 0), (0.1, 0.05, 0.2), 1.0)
    np.testing.assert_allclose(ball.chord(source, np.stack((ahead, aside))), [0.1, 0])
    with pytest.raises(ValueError, match=r"half_sides\[1\] must lie in 0 \(excluded\) to 10 m"):
        Box((0, 0, 0), (0.1, 0.0, 0.2), 1.0)


def test_fillings():
    assert scene("bath").filling == 0
    assert scene("bath", "air").filling == -SCENES["bath"].surroundings
    assert scene("patient", "contrast").filling == pytest.approx(30.4)
    with pytest.raises(ValueError, match="unknown filling"):
        scene("bath", "beer")
    with pytest.raises(ValueError, match="unknown scene"):
        scene("moon")


def test_light_has_a_round_border_a_vignette_and_a_heel():
    detector = Detector(field_radius=0.9, penumbra=20, vignette=0.6, heel=0.2)
    light = detector.illumination(256, 256)
    assert light.shape == (256, 256)
    assert light[0, 0] == 0
    assert light[128, 128] == pytest.approx(1, abs=0.02)
    radius = np.hypot(*np.mgrid[:256, :256] - 127.5)
    assert light[radius > 0.9 * 128].max() == 0
    assert light[128, 48] > light[128, 207]  # the heel
    assert light[68, 128] == pytest.approx(np.exp(-0.5 * (59.5 / (0.9 * 128 * 0.6)) ** 2), rel=0.01)
    flat = Detector(field_radius=None).illumination(40, 30)
    np.testing.assert_array_equal(flat, np.ones((30, 40), np.float32))


def test_larger_pixels_catch_more_photons():
    assert Detector(photons=800).white(512, 512) == 3200


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Detector(photons=0), "photons must lie in"),
        (lambda: Detector(screen_blur=-1), "screen_blur must lie in 0 to 200 px"),
        (lambda: Detector(field_radius=0.0), "field_radius must lie in"),
        (lambda: Detector(heel=2.0), "heel must lie in"),
        (lambda: Section(0.1, ((0.5e-3, 1.0), (0.3e-3, 1.0))), "growing positive radii"),
        (lambda: Section(0.0, ((0.5e-3, 1.0),)), "length must lie in"),
        (lambda: WireMaterial(()), "at least one section"),
        (lambda: XRayScene("", (), 0, 0, 0, 0, scatter=1.0), "scatter must lie in"),
        (lambda: XRayScene("", (), 0, 0, 0, 0, scatter=0.1, middle=300), "middle must lie in"),
        (lambda: XRayScene("", (), 0, 0, -1, 0, scatter=0.1), "wall_thickness must lie in 0 to 0.1 m, got -1"),
    ],
)
def test_bad_input_is_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()
