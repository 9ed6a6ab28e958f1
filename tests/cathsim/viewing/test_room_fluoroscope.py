"""X-ray images for people: both C-arms, one contrast through a film, the devices drawn where they are."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from cathsim import NavigateEnv, load_phantom
from cathsim.fluoroscopy import scene
from cathsim.observations.framing import framed
from cathsim.viewing.film import ROOM_PX, Film
from cathsim.viewing.room_fluoroscope import CATHETER, VIEWS, WIRE, DisplayWindow, RoomFluoroscope, contrast_picture

SIZE = 160


@pytest.mark.parametrize("catheter", [None, "vertebral"])
def test_devices_are_drawn_where_they_are(catheter: str | None) -> None:
    devices: dict[str, Any] = {} if catheter is None else {"catheter": catheter}
    environment = NavigateEnv("type_1", "bca", observation="tip", **devices)
    environment.reset(seed=0)
    for _ in range(10):
        environment.step(np.array([1.0, 0.0] if catheter is None else [1.0, 0.0, 0.5, 0.0]))
    simulation = environment.simulation
    panels = np.split(RoomFluoroscope(simulation, SIZE, scene("patient")).image(), len(VIEWS), axis=1)
    for view, panel in zip(VIEWS, panels, strict=True):
        assert panel.shape == (SIZE, SIZE, 3)
        drawn = np.argwhere(np.abs(panel.astype(int) - WIRE).max(axis=-1) < 90)[:, ::-1]
        tip = framed(simulation.phantom, view, SIZE).project(simulation.wire_points()[:1])[0]
        assert np.linalg.norm(drawn - tip, axis=1).min() < 2.0, view
        blue = (np.abs(panel.astype(int) - CATHETER).max(axis=-1) < 60).any()
        assert blue == (catheter is not None)


def test_a_view_keeps_the_contrast_of_its_first_image() -> None:
    window, first = DisplayWindow(), np.linspace(60, 120, 400).astype(np.uint8).reshape(20, 20)
    shown = window.shown(first, "frontal")
    assert shown.min() == 0
    assert shown.max() > 220
    np.testing.assert_array_equal(window.shown(first[:10], "frontal"), shown[:10])
    assert (window.shown(first[:10], "lateral") != shown[:10]).any()
    assert window.shown(np.full((4, 4), 255, np.uint8), "oblique").max() == 235, "an image without anything in it"


def test_contrast_medium_shows_the_vessels() -> None:
    phantom = load_phantom("type_1")
    picture = contrast_picture(phantom, SIZE, scene("patient"), views=("frontal",)).astype(float)
    points = framed(phantom, "frontal", SIZE).project(np.asarray(phantom.tree.root.points)[20:-20])
    columns, rows = np.rint(points).astype(int).T
    assert picture[rows, columns].mean() < picture.mean() - 20


def test_a_film_in_a_room_has_both_c_arms() -> None:
    environment = NavigateEnv("type_1", "bca", observation="tip")
    environment.reset(seed=0)
    film = Film(room=scene("patient"))
    film.add(environment)
    film.close()
    assert film._frames[0].shape[0] == ROOM_PX
    assert film._frames[0].shape[1] >= 2 * ROOM_PX
