"""Films: every second step and the last one are shown, in one palette."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cathsim import NavigateEnv
from cathsim.viewing.film import HEIGHT_PX, STRIDE, Film, film_palette, film_states, write_gif


@pytest.mark.parametrize(("stride", "frames"), [(STRIDE, 3), (4, 2)])
def test_a_film_has_every_second_step_or_fewer_and_the_last(tmp_path: Path, stride: int, frames: int) -> None:
    environment = NavigateEnv("type_1", "bca", observation="tip", max_steps=3)
    environment.reset(seed=0)
    film = Film(stride)
    film.add(environment)
    for _ in range(3):
        environment.step(np.array([1.0, 0.0]))
        film.add(environment)
    film.write(tmp_path / "film")
    film.close()
    with Image.open(tmp_path / "film") as shown:
        assert (shown.format, shown.height) == ("GIF", HEIGHT_PX)
        assert getattr(shown, "n_frames", 1) == frames


def test_films_of_two_anatomies_are_appended(tmp_path: Path) -> None:
    films = []
    for phantom in ("type_1", "type_2"):
        environment = NavigateEnv(phantom, "bca", observation="tip")
        environment.reset(seed=0)
        film = Film()
        film.add(environment)
        film.close()
        films.append(film)
    films[0].append(films[1])
    films[0].write(tmp_path / "both.gif")
    with Image.open(tmp_path / "both.gif") as shown:
        assert getattr(shown, "n_frames", 1) == 2
        first = np.asarray(shown.convert("L"), float)
        shown.seek(1)
        assert (np.abs(np.asarray(shown.convert("L"), float) - first) > 30).mean() > 0.02, "another arch"


def test_a_gif_keeps_the_colours_of_its_palette(tmp_path: Path) -> None:
    frames = [np.full((4, 6, 3), value, np.uint8) for value in (0, 255)]
    write_gif(tmp_path / "two.gif", frames, [0, 0, 0, 255, 255, 255], 10.0)
    with Image.open(tmp_path / "two.gif") as shown:
        assert shown.size == (6, 4)
        assert shown.info["duration"] == 100
        shown.seek(1)
        assert shown.convert("RGB").getpixel((0, 0)) == (255, 255, 255)
        assert shown.info["duration"] == 1500


def test_grey_images_stay_grey_beside_colours(tmp_path: Path) -> None:
    frame = np.repeat(np.arange(256, dtype=np.uint8)[None, :, None], 3, axis=2).repeat(64, axis=0)
    frame[30:33] = (255, 214, 10)
    frame[50:] = np.stack([np.linspace(90, 240, 256)] * 2 + [np.full(256, 60.0)], axis=1).astype(np.uint8)
    palette = film_palette([frame], 32, 16)
    assert len(palette) == 3 * 48
    write_gif(tmp_path / "one.gif", [frame], palette, 10.0)
    with Image.open(tmp_path / "one.gif") as shown:
        found = np.asarray(shown.convert("RGB"), int)
    assert np.ptp(found[:30], axis=2).max() == 0
    assert np.abs(found[:30] - frame[:30]).max() <= 8  # half a step of the scale, and what Pillow rounds
    assert np.abs(found[31] - (255, 214, 10)).max() <= 24
    assert film_palette([frame[:30]], 4, 16) == [0] * 3 + [85] * 3 + [170] * 3 + [255] * 3


def test_states_of_two_devices_make_a_film(tmp_path: Path) -> None:
    environment = NavigateEnv("type_1", "bca", observation="tip", catheter="simmons2")
    environment.reset(seed=0)
    states = [environment.simulation.state()]
    for _ in range(9):
        environment.step(np.array([1.0, 0.0, 0.8, 0.0]))
        states.append(environment.simulation.state())
    tip = environment.simulation.tip
    film_states(tmp_path / "two.gif", environment.simulation, states)
    assert np.allclose(environment.simulation.tip, tip)
    with Image.open(tmp_path / "two.gif") as shown:
        assert getattr(shown, "n_frames", 1) == 6
        first = np.asarray(shown.convert("L"), float)[:, :HEIGHT_PX]
        shown.seek(5)
        last = np.asarray(shown.convert("L"), float)[:, :HEIGHT_PX]
    assert (last < first - 40).sum() > 30, "the devices have moved"


def test_a_film_of_nothing_is_refused(tmp_path: Path) -> None:
    environment = NavigateEnv("type_1", "bca", observation="tip")
    with pytest.raises(ValueError, match="at least one state"):
        film_states(tmp_path / "none.gif", environment.simulation, [])
