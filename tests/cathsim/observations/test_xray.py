"""X-ray observations: images, clutter, views, masks of each device, the frame of the arch."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import binary_dilation

from cathsim import NavigateEnv, load_phantom
from cathsim.fluoroscopy import Projector, scene
from cathsim.fluoroscopy.attenuation import lumen_path_length
from cathsim.many_anatomies import NavigateManyEnv
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
from cathsim.observations.fluoroscopes import points_to_border, shown_points
from cathsim.observations.framing import arch_centre, field_projections, framed
from cathsim.observations.xray import XrayEnvironment, contrast_run
from tests.cathsim.makers import MakeEnv

FORWARD = np.array([1.0, 0.2], np.float32)


def environment(**further) -> XrayEnvironment:
    many = NavigateManyEnv((0, 1), ("lcca",), observation=("roadmap", "goal_image"), image_size=96, accuracy="fast")
    return XrayEnvironment(many, 96, **further)


def advanced(env: XrayEnvironment, steps: int) -> dict[str, np.ndarray]:
    """What is observed after some steps forwards in the first case."""
    observation, _ = env.reset(seed=3, options={"case": 0})
    for _ in range(steps):
        observation = env.step(FORWARD)[0]
    return observation


def test_observations_are_noisy_images_and_a_contrast_run_alone() -> None:
    env = environment()
    observation, info = env.reset(seed=3, options={"case": 0})
    assert set(observation) == {"roadmap", "goal_image", "image", "plain", "contrast"}
    assert env.observation_space.contains(observation)
    assert info["phantom"] == env.phantom.name
    for _ in range(10):
        observation = env.step(FORWARD)[0]
    images = [observation["image"].astype(float)]
    again = advanced(environment(with_mask=True), 10)
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
    lumen = lumen_path_length(env.phantom.grid, Projector.frontal(env.phantom.bounds, 96)) > 5e-3
    assert filled[0][lumen].mean() > 15
    assert abs((plain - images[0])[0][lumen].mean()) < 3


def test_a_background_of_ones_own_is_around_the_vessels() -> None:
    env = environment(background=scene("patient"))
    observation, bath = advanced(env, 0), advanced(environment(), 0)
    for name in ("image", "plain", "contrast"):
        assert np.abs(observation[name].astype(float) - bath[name]).mean() > 10
    lumen = lumen_path_length(env.phantom.grid, Projector.frontal(env.phantom.bounds, 96)) > 5e-3
    darker = observation["plain"][0].astype(float) - observation["contrast"][0]
    assert darker[lumen].mean() > darker[~lumen].mean() + 10  # the vessels are filled there, too


def stripes(generator: np.random.Generator, size: int) -> np.ndarray:
    dark = np.zeros((size, size), np.float32)
    dark[:, int(generator.integers(10, 40)) :: 24] = 0.8
    return dark


def test_clutter_stands_still_and_leaves_the_wire_darker() -> None:
    env = environment(with_mask=True, clutter=stripes)
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
    np.testing.assert_array_equal(seen["mask"], advanced(environment(with_mask=True), 15)["mask"])
    assert (plain - filled).max() > 15
    again, _ = env.reset(seed=3, options={"case": 0})
    np.testing.assert_array_equal(again["plain"], plain)
    assert not np.array_equal(env.reset(seed=4, options={"case": 0})[0]["plain"], plain)


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


@pytest.mark.parametrize("every", [1, 3])
def test_a_saved_moment_goes_on_alike_with_its_noise_and_clutter(every: int) -> None:
    one, other = (environment(clutter=stripes, every=every, with_mask=True) for _ in range(2))
    one.reset(seed=4, options={"case": 0})
    for _ in range(4):
        seen = one.step(FORWARD)[0]
    other.reset(seed=9, options={"case": 1})
    restored = other.restore(pickle.loads(pickle.dumps(one.state())))
    assert restored.keys() == seen.keys() == other.observation_space.spaces.keys()
    for _ in range(3):
        for name in seen:
            np.testing.assert_array_equal(seen[name], restored[name], err_msg=name)
            np.testing.assert_array_equal(seen[name], one.observe()[name])
        seen, restored = one.step(FORWARD)[0], other.step(FORWARD)[0]


def test_what_is_no_saved_moment_is_one_sentence() -> None:
    env = environment()
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"expected what env.state\(\) gave, got dict without clutter, dots, "):
        env.restore({})


def test_it_renders_as_its_environment_and_gives_images_of_its_own() -> None:
    inner = NavigateEnv(load_phantom("type_1"), observation=("tip",), render_mode="fluoroscopy", accuracy="fast")
    env = XrayEnvironment(inner, 64)
    seen, _ = env.reset(seed=1)
    assert env.render_mode == "fluoroscopy" in env.metadata["render_modes"]
    assert env.render().ndim == 3
    before = seen["plain"].copy()
    seen["plain"][:] = 0
    np.testing.assert_array_equal(env.reset(seed=1)[0]["plain"], before)


def test_several_views_show_the_same_moment() -> None:
    two = environment(with_mask=True, views=("frontal", "lao_45"))
    seen, alone = advanced(two, 15), advanced(environment(with_mask=True), 15)
    assert two.observation_space.contains(seen)
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


def test_a_field_shows_the_arch_as_large_as_it_is() -> None:
    env = environment(with_mask=True, field=0.16)
    seen = advanced(env, 25)
    assert env.observation_space.contains(seen)
    camera = framed(env.phantom, "frontal", 96, 0.16)
    column, row = camera.project(env.task.goal(env.phantom)[None])[0]
    assert seen["goal_image"][0, round(row), round(column)] == 255
    column, row = camera.project(env.simulation.wire_points()[2:3])[0]
    assert seen["mask"][0, round(row), round(column)] == 255
    assert not np.array_equal(seen["plain"], advanced(environment(with_mask=True), 1)["plain"])


ARMS = CArms(("a",), 256)


def test_images_of_a_logged_shape_are_those_of_the_environment() -> None:
    phantom = load_phantom("type_1")
    environment = c_arm_environment(phantom, "bca", ARMS, ("tip",))
    environment.reset(seed=3)
    for _ in range(20):
        environment.step(np.array([1.0, 0.3]))
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


MASKS = ("mask", "mask_wire", "mask_catheter")


def test_masks_are_those_of_each_device(make_env: MakeEnv) -> None:
    env = make_env(catheter="vertebral", observation=("image", *MASKS), image_size=256, target="lcca")
    env.reset(seed=0)
    for _ in range(40):
        observation, *_ = env.step(np.array([1.0, 0.2, 0.4, 0.2]))
    shown = {name: observation[name][0] > 0 for name in MASKS}
    assert np.array_equal(shown["mask"], shown["mask_wire"] | shown["mask_catheter"])
    ahead = shown["mask_wire"] & ~shown["mask_catheter"]
    assert ahead.sum() > 20, "the wire is ahead"
    assert (shown["mask_catheter"] & shown["mask_wire"]).sum() > 20, "and shows within the catheter"
    projector = env.fluoroscope.renderer.projector
    for name in ("wire", "catheter"):
        points = projector.project(shown_points(env.simulation, name))
        tip = np.rint(points[0]).astype(int)
        assert shown[f"mask_{name}"][tip[1] - 1 : tip[1] + 2, tip[0] - 1 : tip[0] + 2].any()
    passed = env.fluoroscope.image() / env.fluoroscope.renderer.background
    tube = np.median(passed[shown["mask_catheter"] & ~shown["mask_wire"]])
    both, bare = np.median(passed[shown["mask_catheter"] & shown["mask_wire"]]), np.median(passed[ahead])
    assert both < bare < tube < 0.9, "the catheter is fainter than the wire, and its wall adds to it"


def test_a_catheter_alone_has_no_wire_in_its_images(make_env: MakeEnv) -> None:
    env = make_env(wire=None, catheter="vertebral", observation=MASKS, image_size=128)
    env.reset(seed=0)
    for _ in range(20):
        observation = env.step(np.array([1.0, 0.0]))[0]
    assert observation["mask_catheter"].any()
    assert not observation["mask_wire"].any()
    assert len(points_to_border(env.simulation, "wire")) == 0


FIELD, SIZE = 0.16, 160


def test_bad_views_and_fields_are_refused() -> None:
    phantom = load_phantom("type_1", resolution=2e-3)
    with pytest.raises(ValueError, match="unknown view 'above'"):
        framed(phantom, "above", 96, FIELD)
    with pytest.raises(ValueError, match="unknown view 'above'"):
        field_projections(("above",), FIELD)
    with pytest.raises(ValueError, match="field of view must be a positive length"):
        field_projections(("frontal",), 0.0)
    for field in (0.0, float("nan")):
        with pytest.raises(ValueError, match="the field of view must be a positive length"):
            framed(phantom, "frontal", 96, field)


def test_views_with_a_field_see_every_arch_by_the_same_matrices() -> None:
    views = ("frontal", "lao_45")
    matrices = field_projections(views, FIELD)
    assert matrices.shape == (2, 3, 4)
    for name in ("type_1", "bovine"):
        phantom = load_phantom(name, resolution=2e-3)
        points = np.stack([phantom.target(target).position for target in ("bca", "lcca", "lsa")])
        about = np.column_stack((points - arch_centre(phantom, FIELD), np.ones(len(points))))
        for view, matrix in zip(views, matrices, strict=True):
            flat = about @ matrix.T
            shares = (framed(phantom, view, SIZE, FIELD).project(points) + 0.5) / SIZE
            np.testing.assert_allclose(flat[:, :2] / flat[:, 2:], shares, atol=1e-9)
