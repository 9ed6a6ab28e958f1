"""The 3-D picture for people, and what is said where it cannot be drawn."""

from collections.abc import Callable

import numpy as np
import pytest

from cathsim.viewing.camera_view import RenderingUnavailableError, View, open_context
from tests.cathsim.makers import MakeEnv


@pytest.fixture
def rendering() -> None:
    """Skips where no OpenGL library is installed."""
    try:
        open_context(16, 16).free()
    except RenderingUnavailableError as error:
        pytest.skip(str(error))


@pytest.mark.usefixtures("rendering")
def test_picture_shows_vessel_wire_and_target(make_env: MakeEnv) -> None:
    env = make_env(render_mode="rgb_array")
    env.reset(seed=0)
    pictures = []
    for _ in range(2):
        for _ in range(50):
            env.step(np.array([1.0, 0.3]))
        pictures.append(env.render())
    first, second = pictures
    assert (second.shape, second.dtype) == ((640, 480, 3), np.uint8)
    red, green, blue = np.moveaxis(second.astype(int), -1, 0)
    assert ((red > green + 20) & (red > blue + 20)).mean() > 0.05, "the vessel"
    assert ((green < 90) & (red < 140)).sum() > 300, "the wire is dark, also behind the translucent wall"
    assert (green > red + 30).sum() > 20, "the target is green"
    assert (red > 230).mean() > 0.2, "the background is light"
    assert (first != second).any(axis=-1).sum() > 200, "the wire has moved"
    assert np.array_equal(env.render(), second)


@pytest.mark.usefixtures("rendering")
def test_head_is_up_and_the_patients_left_is_on_the_right(make_env: MakeEnv) -> None:
    env = make_env()
    view = View(env.phantom, width=120, height=160)
    low, high = env.phantom.bounds
    middle = (low + high) / 2
    blank = view.render(env.simulation)
    for direction, axis, sign in ((0, 1, 1), (2, 0, -1)):
        goal = middle.copy()
        goal[direction] += 0.4 * (high - low)[direction]
        changed = np.argwhere((view.render(env.simulation, goal) != blank).any(axis=-1))
        assert len(changed) > 3
        assert sign * (changed[:, axis].mean() - blank.shape[axis] / 2) > 10
    view.close()


def test_missing_libraries_are_reported_and_the_episode_goes_on(run_python: Callable[[str], str]) -> None:
    snippet = """
import ctypes, ctypes.util, os
load = ctypes.CDLL.__init__
def without_opengl(self, name, *args, **kwargs):
    if name and any(part in str(name) for part in ("EGL", "OSMesa", "libGL", "OpenGL")):
        raise OSError(f"{name}: cannot open shared object file")
    load(self, name, *args, **kwargs)
ctypes.CDLL.__init__ = without_opengl
find = ctypes.util.find_library
ctypes.util.find_library = lambda name: None if name in ("EGL", "OSMesa", "GL", "OpenGL") else find(name)
os.environ.pop("MUJOCO_GL", None)
import numpy as np
from cathsim import NavigateEnv
from cathsim.viewing.camera_view import RenderingUnavailableError
env = NavigateEnv(accuracy="fast", render_mode="rgb_array")
env.reset(seed=0)
try:
    env.render()
except RenderingUnavailableError as error:
    print(error)
print(env.step(np.ones(2))[1] < 0)
"""
    lines = run_python(snippet).strip().splitlines()
    assert lines[0].startswith("3-D pictures need EGL or OSMesa and neither works")
    assert lines[-1] == "True"
    assert len(lines) == 2, "one sentence"


@pytest.mark.usefixtures("rendering")
def test_two_devices_have_their_own_colours_and_radii(make_env: MakeEnv) -> None:
    env = make_env(catheter="vertebral_6f", target="lcca")
    env.reset(seed=0)
    for _ in range(40):
        env.step(np.array([1.0, 0.0, 0.5, 0.0]))
    view = View(env.phantom, width=700, height=900)
    picture = view.render(env.simulation).astype(int)
    env.reset(seed=0)
    without = view.render(env.simulation).astype(int)
    view.close()
    red, green, blue = np.moveaxis(picture, -1, 0)
    catheter = (blue > red + 25) & (blue > green + 25)
    dark = (red < 140) & (green < 70) & (blue < 90)
    marker = (red > blue + 80) & (red > green + 30)
    assert catheter.sum() > 300, "the catheter is blue"
    assert dark.sum() > 30, "the wire ahead of it is dark"
    assert 3 < marker.sum() < 200, "the marker is yellow"
    rows = np.flatnonzero(catheter.any(axis=1))
    assert np.flatnonzero(dark.any(axis=1))[0] < rows[0], "the wire's tip is further in"
    changed = np.abs(picture - without).sum(axis=2) > 20
    widths = changed[rows[0] + 20 : rows[0] + 60].sum(axis=1)
    low, high = env.phantom.bounds
    scale = 900 / (2 * 1.25 * (high[2] - low[2]) * np.tan(np.radians(22.5)))  # px/m of MuJoCo's 45 degrees
    assert np.median(widths) == pytest.approx(2e-3 * scale, abs=2.0)
