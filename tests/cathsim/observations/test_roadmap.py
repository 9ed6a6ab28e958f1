"""The local roadmap: the way, the walls and the wire in the tip's frame, and the observations that know the target."""

from __future__ import annotations

import numpy as np
import pytest

from cathsim.environment import NavigateEnv
from cathsim.observations.roadmap import PATH_ARCS, RAYS, ROADMAP_SIZE, WIRE_ARCS, Roadmap, target_image

FORWARD = np.array([1.0, 0.2])


@pytest.fixture
def environment(type_1) -> NavigateEnv:
    env = NavigateEnv(type_1, "lcca", observation=("roadmap", "goal", "goal_image", "tip"), image_size=96)
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


def test_the_frame_goes_along_the_wire(environment: NavigateEnv) -> None:
    axes, points = environment.roadmap.frame(), environment.simulation.inserted_points()
    np.testing.assert_allclose(axes.T @ axes, np.eye(3), atol=1e-9)
    ahead = points[0] - points[1]
    np.testing.assert_allclose(axes[:, 2], ahead / np.linalg.norm(ahead), atol=1e-9)
    free = NavigateEnv(environment.phantom, "lcca", observation="tip")
    free.reset(seed=1)
    # the unloaded tip is bent about x towards -y: what lies behind it lies at -y too
    behind = (free.simulation.inserted_points()[4] - free.simulation.tip) @ free.roadmap.frame()
    assert behind[1] < -1e-3
    assert abs(behind[0]) < 1e-3


def test_observation_is_of_the_order_of_one_and_follows_the_rotation(environment: NavigateEnv) -> None:
    seen = environment.roadmap.read()
    assert seen.shape == (ROADMAP_SIZE,)
    assert seen.dtype == np.float32
    assert np.isfinite(seen).all()
    assert np.abs(seen).max() <= 3.0
    first = seen[: 3 * len(PATH_ARCS)].reshape(-1, 3)
    assert np.linalg.norm(first, axis=1).max() <= 1.001
    wire = seen[3 * len(PATH_ARCS) + 2 + len(RAYS) :][: 3 * len(WIRE_ARCS)].reshape(-1, 3)
    assert (wire[:4, 2] < 0).all()  # the wire lies behind


def test_registration_noise_moves_the_map_but_not_the_wire(type_1) -> None:
    def roadmap(noise: float, seed: int) -> np.ndarray:
        env = NavigateEnv(type_1, "bca", observation="roadmap", registration_noise=noise)
        return env.reset(seed=seed)[0]

    wire = slice(3 * len(PATH_ARCS) + 2 + len(RAYS), 3 * len(PATH_ARCS) + 2 + len(RAYS) + 3 * len(WIRE_ARCS))
    np.testing.assert_array_equal(roadmap(2e-3, 3), roadmap(2e-3, 3))
    np.testing.assert_array_equal(roadmap(2e-3, 3)[wire], roadmap(0.0, 3)[wire])
    assert np.abs(roadmap(2e-3, 3) - roadmap(0.0, 3))[: wire.start].max() > 0.01
    with pytest.raises(ValueError, match=r"registration_noise must lie in 0 to 0.1 m, got -1.0"):
        roadmap(-1.0, 0)


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


def test_state_keeps_the_registration(type_1) -> None:
    env = NavigateEnv(type_1, "bca", observation="roadmap", registration_noise=2e-3)
    env.reset(seed=3)
    env.step(FORWARD)
    state = env.state()
    after = env.step(FORWARD)[0]
    env.reset(seed=4)
    env.restore(state)
    np.testing.assert_array_equal(env.step(FORWARD)[0], after)


def test_dot_lies_on_the_target(environment: NavigateEnv) -> None:
    seen, target = environment.observe(), environment.phantom.target("lcca").position
    np.testing.assert_allclose(seen["goal"], target, atol=1e-7)
    dot = seen["goal_image"][0].astype(float)
    rows, columns = np.mgrid[: dot.shape[0], : dot.shape[1]]
    centre = np.array([(dot * columns).sum(), (dot * rows).sum()]) / dot.sum()
    pixel = environment.fluoroscope.renderer.projector.project(target[None])[0]
    np.testing.assert_allclose(centre, pixel, atol=0.1)


def test_dot_has_its_size() -> None:
    dot = target_image(np.array([20.0, 10.0]), 40, 3.0)
    assert dot[10, 20] == 255
    assert dot.sum() / 255 == pytest.approx(np.pi * 9, rel=0.1)


def test_roadmap_needs_a_target(environment: NavigateEnv) -> None:
    from cathsim.observations.observables import make_observable

    with pytest.raises(ValueError, match="'roadmap' needs a target"):
        make_observable("roadmap", environment.simulation, environment.fluoroscope)
    with pytest.raises(ValueError, match="unknown target"):
        Roadmap(environment.simulation, "aorta").read()
