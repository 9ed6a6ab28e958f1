"""Two cameras look at a wire in a catheter: attenuation, masks, marker, refusals."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from cathsim.fluoroscopy import BiplaneFluoroscope, Radiograph, catheter_material, guide3d_pair
from cathsim.fluoroscopy.wire_shadow import ShadowWindow, overlaid

NOTHING = np.empty((0, 3))
SIZE = 512


def tube(marker_length: float = 4e-3):
    return catheter_material(0.835e-3, 0.6e-3, wall=170.0, marker=1430.0, marker_length=marker_length)


def bend(start: float) -> np.ndarray:
    """Nodes of an arc from a distance (m) along it on."""
    angle = np.arange(start, 0.12, 0.002) / 0.045
    return np.column_stack((0.045 * np.cos(angle), 0.01 * np.sin(2 * angle), 0.045 * np.sin(angle) - 0.01))


@pytest.fixture(scope="module")
def fluoroscope() -> BiplaneFluoroscope:
    """Of nothing but air: every pixel expects as many photons, and none are scattered."""
    cameras = guide3d_pair(np.zeros(3), SIZE)
    stills = [Radiograph(np.full((SIZE, SIZE), 500.0, np.float32), np.zeros((SIZE, SIZE), np.float32)) for _ in cameras]
    return BiplaneFluoroscope(cameras, stills, catheter=tube())


def depth(image: np.ndarray) -> np.ndarray:
    """Optical depth in an image without noise, whose grey levels are the square root of the light."""
    return -2 * np.log(image / image.max())


def test_without_a_catheter_it_is_the_bare_wire_bit_for_bit(fluoroscope: BiplaneFluoroscope) -> None:
    bare, both = fluoroscope.render(bend(0.0), 3), fluoroscope.render_devices(bend(0.0), NOTHING, 3)
    for name in fluoroscope.names:
        assert np.array_equal(bare[name].image, both[name].image)
        assert np.array_equal(bare[name].mask, both[name].mask)
        assert np.array_equal(bare[name].mask, both[name].mask_wire)
        assert not both[name].mask_catheter.any()


@pytest.mark.parametrize("name", ["a", "b"])
def test_attenuation_of_both_adds(fluoroscope: BiplaneFluoroscope, name: str) -> None:
    wire, catheter = bend(0.0), bend(0.04)
    both, inner, outer = (
        fluoroscope.render_devices(*pair)[name] for pair in ((wire, catheter), (wire, NOTHING), (NOTHING, catheter))
    )
    assert depth(both.image) == pytest.approx(depth(inner.image) + depth(outer.image), abs=0.05)
    assert depth(both.image).max() > depth(inner.image).max() + 0.02
    assert np.array_equal(both.mask, both.mask_wire | both.mask_catheter)
    assert np.array_equal(both.mask_catheter, outer.mask)
    ahead = both.mask_wire > both.mask_catheter
    inside = (both.mask_wire == 1) & (both.mask_catheter == 1)
    assert ahead.any()
    assert inside.sum() > ahead.sum()


def test_the_catheter_is_wider_and_fainter_than_the_wire(fluoroscope: BiplaneFluoroscope) -> None:
    plain = fluoroscope.with_catheter(tube(0.0))
    wire, catheter = (plain.render_devices(*pair)["a"] for pair in ((bend(0.0), NOTHING), (NOTHING, bend(0.0))))
    assert catheter.mask.sum() > 1.5 * wire.mask.sum()
    assert 0.05 < depth(catheter.image).max() < depth(wire.image).max()


def test_the_marker_is_at_the_tip_alone(fluoroscope: BiplaneFluoroscope) -> None:
    image = fluoroscope.render_devices(NOTHING, bend(0.04))["a"].image
    dark = np.argwhere(depth(image) > 0.4)
    camera = fluoroscope.cameras["a"]
    tip = camera.pixels(bend(0.04)[:1])[0]
    assert len(dark) > 5
    assert np.linalg.norm(dark[:, ::-1] - tip, axis=1).max() < 4.5e-3 * camera.projector.pixels_per_metre(bend(0.04)[0])


def test_noise_of_a_camera_does_not_depend_on_which_is_asked_for(fluoroscope: BiplaneFluoroscope) -> None:
    devices = bend(0.0), bend(0.04)
    whole = fluoroscope.render_devices(*devices, 5)
    copy = pickle.loads(pickle.dumps(fluoroscope))
    assert np.array_equal(copy.render_devices(*devices, 5, only=("b",))["b"].image, whole["b"].image)


def test_a_fluoroscope_without_the_material_says_how_to_have_it(fluoroscope: BiplaneFluoroscope) -> None:
    cameras = list(fluoroscope.cameras.values())
    still = Radiograph(np.ones((SIZE, SIZE), np.float32), np.zeros((SIZE, SIZE), np.float32))
    with pytest.raises(ValueError, match="with_catheter"):
        BiplaneFluoroscope(cameras, [still, still]).render_devices(NOTHING, bend(0.0))
    with pytest.raises(ValueError, match="unknown camera 'c'"):
        fluoroscope.render_devices(NOTHING, bend(0.0), only=("c",))


def test_shadows_that_lie_apart_are_overlaid_in_one_window() -> None:
    first = ShadowWindow(2, 3, np.full((2, 4), 0.5, np.float32), np.ones((2, 4), np.uint8))
    second = ShadowWindow(5, 1, np.full((3, 2), 0.8, np.float32), np.ones((3, 2), np.uint8))
    both = overlaid(first, second)
    assert both is not None
    assert (both.left, both.top, *both.ends) == (2, 1, 7, 5)
    assert both.transmission[2, 3] == pytest.approx(0.4)
    assert both.transmission[0, 0] == 1.0
    assert both.mask.sum() == 8 + 6 - 1
    assert overlaid(None, first) is first
    assert overlaid(None, None) is None
