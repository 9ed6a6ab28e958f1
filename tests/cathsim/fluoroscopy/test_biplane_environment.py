"""Bi-planar views of the environment: observations, determinism, logs, and that they leave the rest alone."""

from pathlib import Path

import numpy as np
import pytest

from cathsim.observations.fluoroscopes import points_to_border

NAMES = ("image_a", "mask_a", "image_b", "mask_b")


def test_observations_match_their_spaces_and_repeat(make_env):
    env = make_env(cameras="guide3d", observation=(*NAMES, "image"), image_size=64)
    runs = []
    for _ in range(2):
        observation, _ = env.reset(seed=3)
        steps = [observation] + [env.step(np.array([1.0, 0.4]))[0] for _ in range(4)]
        runs.append(steps)
    for one, other in zip(*runs, strict=True):
        assert env.observation_space.contains(one)
        for name in one:
            np.testing.assert_array_equal(one[name], other[name])
    first, second = runs[0][0], runs[0][1]
    assert (first["image_a"] != second["image_a"]).mean() > 0.3  # noise is new in every step
    assert set(np.unique(first["mask_a"])) == {0, 255}
    observation, _ = env.reset(seed=4)
    assert (observation["image_a"] != first["image_a"]).mean() > 0.3


def test_one_camera_alone_gives_the_same_image(make_env):
    both = make_env(cameras="guide3d", observation=NAMES, image_size=48)
    one = make_env(cameras="guide3d", observation="image_b", image_size=48)
    expected, _ = both.reset(seed=1)
    image, _ = one.reset(seed=1)
    np.testing.assert_array_equal(image, expected["image_b"])


def test_cameras_change_nothing_else(make_env):
    plain = make_env(observation=("tip", "image"))
    biplane = make_env(observation=("tip", "image"), cameras="clinical")
    for env in (plain, biplane):
        env.reset(seed=2)
    for action in np.random.default_rng(0).uniform(-1, 1, (5, 2)):
        action[0] = 1.0
        one, other = plain.step(action)[0], biplane.step(action)[0]
        np.testing.assert_array_equal(one["tip"], other["tip"])
        np.testing.assert_array_equal(one["image"], other["image"])


def test_wire_reaches_from_the_tip_to_the_border(make_env):
    env = make_env(cameras="guide3d", observation="mask_b", image_size=128)
    env.reset(seed=0)
    mask = env.step(np.array([1.0, 0.0]))[0][0]
    points = points_to_border(env.simulation)
    np.testing.assert_array_equal(points[0], env.simulation.tip)
    assert mask[:, 0].any()  # the head is on the right, the wire comes from the left
    u, v = env.biplane.fluoroscope.cameras["b"].pixels(env.simulation.tip[None])[0].round().astype(int)
    assert mask[v - 1 : v + 2, u - 1 : u + 2].any()
    behind = (env.simulation.vessel.entry - points[-1]) @ env.simulation.vessel.direction
    assert behind > 0.11


def test_unknown_cameras_are_refused(make_env):
    with pytest.raises(ValueError, match="pass cameras="):
        make_env(observation="image_a")
    with pytest.raises(ValueError, match="the cameras give image_a, mask_a"):
        make_env(observation="image_left", cameras="guide3d", image_size=32)
    with pytest.raises(ValueError, match="unknown geometry"):
        make_env(cameras="x-wing", image_size=32)


def test_log_holds_every_camera(make_env, tmp_path: Path):
    pytest.importorskip("mcap")
    from pipeline.episodes import EpisodeReader
    from pipeline.recording.record import record_episode

    env = make_env(cameras="guide3d", observation="tip", image_size=48, max_steps=3)
    path = tmp_path / "episode.mcap"
    record_episode(env, lambda observation, info: np.array([1.0, 0.0]), path, seed=0, operator="test")
    with EpisodeReader(path) as log:
        assert set(log.cameras) == {"frontal", "a", "b"}
        arrays, info = log.load_arrays(), log.info
        np.testing.assert_allclose(log.camera("b").P, env.biplane.fluoroscope.cameras["b"].projector.P)
    assert arrays["image/a"].shape == arrays["mask/b"].shape == (4, 48, 48)
    np.testing.assert_array_equal(arrays["image/a"][-1], env.biplane.frame("a").image)
    np.testing.assert_array_equal(arrays["mask/b"][-1], env.biplane.frame("b").mask)
    assert info.configuration["cameras"]["a"]["distortion"]["pincushion"] > 0
