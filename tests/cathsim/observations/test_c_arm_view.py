"""Images by the C-arms: a logged shape is drawn as the environment shows it, and the contrast run shows the vessels."""

from __future__ import annotations

import gc
import weakref
from dataclasses import replace

import numpy as np
import pytest

from cathsim import load_phantom
from cathsim.observations.c_arm_view import (
    CArmClutter,
    CArms,
    c_arm_environment,
    contrast_images,
    fluoroscope_of,
    images_of_shape,
    marks_of,
    with_shaft,
)

ARMS = CArms(("a",), 256)


def test_images_of_a_logged_shape_are_those_of_the_environment() -> None:
    phantom = load_phantom("type_1")
    environment = c_arm_environment(phantom, "bca", ARMS, ("tip",))
    environment.reset(seed=3)
    for _ in range(20):
        environment.step(np.array([1.0, 0.3]))
    assert environment.biplane is not None
    seen = environment.biplane.frame("a").image.astype(float)
    simulation = environment.simulation
    nodes = with_shaft(simulation.wire_points(), simulation.vessel.direction)
    drawn = images_of_shape(phantom, ARMS, nodes, 5)[0].astype(float)
    empty = images_of_shape(phantom, ARMS, np.empty((0, 3)), 5)[0].astype(float)
    wire = empty - drawn > 8  # the same noise in both
    assert wire.sum() > 50
    assert np.abs((drawn - seen)[wire].mean()) < 2
    assert (empty - seen)[wire].mean() > 8
    environment.close()


def test_contrast_run_darkens_the_vessels_alone() -> None:
    phantom = load_phantom("type_1")
    plain, contrast = contrast_images(phantom, ARMS)["a"]
    darker = plain.astype(float) - contrast
    aorta = next(branch for branch in phantom.tree.branches if branch.parent is None)
    camera = fluoroscope_of(phantom, ARMS).cameras["a"]
    columns, rows = camera.pixels(aorta.points[::10]).round().astype(int).T
    seen = (columns >= 0) & (columns < 256) & (rows >= 0) & (rows < 256)
    # automatic brightness lifts or lowers a whole image
    assert np.median(darker[rows[seen], columns[seen]]) > np.median(darker) + 20
    np.testing.assert_array_equal(contrast_images(phantom, ARMS)["a"][1], contrast)


def test_mark_is_where_the_camera_shows_the_target() -> None:
    phantom = load_phantom("type_1")
    place = phantom.target("bca").position
    camera = fluoroscope_of(phantom, ARMS).cameras["a"]
    np.testing.assert_allclose(256 * marks_of(phantom, "bca", ARMS)["a"] - 0.5, camera.pixels(place[None])[0])


def test_clutter_lies_in_the_way_of_the_wire_and_of_the_contrast_run() -> None:
    phantom = load_phantom("type_1")
    bars = np.zeros((2, 256, 256), np.float32)
    bars[0, 100:120], bars[1, :, 40:50] = 0.8, 0.8
    clean = CArms(("a", "b"), 256)
    among = replace(clean, clutter=CArmClutter(tuple(bars)))
    nothing = np.empty((0, 3))
    for name, bar, plain, seen in zip(
        "ab",
        bars,
        images_of_shape(phantom, clean, nothing, 1),
        images_of_shape(phantom, among, nothing, 1),
        strict=True,
    ):
        for with_bar, without in (
            (seen, plain),
            (contrast_images(phantom, among)[name][1], contrast_images(phantom, clean)[name][1]),
        ):
            change = without.astype(float) - with_bar
            lit = without > 60  # within the field
            assert change[(bar > 0) & lit].mean() > change[(bar == 0) & lit].mean() + 15


def test_subtracted_images_show_the_wire_and_no_clutter() -> None:
    phantom, bars = load_phantom("type_1"), np.zeros((256, 256), np.float32)
    bars[100:120] = 0.8
    nodes = np.linspace((0.0, 0.0, 0.0), (0.0, 0.0, 0.1), 30) + phantom.bounds.mean(axis=0) - (0.0, 0.0, 0.05)
    arms = CArms(("a",), 256, clutter=CArmClutter((bars,)))
    seen, shown = (
        images_of_shape(phantom, one, nodes, 1)[0].astype(float) for one in (arms, replace(arms, subtracted=True))
    )
    column, row = np.floor(fluoroscope_of(phantom, arms).cameras["a"].pixels(nodes[5:25])).astype(int).T
    lit = np.zeros((256, 256), bool)
    lit[64:192, 64:192] = True
    lit &= seen > 40
    wire = np.zeros_like(lit)
    wire[row, column] = True
    assert abs(shown[lit & (bars > 0)].mean() - shown[lit & (bars == 0)].mean()) < 4
    assert abs(seen[lit & (bars > 0)].mean() - seen[lit & (bars == 0)].mean()) > 15
    assert shown[lit & ~wire].mean() - shown[lit & wire].mean() > 8


@pytest.mark.parametrize("shapes", [[(256, 256)], [(256, 256), (128, 128)]])
def test_clutter_of_other_images_is_refused(shapes: list[tuple[int, int]]) -> None:
    clutter = CArmClutter(tuple(np.zeros(shape, np.float32) for shape in shapes))
    with pytest.raises(ValueError, match=r"shape \(256, 256\) for each camera"):
        CArms(("a", "b"), 256, clutter=clutter)


def test_images_among_clutter_are_forgotten_with_it() -> None:
    phantom = load_phantom("type_1")
    arms = CArms(("a",), 256, clutter=CArmClutter((np.zeros((256, 256), np.float32),)), subtracted=True)
    images_of_shape(phantom, arms, np.empty((0, 3)), 1)
    kept = weakref.ref(fluoroscope_of(phantom, arms))
    assert fluoroscope_of(phantom, arms) is kept()
    assert fluoroscope_of(phantom, replace(arms, clutter=None)) is not kept()
    del arms
    gc.collect()
    assert kept() is None
