"""Observations beside images: roadmap, history of the progress, tracking, vectors of the simulation."""

import numpy as np
import pytest

from cathsim.dual_device_nav import RandomTreesEnv
from cathsim.environment import NavigateEnv
from cathsim.observations.roadmap import PATH_ARCS, RAYS, WIRE_ARCS
from cathsim.observations.tracking import POINTS, SPACING, in_view, viewed_range
from tests.cathsim.makers import MakeEnv

FORWARD = np.array([1.0, 0.2])


@pytest.fixture(scope="module")
def environment() -> NavigateEnv:
    env = NavigateEnv("type_1", "lcca", observation=("roadmap", "goal", "goal_image", "tip"), image_size=96)
    env.reset(seed=0)
    for _ in range(60):
        env.step(FORWARD)
    return env


def test_the_way_leads_down_to_the_target(environment: NavigateEnv) -> None:
    place, target = environment.simulation.tip, environment.phantom.target("lcca").position
    expected = environment.phantom.geodesic_distance(place, "lcca")
    for _ in range(12):
        points, remaining = environment.roadmap.way(place)
        assert remaining == pytest.approx(float(environment.phantom.geodesic_distance(place, "lcca")), abs=1e-9)
        assert environment.phantom.grid.sample(points).min() > 0.5e-3
        place = points[19]
    assert np.linalg.norm(place - target) < 2e-3
    steps = np.linalg.norm(np.diff(environment.roadmap.way(environment.simulation.tip)[0], axis=0), axis=1)
    np.testing.assert_allclose(steps, 1e-3, atol=1e-6)
    assert environment.roadmap.way(environment.simulation.tip)[1] == pytest.approx(float(expected))


def test_walls_are_where_the_grid_says(environment: NavigateEnv) -> None:
    axes, tip = environment.roadmap.frame(), environment.simulation.tip
    lengths = environment.roadmap.walls(tip, axes)
    assert lengths.shape == (len(RAYS),)
    ends = tip + lengths[:, None] * (RAYS @ axes.T)
    free = lengths < 0.0299
    assert np.abs(environment.phantom.grid.sample(ends[free])).max() < 0.3e-3
    assert free.any()


def test_long_devices_are_shown_a_way_as_long_as_in_an_arch() -> None:
    env = RandomTreesEnv((4,), observation="roadmap")
    roadmap, info = env.reset(seed=0)
    lead, inserted = 67, np.array([53, 64])
    assert env.task.remaining(env.phantom, info["tip"]) > 0.5
    assert roadmap[21] == pytest.approx(0.15 / 0.2)
    assert roadmap[inserted] == pytest.approx(0.0, abs=0.01)
    for _ in range(60):
        roadmap, *_, info = env.step(np.array([1.0, 0.0, -1.0, 0.0]))
    assert info["lead"] > info["insertion"] - 0.01 > 0.25
    assert roadmap[[21, 53, lead]] == pytest.approx([0.15 / 0.2, (0.28 - 0.15) / 0.2, 0.12 / 0.2])
    assert roadmap[64] == pytest.approx(roadmap[53] - roadmap[lead])


def test_registration_noise_moves_the_map_but_not_the_wire(type_1) -> None:
    def roadmap(noise: float) -> np.ndarray:
        return NavigateEnv(type_1, "bca", observation="roadmap", registration_noise=noise).reset(seed=3)[0]

    wire = slice(3 * len(PATH_ARCS) + 2 + len(RAYS), 3 * len(PATH_ARCS) + 2 + len(RAYS) + 3 * len(WIRE_ARCS))
    displaced, exact = roadmap(2e-3), roadmap(0.0)
    np.testing.assert_array_equal(displaced, roadmap(2e-3))
    np.testing.assert_array_equal(displaced[wire], exact[wire])
    assert np.abs(displaced - exact)[: wire.start].max() > 0.01
    with pytest.raises(ValueError, match="registration_noise must lie in"):
        roadmap(-1.0)


def test_history_measures_the_way_left_on_the_displaced_roadmap(type_1) -> None:
    env = NavigateEnv(type_1, "bca", observation=("roadmap", "history"), registration_noise=4e-3)
    for seed in range(5):
        env.reset(seed=seed)
        left = env.sensors.way_left()
        tip = env.simulation.tip
        assert left == env.task.remaining(env.phantom, tip + env.roadmap.offset) != env.task.remaining(type_1, tip)
        assert 0 < left < 0.5
    env = NavigateEnv(type_1, "bca", observation="history")
    env.reset(seed=0)
    assert env.sensors.way_left() == env.task.remaining(type_1, env.simulation.tip)


def test_dot_lies_on_the_target(environment: NavigateEnv) -> None:
    seen, target = environment.observe(), environment.phantom.target("lcca").position
    np.testing.assert_allclose(seen["goal"], target, atol=1e-7)
    dot = seen["goal_image"][0].astype(float)
    rows, columns = np.mgrid[: dot.shape[0], : dot.shape[1]]
    centre = np.array([(dot * columns).sum(), (dot * rows).sum()]) / dot.sum()
    pixel = environment.fluoroscope.renderer.projector.project(target[None])[0]
    np.testing.assert_allclose(centre, pixel, atol=0.1)


def test_points_lie_on_the_wire_two_millimetres_apart(type_1) -> None:
    env = NavigateEnv(type_1, "lcca", observation="tracking")
    env.reset(seed=1)
    for _ in range(20):
        observation, *_ = env.step(np.array([1.0, 0.3]))
    low, high = viewed_range(type_1)
    seen = low + (observation[:14].reshape(7, 2) + 1) / 2 * (high - low)
    assert seen[0] == pytest.approx(in_view(env.simulation.tip), abs=1e-6)
    assert np.linalg.norm(np.diff(seen[:POINTS], axis=0), axis=1) == pytest.approx(SPACING, rel=0.05)
    assert seen[6] == pytest.approx(in_view(env.goal), abs=1e-6)
    assert observation[14:] == pytest.approx([1.0, 0.3])
    assert np.abs(observation).max() <= 1


def test_vectors_are_those_of_the_simulation_and_internal_holds_what_the_thesis_lists(make_env: MakeEnv) -> None:
    env = make_env(observation=("joints", "shape", "tip", "feeder", "force", "internal"))
    simulation = env.simulation
    env.reset(seed=0)
    for _ in range(60):
        seen, *_, info = env.step(np.array([1.0, 0.4]))
    positions, velocities = seen["joints"].reshape(2, -1)
    assert positions == pytest.approx(simulation.joint_positions(), abs=1e-6)
    assert velocities == pytest.approx(simulation.joint_velocities(), rel=1e-6, abs=1e-6)
    assert positions[0] == pytest.approx(simulation.insertion)
    assert seen["feeder"] == pytest.approx(
        [simulation.insertion, np.cos(simulation.rotation), np.sin(simulation.rotation)], abs=1e-6
    )
    assert seen["tip"] == pytest.approx(simulation.tip, abs=1e-7)
    assert seen["shape"][0] == pytest.approx(simulation.tip, abs=1e-7)
    assert seen["force"] == pytest.approx(info["force_vector"], abs=1e-6)
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
