"""What fluoroscopes show of a wire in a catheter: images, and a mask of each device."""

from __future__ import annotations

import copy
from collections.abc import Callable

import numpy as np
import pytest

from cathsim import NavigateEnv
from cathsim.observations.fluoroscopes import SHOWN_SHEATH, Fluoroscope, points_to_border, shown_points
from cathsim.observations.xray import XrayEnvironment

MakeEnv = Callable[..., NavigateEnv]
MASKS = ("mask", "mask_wire", "mask_catheter")


def seen(env: NavigateEnv, wire: float = 1.0, catheter: float = 0.4, steps: int = 40) -> dict[str, np.ndarray]:
    """The last of some steps in which both devices are advanced."""
    env.reset(seed=0)
    for _ in range(steps):
        observation, *_ = env.step(np.array([wire, 0.2, catheter, 0.2]))
    return dict(observation)


def test_masks_are_those_of_each_device(make_env: MakeEnv) -> None:
    env = make_env(catheter="vertebral", observation=("image", *MASKS), image_size=256, target="lcca")
    shown = {name: value[0] > 0 for name, value in seen(env).items() if name in MASKS}
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


def test_cameras_give_masks_of_each_device(make_env: MakeEnv) -> None:
    names = ("image_a", "mask_a", "mask_wire_a", "mask_catheter_a", "mask_wire_b")
    env = make_env(catheter="simmons2", observation=names, cameras="guide3d", image_size=128, target="lcca")
    shown = {name: value[0] > 0 for name, value in seen(env).items()}
    assert np.array_equal(shown["mask_a"], shown["mask_wire_a"] | shown["mask_catheter_a"])
    assert (shown["mask_wire_a"] & ~shown["mask_catheter_a"]).any()
    assert shown["mask_wire_b"].any()
    assert not np.array_equal(shown["mask_wire_a"], shown["mask_wire_b"])


def test_of_a_bare_wire_the_wires_mask_is_the_mask(make_env: MakeEnv) -> None:
    env = make_env(observation=("mask", "mask_wire", "mask_a", "mask_wire_a"), cameras="guide3d", image_size=64)
    env.reset(seed=0)
    observation = env.step(np.array([1.0, 0.0]))[0]
    assert observation["mask"].any()
    assert np.array_equal(observation["mask"], observation["mask_wire"])
    assert np.array_equal(observation["mask_a"], observation["mask_wire_a"])


@pytest.mark.parametrize("name", ["mask_catheter", "mask_catheter_a"])
def test_of_a_bare_wire_a_catheters_mask_is_refused(make_env: MakeEnv, name: str) -> None:
    with pytest.raises(ValueError, match="the mask of a catheter needs a catheter: pass catheter='vertebral'"):
        make_env(observation=name, cameras="guide3d", image_size=64)


def test_a_catheter_alone_has_no_wire_in_its_images(make_env: MakeEnv) -> None:
    env = make_env(wire=None, catheter="vertebral", observation=MASKS, image_size=128)
    env.reset(seed=0)
    for _ in range(20):
        observation = env.step(np.array([1.0, 0.0]))[0]
    assert observation["mask_catheter"].any()
    assert not observation["mask_wire"].any()
    assert len(points_to_border(env.simulation, "wire")) == 0


def test_copies_draw_the_same(make_env: MakeEnv) -> None:
    names = ("image", "mask_catheter", "image_a")
    env = make_env(catheter="vertebral", observation=names, image_size=64, cameras="guide3d")
    seen(env, steps=5)
    other = copy.deepcopy(env)
    action = np.array([1.0, 0.1, 1.0, 0.1])
    first, second = env.step(action)[0], other.step(action)[0]
    assert all(np.array_equal(first[name], second[name]) for name in names)


def test_shown_points_end_in_the_sheath(make_env: MakeEnv) -> None:
    env = make_env(catheter="vertebral", observation="tip")
    env.reset(seed=0)
    vessel = env.simulation.vessel
    for device in ("wire", "catheter"):
        end = shown_points(env.simulation, device)[-1]
        assert (vessel.entry - end) @ vessel.direction == pytest.approx(SHOWN_SHEATH)
        border = points_to_border(env.simulation, device)
        assert (vessel.entry - border[-1]) @ vessel.direction > 0.1


def test_a_larger_catheter_darkens_more(make_env: MakeEnv) -> None:
    darkness = []
    for name in ("straight_4f", "straight_6f"):
        env = make_env(catheter=name, observation="tip")
        env.reset(seed=0)
        for _ in range(30):
            env.step(np.array([0.0, 0.0, 1.0, 0.0]))
        fluoroscope = Fluoroscope(env.simulation, 256)
        image = fluoroscope.image().astype(float)
        darkness.append((fluoroscope.renderer.background - image).sum())
    assert darkness[1] > 1.2 * darkness[0]


def test_x_ray_observations_have_a_mask_of_each_device(make_env: MakeEnv) -> None:
    env = XrayEnvironment(make_env(catheter="vertebral", observation=("tip",)), 96, with_mask=True)
    env.reset(seed=0)
    for _ in range(10):
        observation, *_ = env.step(np.array([1.0, 0.0, 0.3, 0.0]))
    assert env.observation_space.contains(observation)
    assert np.array_equal(observation["mask"], observation["mask_wire"] | observation["mask_catheter"])
    assert observation["mask_wire"].any()
