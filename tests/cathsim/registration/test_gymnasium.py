"""What users of Gymnasium and Stable-Baselines3 expect of every registered environment."""

import os
import subprocess
import sys
import warnings
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import FrameStackObservation, OrderEnforcing, RecordEpisodeStatistics, ResizeObservation

from cathsim import NavigateEnv, ThreadedVectorEnv
from cathsim.registration import ARCH_VARIETY, COPIES, DUAL, DUAL_DEVICE_NAV, ENVIRONMENT, GOAL, MANY, RANDOM_TREES
from cathsim.rehearsal.environment import Perturbation
from tests.cathsim.dual_device_nav.published_files import REAL, folder
from tests.cathsim.equal_observations import same

SMALL: dict[str, dict[str, Any]] = {
    ENVIRONMENT: {},
    DUAL: {},
    MANY: {"phantoms": (0,)},
    GOAL: {"goals": ("bca", "lcca")},
    COPIES: {"copies": (0,), "perturbation": Perturbation(walls=5e-4)},
    ARCH_VARIETY: {"arch_types": ("VI",), "seeds": (1,), "resolution": 2e-3},
    RANDOM_TREES: {"seeds": (4,)},
    **({DUAL_DEVICE_NAV: {"folder": folder()}} if REAL.is_dir() else {}),
}
THREADED = [ident for ident in SMALL if ident != COPIES]


def arguments(ident: str, **others: Any) -> dict[str, Any]:
    return {"accuracy": "fast", "observation": "joints", **SMALL[ident], **others}


