"""Films, windows and videos of episodes, and the fluoroscope of a display."""

import pickle
import sys
import time
from pathlib import Path
from typing import Any

import gymnasium
import imageio.v3 as imageio
import numpy as np
import pytest
from PIL import Image

import cathsim  # noqa: F401
from cathsim import ENVIRONMENT, NavigateEnv, load_phantom
from cathsim.fluoroscopy import scene
from cathsim.observations.framing import framed
from cathsim.registration import MANY
from cathsim.viewing import camera_view as view
from cathsim.viewing.display import LEAST_HEIGHT
from cathsim.viewing.display_fluoroscope import CATHETER, VIEWS, WIRE, DisplayFluoroscope, contrast_picture
from cathsim.viewing.film import BIPLANE_PX, HEIGHT_PX, STRIDE, Film, film_states, write_gif

FORWARD = np.array([1.0, 0.0], np.float32)


def test_a_film_has_every_second_step_or_fewer_and_the_last(tmp_path: Path) -> None:
    environment = NavigateEnv("type_1", "bca", observation="tip", max_steps=3)
    environment.reset(seed=0)
    films = {3: Film(STRIDE), 2: Film(4)}
    for step in range(4):
        if step:
            environment.step(FORWARD)
        for film in films.values():
            film.add(environment)
    for frames, film in films.items():
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


def test_the_window_shows_every_step_at_its_speed(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(width: int, height: int) -> None:
        raise view.RenderingUnavailableError("no OpenGL")

    def shown() -> np.ndarray:
        return pygame.surfarray.array3d(pygame.display.get_surface()).transpose(1, 0, 2)

    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")  # draws nowhere
    monkeypatch.setattr(view, "open_context", refuse)
    pygame = pytest.importorskip("pygame")
    env = gymnasium.make(MANY, phantoms=("type_1",), render_mode="human", image_size=64, accuracy="fast")
    env.reset(seed=0)
    first, begun = shown(), time.perf_counter()
    assert first.shape == (512, 512, 3)
    assert len(first) >= LEAST_HEIGHT
    for _ in range(10):
        env.step(FORWARD)
    assert time.perf_counter() - begun > 0.9, "the speed of the simulated time"
    last = shown()
    assert not np.array_equal(first, last)
    image = env.unwrapped.fluoroscope.image()
    assert np.array_equal(last[::8, ::8, 0], image)
    assert env.render() is None
    twin = pickle.loads(pickle.dumps(env))
    twin.step(FORWARD)
    env.close()
    env.close()
    assert pygame.display.get_surface() is None


def test_a_missing_pygame_is_named_with_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(ImportError, match=r"pip install 'endonav-cathsim\[human\]'"):
        gymnasium.make(ENVIRONMENT, render_mode="human", accuracy="fast")


def test_record_video_writes_an_episode(tmp_path: Path) -> None:
    base = gymnasium.make(ENVIRONMENT, render_mode="fluoroscopy", accuracy="fast", max_steps=10)
    env = gymnasium.wrappers.RecordVideo(base, str(tmp_path), name_prefix="wire")
    env.reset(seed=0)
    ended, steps = False, 0
    while not ended:
        _, _, terminated, truncated, _ = env.step([1.0, 0.0])
        ended, steps = terminated or truncated, steps + 1
    env.close()
    frames = imageio.imread(tmp_path / "wire-episode-0.mp4")
    assert len(frames) in (steps, steps + 1)
    assert frames[0].std() > 1


SIZE = 160


@pytest.mark.parametrize("catheter", [None, "vertebral"])
def test_devices_are_drawn_where_they_are(catheter: str | None) -> None:
    devices: dict[str, Any] = {} if catheter is None else {"catheter": catheter}
    environment = NavigateEnv("type_1", "bca", observation="tip", **devices)
    environment.reset(seed=0)
    for _ in range(10):
        environment.step(np.array([1.0, 0.0] if catheter is None else [1.0, 0.0, 0.5, 0.0]))
    simulation = environment.simulation
    panels = np.split(DisplayFluoroscope(simulation, SIZE, scene("patient")).image(), len(VIEWS), axis=1)
    for angle, panel in zip(VIEWS, panels, strict=True):
        assert panel.shape == (SIZE, SIZE, 3)
        drawn = np.argwhere(np.abs(panel.astype(int) - WIRE).max(axis=-1) < 90)[:, ::-1]
        tip = framed(simulation.phantom, angle, SIZE).project(simulation.wire_points()[:1])[0]
        assert np.linalg.norm(drawn - tip, axis=1).min() < 2.0, angle
        blue = (np.abs(panel.astype(int) - CATHETER).max(axis=-1) < 60).any()
        assert blue == (catheter is not None)


def test_contrast_medium_shows_the_vessels() -> None:
    phantom = load_phantom("type_1")
    picture = contrast_picture(phantom, SIZE, scene("patient"), views=("frontal",)).astype(float)
    points = framed(phantom, "frontal", SIZE).project(np.asarray(phantom.tree.root.points)[20:-20])
    columns, rows = np.rint(points).astype(int).T
    assert picture[rows, columns].mean() < picture.mean() - 20


def test_a_film_with_a_background_has_both_c_arms() -> None:
    environment = NavigateEnv("type_1", "bca", observation="tip")
    environment.reset(seed=0)
    film = Film(background=scene("patient"))
    film.add(environment)
    film.close()
    assert film._frames[0].shape[0] == BIPLANE_PX
    assert film._frames[0].shape[1] >= 2 * BIPLANE_PX


def test_states_of_two_devices_make_a_film_and_none_are_refused(tmp_path: Path) -> None:
    environment = NavigateEnv("type_1", "bca", observation="tip", catheter="simmons2")
    environment.reset(seed=0)
    states = [environment.simulation.state()]
    for _ in range(9):
        environment.step(np.array([1.0, 0.0, 0.8, 0.0]))
        states.append(environment.simulation.state())
    with pytest.raises(ValueError, match="at least one state"):
        film_states(tmp_path / "none.gif", environment.simulation, [])
    tip = environment.simulation.tip
    film_states(tmp_path / "two.gif", environment.simulation, states)
    assert np.allclose(environment.simulation.tip, tip)
    with Image.open(tmp_path / "two.gif") as shown:
        assert getattr(shown, "n_frames", 1) == 6
        first = np.asarray(shown.convert("L"), float)[:, :HEIGHT_PX]
        shown.seek(5)
        last = np.asarray(shown.convert("L"), float)[:, :HEIGHT_PX]
    assert (last < first - 40).sum() > 30, "the devices have moved"
