"""X-ray images as observations: noise, contrast run, and nothing else that shows the wire."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import binary_dilation

from cathsim.fluoroscopy import Projector, scene
from cathsim.many_anatomies import NavigateManyEnv
from cathsim.observations.xray import XrayEnvironment, contrast_run

FORWARD = np.array([1.0, 0.2], np.float32)


def environment(**further) -> XrayEnvironment:
    many = NavigateManyEnv((0, 1), ("lcca",), observation=("roadmap", "goal_image"), image_size=96, accuracy="fast")
    return XrayEnvironment(many, 96, **further)


def test_observations_are_noisy_images_and_a_contrast_run_alone() -> None:
    env = environment()
    observation, info = env.reset(seed=3, options={"case": 0})
    assert set(observation) == {"roadmap", "goal_image", "image", "plain", "contrast"}
    assert env.observation_space.contains(observation)
    assert info["phantom"] == env.phantom.name
    for _ in range(10):
        observation = env.step(FORWARD)[0]
    images = [observation["image"].astype(float)]
    again, _ = (twin := environment(with_mask=True)).reset(seed=3, options={"case": 0})
    for _ in range(10):
        again = twin.step(FORWARD)[0]
    np.testing.assert_array_equal(observation["image"], again["image"])
    # the noise is another one in every step, and the lumen is not filled while the wire moves
    images.append(env.step(0 * FORWARD)[0]["image"].astype(float))
    lit = images[0] > 40
    # as much of one image as real ones of this size have, and half as much again (docs/results/simulator.md)
    assert 0.35 < np.std((images[0] - images[1])[lit]) / np.sqrt(2) < 0.7
    plain, contrast = contrast_run(env.phantom, 96, env.simulation.wire.radius)
    filled = plain.astype(float) - contrast
    # the mean of 16 images has hardly any noise beside that of one, where no wire is
    away = lit & (binary_dilation(again["mask"][0], iterations=3)[None] == 0)
    beside_rounding = [np.var((images[0] - other)[away]) - 1 / 6 for other in (plain, images[1])]
    assert np.sqrt(beside_rounding[0]) < 0.8 * np.sqrt(beside_rounding[1])
    from cathsim.fluoroscopy.attenuation import lumen_path_length

    lumen = lumen_path_length(env.phantom.grid, Projector.frontal(env.phantom.bounds, 96)) > 5e-3
    assert filled[0][lumen].mean() > 15
    assert abs((plain - images[0])[0][lumen].mean()) < 3


def test_a_room_of_ones_own_is_around_the_vessels() -> None:
    from cathsim.fluoroscopy.attenuation import lumen_path_length

    env = environment(room=scene("patient"))
    observation, _ = env.reset(seed=3, options={"case": 0})
    bath, _ = environment().reset(seed=3, options={"case": 0})
    for name in ("image", "plain", "contrast"):
        assert np.abs(observation[name].astype(float) - bath[name]).mean() > 10
    lumen = lumen_path_length(env.phantom.grid, Projector.frontal(env.phantom.bounds, 96)) > 5e-3
    darker = observation["plain"][0].astype(float) - observation["contrast"][0]
    assert darker[lumen].mean() > darker[~lumen].mean() + 10  # the vessels are filled there, too


def test_masks_show_the_wire_where_asked_for() -> None:
    env = environment(with_mask=True)
    observation, _ = env.reset(seed=0, options={"case": 1})
    for _ in range(20):
        observation = env.step(FORWARD)[0]
    wire = observation["mask"][0] > 0
    darker = observation["plain"][0].astype(float) - observation["image"][0]
    assert darker[wire].mean() > 5 * abs(darker[~wire].mean())
    assert env.observation_space.contains(observation)


def stripes(generator: np.random.Generator, size: int) -> np.ndarray:
    dark = np.zeros((size, size), np.float32)
    dark[:, int(generator.integers(10, 40)) :: 24] = 0.8
    return dark


def test_clutter_stands_still_and_leaves_the_wire_darker() -> None:
    env, clean = environment(with_mask=True, clutter=stripes), environment(with_mask=True)
    seen, _ = env.reset(seed=3, options={"case": 0})
    plain, filled = seen["plain"].astype(float), seen["contrast"].astype(float)
    assert np.std(plain.mean(axis=(0, 1))) > 8
    for _ in range(15):
        seen = env.step(FORWARD)[0]
    np.testing.assert_array_equal(seen["plain"], plain)
    wire = seen["mask"][0] > 0
    darker = plain[0] - seen["image"][0]
    assert darker[wire].mean() > 5 * abs(darker[~wire].mean())
    # the same wire as without clutter, and vessels that the contrast medium still darkens
    other, _ = clean.reset(seed=3, options={"case": 0})
    for _ in range(15):
        other = clean.step(FORWARD)[0]
    np.testing.assert_array_equal(seen["mask"], other["mask"])
    assert (plain - filled).max() > 15
    again, _ = env.reset(seed=3, options={"case": 0})
    np.testing.assert_array_equal(again["plain"], plain)
    assert not np.array_equal(env.reset(seed=4, options={"case": 0})[0]["plain"], plain)


def test_clutter_of_another_size_is_refused() -> None:
    env = environment(clutter=lambda generator, size: np.zeros((8, 8), np.float32))
    with pytest.raises(ValueError, match=r"clutter must have shape \(96, 96\)"):
        env.reset(seed=0)


def test_pulsed_images_are_those_of_every_step() -> None:
    every, pulsed = environment(clutter=stripes), environment(clutter=stripes, every=3)
    for seed in (4, 5):
        shown, kept = every.reset(seed=seed, options={"case": 0})[0], pulsed.reset(seed=seed, options={"case": 0})[0]
        for step in range(1, 8):
            np.testing.assert_array_equal(shown["roadmap"], kept["roadmap"])
            if step % 3 == 1:
                last = shown["image"]
            np.testing.assert_array_equal(kept["image"], last)
            shown, kept = every.step(FORWARD)[0], pulsed.step(FORWARD)[0]
    with pytest.raises(ValueError, match="at least 1"):
        environment(every=0)


def test_several_views_show_the_same_moment() -> None:
    two, one = environment(with_mask=True, views=("frontal", "lao_45")), environment(with_mask=True)
    seen, _ = two.reset(seed=3, options={"case": 0})
    alone, _ = one.reset(seed=3, options={"case": 0})
    assert two.observation_space.contains(seen)
    for _ in range(15):
        seen, alone = two.step(FORWARD)[0], one.step(FORWARD)[0]
    for name in ("image", "plain", "contrast", "mask", "goal_image"):
        assert seen[name].shape == (2, 96, 96), name
        np.testing.assert_array_equal(seen[name][:1], alone[name])
    darkened = []
    for view, name in enumerate(two.views):
        projector = Projector.view(name, two.phantom.bounds, 96)
        column, row = projector.project(two.task.goal(two.phantom)[None])[0]
        assert seen["goal_image"][view, round(row), round(column)] == 255
        column, row = projector.project(two.simulation.wire_points()[2:3])[0]
        assert seen["mask"][view, round(row), round(column)] == 255
        darker = seen["plain"][view].astype(float) - seen["image"][view]
        on = seen["mask"][view] > 0
        assert darker[on].mean() > 10 * darker[~on].std()
        darkened.append(darker[on])
    assert np.concatenate(darkened).mean() > 10


def test_clutter_is_another_in_each_view() -> None:
    env = environment(clutter=stripes, views=("frontal", "lateral"))
    seen, _ = env.reset(seed=3, options={"case": 0})
    edges = [np.abs(np.diff(picture.astype(float).mean(axis=0))).argmax() for picture in seen["plain"]]
    assert edges[0] != edges[1]


@pytest.mark.parametrize("views", [(), ("frontal", "frontal"), ("above",)])
def test_views_are_checked(views: tuple[str, ...]) -> None:
    with pytest.raises(ValueError, match="views must be some of frontal, lateral"):
        environment(views=views)


def test_a_field_shows_the_arch_as_large_as_it_is() -> None:
    from cathsim.observations.framing import framed

    env = environment(with_mask=True, field=0.16)
    seen, _ = env.reset(seed=3, options={"case": 0})
    assert env.observation_space.contains(seen)
    for _ in range(25):
        seen = env.step(FORWARD)[0]
    camera = framed(env.phantom, "frontal", 96, 0.16)
    column, row = camera.project(env.task.goal(env.phantom)[None])[0]
    assert seen["goal_image"][0, round(row), round(column)] == 255
    column, row = camera.project(env.simulation.wire_points()[2:3])[0]
    assert seen["mask"][0, round(row), round(column)] == 255
    whole = environment(with_mask=True)
    whole.reset(seed=3, options={"case": 0})
    assert not np.array_equal(seen["plain"], whole.step(FORWARD)[0]["plain"])


@pytest.mark.parametrize("field", [0.0, -0.18, float("nan")])
def test_a_field_that_cannot_be_is_refused(field: float) -> None:
    with pytest.raises(ValueError, match="the field of view must be a positive length"):
        environment(field=field)