@pytest.mark.parametrize("ident", SMALL)
def test_gymnasiums_checker_passes_and_json_makes_it_again(ident: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(name, raising=False)
    env = gymnasium.make(ident, **arguments(ident))
    assert "human" not in env.metadata["render_modes"]
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        check_env(env.unwrapped, skip_render_check=ident not in (ENVIRONMENT, MANY))
    about = {str(one.message).rpartition("A Box observation space ")[2] for one in said}
    assert all("value is" in sentence for sentence in about), "only that the observations have no bounds"
    again = gymnasium.make(EnvSpec.from_json(env.spec.to_json()))
    (seen, info), (other, told) = (one.unwrapped.reset(seed=4) for one in (env, again))
    assert same(seen, other)
    assert (info.get("phantom"), info.get("target")) == (told.get("phantom"), told.get("target"))


@pytest.mark.parametrize("ident", THREADED)
def test_a_most_number_of_steps_truncates_as_with_any_environment(ident: str) -> None:
    ours = gymnasium.make_vec(ident, 2, max_episode_steps=3, **arguments(ident))
    theirs = gymnasium.make_vec(ident, 2, max_episode_steps=3, vectorization_mode="sync", **arguments(ident))
    assert isinstance(ours, ThreadedVectorEnv)
    assert same(ours.reset(seed=4)[0], theirs.reset(seed=4)[0])
    draws = np.random.default_rng(0).uniform(-1, 1, (8, *ours.action_space.shape)).astype(np.float32)
    for draw in draws:
        *gave, told = ours.step(draw)
        *expected, info = theirs.step(draw)
        assert same(tuple(gave), tuple(expected))
        assert np.array_equal(told.get("case"), info.get("case")), "cases of the next episodes are drawn alike"
    ours.close()
    theirs.close()


@pytest.mark.parametrize("mode", AutoresetMode)
def test_autoreset_modes_are_those_of_gymnasium(mode: AutoresetMode) -> None:
    chosen = arguments(ENVIRONMENT, max_steps=2)
    ours = gymnasium.make_vec(ENVIRONMENT, 2, autoreset_mode=mode, **chosen)
    named = {"vectorization_mode": "sync", "vector_kwargs": {"autoreset_mode": mode}, "wrappers": [OrderEnforcing]}
    theirs = gymnasium.make_vec(ENVIRONMENT, 2, **named, **chosen)
    assert ours.metadata["autoreset_mode"] is theirs.metadata["autoreset_mode"] is mode
    forward, mask = np.tile(np.float32([1, 0]), (2, 1)), {"reset_mask": np.array([True, True])}
    seen, expected = ours.reset(seed=1)[0], theirs.reset(seed=1)[0]
    for step in range(6):
        assert np.array_equal(seen, expected)
        if mode == AutoresetMode.DISABLED and step and step % 2 == 0:
            with pytest.raises(RuntimeError, match=r"episodes of 0, 1 have ended.*call reset\(options"):
                ours.step(forward)
            ours.reset(options=mask)
            theirs.reset(options=mask)
        seen, *ours_gave, info = ours.step(forward)
        expected, *theirs_gave, their_info = theirs.step(forward)
        assert np.array_equal(ours_gave, theirs_gave)
        ended = mode == AutoresetMode.SAME_STEP and step % 2 == 1
        assert ("final_obs" in info) == ("final_obs" in their_info) == ended
        if ended:  # all of them in the same step
            assert info.keys() == their_info.keys()
            assert info["final_obs"].dtype == their_info["final_obs"].dtype == object
            assert np.array_equal(np.stack(list(info["final_obs"])), np.stack(list(their_info["final_obs"])))
            final = info["final_info"]
            assert all(np.array_equal(final[key], value) for key, value in their_info["final_info"].items())
    ours.close()
    theirs.close()


@pytest.mark.parametrize("ident", [DUAL, MANY])
@pytest.mark.parametrize(
    "given", [{"wrappers": [RecordEpisodeStatistics]}, {"vector_kwargs": {"autoreset_mode": "SameStep"}}], ids=str
)
def test_what_threads_do_not_take_names_the_vector_that_does(ident: str, given: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="vectorization_mode='sync' or 'async'"):
        gymnasium.make_vec(ident, 2, **given, **arguments(ident))


def test_six_threads_in_one_environment_are_refused() -> None:
    """In a process of its own, which a fault of the native code would end."""
    code = f"""
import threading, gymnasium, cathsim
for ident, arguments in {[(ident, arguments(ident)) for ident in (DUAL, MANY)]!r}:
    env = gymnasium.make(ident, **arguments).unwrapped
    env.reset(seed=0)
    said = set()
    def use():
        for step in range(40):
            try:
                env.reset() if step % 20 == 19 else env.step(env.action_space.sample())
            except RuntimeError as error:
                said.add(str(error))
    threads = [threading.Thread(target=use) for _ in range(6)]
    [one.start() for one in threads], [one.join() for one in threads]
    assert len(said) == 1 and "another thread is using this environment" in said.pop(), said
    env.reset(seed=0)
    assert env.step(env.action_space.sample())[0].any()
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_actions_that_are_no_numbers_are_refused_in_a_sentence() -> None:
    torch = pytest.importorskip("torch")
    env = NavigateEnv(accuracy="fast", observation="tip")
    vector = ThreadedVectorEnv(2, accuracy="fast", observation="tip")
    env.reset(seed=0)
    vector.reset(seed=0)
    cases: list[tuple[Any, str]] = [
        (torch.zeros(2, requires_grad=True), "a Tensor"),
        ([torch.zeros((), requires_grad=True), 0.0], "got a list"),
        (torch.zeros(2, device="meta"), "a Tensor"),
        (torch.zeros(3), r"got \(3,\)"),
        (torch.tensor([float("nan"), 0.0]), "expected a finite action"),
        ([[1.0], [2.0, 3.0]], "got a list"),
        (["1", "0"], "real numbers"),
        (np.array([None, 1.0]), "real numbers"),
        (None, "got None"),
    ]
    for action, message in cases:
        with pytest.raises(ValueError, match=message) as said:
            env.step(action)
        assert "\n" not in str(said.value)
        with pytest.raises(ValueError, match=r"expected actions of shape \(2, 2\)"):
            vector.step(action)
    plain = env.step([0.5, 0.0])[1]
    env.reset(seed=0)
    assert env.step(torch.tensor([0.5, 0.0]))[1] == plain
    vector.close()


def test_channels_last_moves_the_channels_alone() -> None:
    chosen: dict[str, Any] = {"accuracy": "fast", "observation": ("image", "sequential", "tip"), "image_size": 32}
    first, last = NavigateEnv(**chosen), NavigateEnv(**chosen, channels_last=True)
    seen, moved = first.reset(seed=0)[0], last.reset(seed=0)[0]
    assert last.observation_space.contains(moved)
    for name, channels in (("image", 1), ("sequential", 3)):
        assert moved[name].shape == (32, 32, channels)
        assert np.array_equal(np.moveaxis(moved[name], -1, 0), seen[name])
    assert np.array_equal(moved["tip"], seen["tip"])


def test_wrappers_of_images_take_channels_last() -> None:
    pytest.importorskip("cv2")
    chosen = {"observation": "image", "image_size": 32, "channels_last": True}
    goals = gymnasium.make(GOAL, **arguments(GOAL, **chosen))
    assert goals.observation_space["observation"].shape == (32, 32, 1)
    env = gymnasium.make(MANY, **arguments(MANY, **chosen))
    smaller = ResizeObservation(env, (20, 24))
    seen, _ = smaller.reset(seed=0)
    assert seen.shape == smaller.observation_space.shape == (20, 24, 1)
    assert abs(float(seen.mean()) - float(env.unwrapped.observe().mean())) < 2
    stacked = FrameStackObservation(smaller, 4)
    assert stacked.reset(seed=0)[0].shape == (4, 20, 24, 1)


@pytest.mark.parametrize("last", [False, True])
def test_stable_baselines3_takes_both_orders(last: bool) -> None:
    pytest.importorskip("stable_baselines3")
    from stable_baselines3.common.env_checker import check_env as check
    from stable_baselines3.common.vec_env import DummyVecEnv, VecTransposeImage

    def make() -> NavigateEnv:
        return NavigateEnv(accuracy="fast", observation="image", image_size=40, channels_last=last)

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check(make(), warn=True)
    vector = DummyVecEnv([make])
    seen = (VecTransposeImage(vector) if last else vector).reset()
    assert seen.shape == (1, 1, 40, 40)


def test_a_window_without_a_screen_is_refused_and_leaves_opengl(monkeypatch: pytest.MonkeyPatch) -> None:
    """In a process of its own: OpenGL is a matter of the whole process."""
    pytest.importorskip("pygame")
    code = f"""
import gymnasium, cathsim
chosen = {arguments(ENVIRONMENT)!r}
try:
    gymnasium.make({ENVIRONMENT!r}, render_mode="human", **chosen)
except RuntimeError as error:
    print(error)
from cathsim.viewing.camera_view import RenderingUnavailableError, open_context
env = gymnasium.make({ENVIRONMENT!r}, render_mode="rgb_array", **chosen)
env.reset(seed=0)
print(env.render().shape)
"""
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(RuntimeError, match="render_mode='human' needs a screen"):
        gymnasium.make(ENVIRONMENT, render_mode="human", **arguments(ENVIRONMENT))
    own = {**os.environ, "DISPLAY": ":4711"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, env=own)
    if "3-D pictures need EGL" in done.stderr:
        pytest.skip("OpenGL does not draw here")
    *_, refused, shape = done.stdout.splitlines()
    assert refused.startswith("render_mode='human' needs a screen")
    assert shape == "(640, 480, 3)"
