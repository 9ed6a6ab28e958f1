"""Films: every second step and the last one are shown, in one palette."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from cathsim import NavigateEnv
from cathsim.viewing.film import HEIGHT_PX, Film, write_gif


def test_a_film_has_every_second_step_and_the_last(tmp_path: Path) -> None:
    environment = NavigateEnv("type_1", "bca", observation="tip", max_steps=3)
    environment.reset(seed=0)
    film = Film()
    film.add(environment)
    for _ in range(3):
        environment.step(np.array([1.0, 0.0]))
        film.add(environment)
    film.write(tmp_path / "film")
    film.close()
    with Image.open(tmp_path / "film") as shown:
        assert (shown.format, shown.height) == ("GIF", HEIGHT_PX)
        assert getattr(shown, "n_frames", 1) == 3


def test_a_gif_keeps_the_colours_of_its_palette(tmp_path: Path) -> None:
    frames = [np.full((4, 6, 3), value, np.uint8) for value in (0, 255)]
    write_gif(tmp_path / "two.gif", frames, [0, 0, 0, 255, 255, 255], 10.0)
    with Image.open(tmp_path / "two.gif") as shown:
        assert shown.size == (6, 4)
        assert shown.info["duration"] == 100
        shown.seek(1)
        assert shown.convert("RGB").getpixel((0, 0)) == (255, 255, 255)
        assert shown.info["duration"] == 1500
