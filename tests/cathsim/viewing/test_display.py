"""The window of the render mode "human", on a screen that is none."""

from __future__ import annotations

import pickle
import sys
import time
from typing import Any

import gymnasium
import numpy as np
import pytest

from cathsim import ENVIRONMENT
from cathsim.registration import MANY
from cathsim.viewing import camera_view as view
from cathsim.viewing.display import LEAST_HEIGHT

FORWARD = np.array([1.0, 0.0], np.float32)


@pytest.fixture
def screen(monkeypatch: pytest.MonkeyPatch) -> Any:
    """pygame, drawing nowhere."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    return pytest.importorskip("pygame")


@pytest.fixture
def no_opengl(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(width: int, height: int) -> None:
        raise view.RenderingUnavailableError("no OpenGL")

    monkeypatch.setattr(view, "open_context", refuse)


def shown(pygame: Any) -> np.ndarray:
    """What the window shows. Shape (height, width, 3)."""
    return pygame.surfarray.array3d(pygame.display.get_surface()).transpose(1, 0, 2)


@pytest.mark.parametrize("ident", [ENVIRONMENT, MANY])
@pytest.mark.usefixtures("no_opengl")
def test_the_window_shows_every_step_at_its_speed(screen: Any, ident: str) -> None:
    arguments = {"phantoms": ("type_1",)} if ident == MANY else {}
    env = gymnasium.make(ident, render_mode="human", image_size=64, accuracy="fast", **arguments)
    env.reset(seed=0)
    first, begun = shown(screen), time.perf_counter()
    assert first.shape == (512, 512, 3)
    assert len(first) >= LEAST_HEIGHT
    for _ in range(10):
        env.step(FORWARD)
    assert time.perf_counter() - begun > 0.9, "the speed of the simulated time"
    last = shown(screen)
    assert not np.array_equal(first, last)
    image = env.unwrapped.fluoroscope.image()
    assert np.array_equal(last[::8, ::8, 0], image)
    assert env.render() is None
    twin = pickle.loads(pickle.dumps(env))
    twin.step(FORWARD)
    env.close()
    env.close()
    assert screen.display.get_surface() is None


def test_the_window_shows_the_view_where_opengl_draws(screen: Any) -> None:
    try:
        view.open_context(16, 16).free()
    except view.RenderingUnavailableError as error:
        pytest.skip(str(error))
    env = gymnasium.make(ENVIRONMENT, render_mode="human", accuracy="fast")
    env.reset(seed=0)
    assert shown(screen).shape == (640, 480, 3)
    env.close()


def test_a_missing_pygame_is_named_with_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(ImportError, match=r"needs pygame: pip install 'endonav-cathsim\[human\]'") as caught:
        gymnasium.make(ENVIRONMENT, render_mode="human", accuracy="fast")
    assert "\n" not in str(caught.value)
