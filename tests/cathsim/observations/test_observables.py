"""What an agent sees: values of the observables against the simulation and against MuJoCo."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from cathsim import NavigateEnv
from cathsim.observations.fluoroscopes import SHOWN_SHEATH, camera, outside_sheath, shown_points

MakeEnv = Callable[..., NavigateEnv]


def advanced(env: NavigateEnv, steps: int = 60) -> dict[str, np.ndarray]:
    """The last of some steps forwards with rotation."""
    env.reset(seed=0)
    for _ in range(steps):
        observation, *_, info = env.step(np.array([1.0, 0.4]))
    return {**observation, "info": info}


def test_vectors_are_those_of_the_simulation(make_env: MakeEnv) -> None:
    env = make_env(observation=("joints", "shape", "tip", "feeder", "force"))
    seen, simulation = advanced(env), env.simulation
    positions, velocities = seen["joints"].reshape(2, -1)
    assert positions == pytest.approx(simulation.joint_positions(), abs=1e-6)
    assert velocities == pytest.approx(simulation.joint_velocities(), rel=1e-6, abs=1e-6)
    assert positions[0] == pytest.approx(simulation.insertion)
    assert seen["feeder"] == pytest.approx(
        [simulation.insertion, np.cos(simulation.rotation), np.sin(simulation.rotation)], abs=1e-6
    )
    assert seen["tip"] == pytest.approx(simulation.tip, abs=1e-7)
    assert seen["shape"][0] == pytest.approx(simulation.tip, abs=1e-7)
    assert seen["force"] == pytest.approx(seen["info"]["force_vector"], abs=1e-6)


def test_internal_holds_what_the_thesis_lists(make_env: MakeEnv) -> None:
    env = make_env(observation=("internal", "joints"))
    seen, simulation = advanced(env), env.simulation
    nq, bodies = simulation.nq, len(simulation.wire.links)
    joints, actuator, rest = np.split(seen["internal"], [2 * nq, 3 * nq])
    assert np.array_equal(joints, seen["joints"])
    assert actuator[:2] == pytest.approx(simulation.data.qfrc_actuator[:2], rel=1e-6)
    assert not actuator[2:].any(), "only the feeder is actuated"
    per_body = rest.reshape(bodies, 22)
    waiting = bodies - simulation.active_links
    assert waiting > 0
    assert not per_body[1 : 1 + waiting].any(), "links that are not simulated yet"
    # column 9 of MuJoCo's com-based inertia is the mass; the feeder's body carries the first link
    assert per_body[0, 9] == pytest.approx(simulation.model.body_mass[1], rel=1e-6)
    assert per_body[1 + waiting :, 9] == pytest.approx(simulation.model.body_mass[2:], rel=1e-6)
    assert np.abs(per_body[:, 16:]).max() > 1e-3, "external forces of contact"


def test_image_shows_the_wire_where_the_mask_is(make_env: MakeEnv) -> None:
    env = make_env(observation=("image", "mask"), image_size=128)
    seen = advanced(env)
    image, mask = seen["image"][0], seen["mask"][0]
    background = env.fluoroscope.renderer.background
    assert set(np.unique(mask)) == {0, 255}
    assert (image[mask > 0].astype(int) <= background[mask > 0]).all()
    assert (background[mask > 0].astype(int) - image[mask > 0]).mean() > 20
    grown = mask > 0
    for axis in (0, 1):
        grown = grown | np.roll(grown, 1, axis) | np.roll(grown, -1, axis)
    assert np.array_equal(image[~grown], background[~grown])


def test_the_tip_lies_in_the_mask(make_env: MakeEnv) -> None:
    env = make_env(observation="mask", image_size=128)
    env.reset(seed=0)
    for _ in range(60):
        mask = env.step(np.array([1.0, 0.4]))[0][0]
    u, v = env.fluoroscope.renderer.projector.project(env.simulation.tip[None])[0].round().astype(int)
    assert mask[v, u] == 255


def test_sequence_is_the_last_three_images_oldest_first(make_env: MakeEnv) -> None:
    env = make_env(observation=("sequential", "image"))
    observation, _ = env.reset(seed=0)
    images = [observation["image"][0]] * 3
    assert np.array_equal(observation["sequential"], np.stack(images))
    for _ in range(5):
        observation, *_ = env.step(np.array([1.0, 1.0]))
        images = [*images[1:], observation["image"][0]]
        assert np.array_equal(observation["sequential"], np.stack(images))
        assert np.array_equal(env.observe()["sequential"], np.stack(images)), "a second look is no new frame"
    assert not np.array_equal(images[0], images[2])
    observation, _ = env.reset(seed=0)
    assert np.array_equal(observation["sequential"], np.stack([observation["image"][0]] * 3))


def test_the_sheath_is_drawn_a_centimetre_deep(make_env: MakeEnv) -> None:
    env = make_env()
    env.reset(seed=0)
    vessel = env.simulation.vessel
    points = shown_points(env.simulation)
    along = (points - vessel.entry) @ vessel.direction
    assert along[-1] == pytest.approx(-SHOWN_SHEATH)
    assert along[:-1].min() > -SHOWN_SHEATH
    assert np.array_equal(points, outside_sheath(env.simulation.inserted_points(), vessel))


def test_cameras_are_shared_by_environments_on_one_phantom(make_env: MakeEnv) -> None:
    one, other = make_env(), make_env(target="lcca")
    assert one.fluoroscope.renderer is other.fluoroscope.renderer
    assert one.fluoroscope.renderer is camera(one.phantom, 80, one.simulation.wire.radius)
    assert make_env(image_size=96).fluoroscope.renderer is not one.fluoroscope.renderer


def test_looking_changes_nothing(make_env: MakeEnv) -> None:
    blind, seeing = make_env(observation="tip"), make_env(observation=("internal", "sequential", "mask"))
    for env in (blind, seeing):
        env.reset(seed=0)
    for _ in range(50):
        blind.step(np.array([1.0, -0.5]))
        seeing.step(np.array([1.0, -0.5]))
        seeing.observe()
    assert np.array_equal(blind.simulation.state(), seeing.simulation.state())
