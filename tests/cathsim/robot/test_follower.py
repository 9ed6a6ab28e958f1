"""The follower robot: its cycle, limits and mapping, and the wire that it feeds."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
import pytest

from cathsim import NavigateEnv
from cathsim.robot.follower import CLOSED, FeedCycle, FollowerRobot, Leader, Measured, Phase
from cathsim.robot.model import (
    CARRIAGE,
    CLAMPS,
    DRIVING_CLAMP,
    HOLDING_CLAMP,
    JAWS,
    PLATFORMS,
    ROTARIES,
    WHEEL,
    RobotSettings,
    robot_spec,
)
from cathsim.viewing.camera_view import RenderingUnavailableError, View, robot_pose

MakeEnv = Callable[..., NavigateEnv]
SHORT = RobotSettings(stroke=0.010, backlog=1.0, rotation_backlog=100.0)


def settle(robot: FollowerRobot, translation: float, rotation: float, steps: int) -> tuple[float, float]:
    """One command, then time to carry it out: how far the wire was moved (m) and turned (rad)."""
    moves = [robot.advance(translation, rotation)] + [robot.advance(0.0, 0.0) for _ in range(steps)]
    moved, turned = np.sum(moves, axis=0)
    return float(moved), float(turned)


def position(robot: FollowerRobot, joint: str) -> float:
    return float(robot.data.joint(joint).qpos[0])


def test_rail_with_four_platforms_two_clamps_and_two_rotary_parts() -> None:
    model = robot_spec(RobotSettings()).compile()
    kinds = {model.joint(i).name: int(model.jnt_type[i]) for i in range(model.njnt)}
    slide, hinge = int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE)
    jaws = [jaw.format(clamp) for clamp in CLAMPS for jaw in JAWS]
    expected = dict.fromkeys((*PLATFORMS, *jaws), slide) | {WHEEL.format(name): hinge for name in ROTARIES}
    assert kinds == expected
    assert model.nu == model.njnt == 10
    places = [-model.body(name).pos[2] for name in PLATFORMS]
    assert places == sorted(places), "from the patient back"
    assert all(gap > 0.035 for gap in np.diff(places)), "platforms do not overlap"
    assert places[-1] < RobotSettings().length


def test_wire_moves_by_what_was_commanded_over_several_strokes() -> None:
    robot = FollowerRobot(SHORT)
    assert settle(robot, 0.045, 1.5, 70) == pytest.approx((0.045, 1.5), abs=2e-5)
    assert robot.cycle.strokes == 4
    assert settle(robot, -0.025, -4.0, 70) == pytest.approx((-0.025, -4.0), abs=2e-5)
    assert settle(robot, 0.0, 0.0, 5) == pytest.approx((0.0, 0.0), abs=1e-6)


def test_wire_moves_only_while_clamped_and_then_with_the_carriage() -> None:
    robot = FollowerRobot(SHORT)
    phases = set()
    paused = 0
    for _ in range(60 * 20):
        before, carriage, wheel = (
            robot.driven,
            position(robot, DRIVING_CLAMP),
            position(robot, WHEEL.format(ROTARIES[1])),
        )
        moved, turned = robot.advance(1e-4, 0.01, SHORT.timestep)
        phases.add(robot.phase)
        if before and robot.driven:
            assert moved == pytest.approx(position(robot, DRIVING_CLAMP) - carriage, abs=1e-12)
            assert turned == pytest.approx(position(robot, WHEEL.format(ROTARIES[1])) - wheel, abs=1e-12)
        else:
            assert (moved, turned) == (0.0, 0.0)
            paused += 1
        jaws = {clamp: max(position(robot, jaw.format(clamp)) for jaw in JAWS) for clamp in CLAMPS}
        assert min(jaws.values()) < CLOSED, "the wire is never let go"
        if robot.phase == Phase.RETURN:
            assert jaws[DRIVING_CLAMP] > 0.9 * SHORT.jaw_opening
            assert jaws[HOLDING_CLAMP] < CLOSED
    assert phases == set(Phase)
    assert paused > 100, "the release and the return take their time"


def test_joints_stay_within_their_limits() -> None:
    robot = FollowerRobot(SHORT)
    generator = np.random.default_rng(0)
    model = robot.model
    low, high = model.jnt_range.T
    limited = model.jnt_limited.astype(bool)
    fastest = 0.0
    for _ in range(80):
        before = position(robot, DRIVING_CLAMP)
        robot.advance(generator.uniform(-0.02, 0.02), generator.uniform(-1, 1))
        fastest = max(fastest, abs(position(robot, DRIVING_CLAMP) - before) / 0.1)
        assert (robot.data.qpos[limited] > low[limited] - 1e-4).all()
        assert (robot.data.qpos[limited] < high[limited] + 1e-4).all()
        assert position(robot, CARRIAGE[0]) == pytest.approx(position(robot, CARRIAGE[1]), abs=1e-4)
    assert 0.01 < fastest < SHORT.return_speed * 1.05


def test_speed_is_limited_and_what_exceeds_the_backlog_is_lost() -> None:
    robot = FollowerRobot(RobotSettings(stroke=0.050))
    moves = [robot.advance(0.010, 0.0)[0] for _ in range(5)]
    assert max(moves) < 0.030 * 0.1 + 1e-5
    assert sum(moves) + robot.pending_translation < 0.050 - 0.010
    assert robot.pending_translation == pytest.approx(0.004)
    robot.reset()
    assert robot.pending_translation == 0
    assert robot.advance(0.0, 0.0) == (0.0, 0.0)


def test_cycle_turns_round_for_a_retraction() -> None:
    cycle = FeedCycle(SHORT)
    rest = Measured(0.0, 0.0, 0.0, 0.0, driving_jaw=0.0, holding_jaw=SHORT.jaw_opening)
    cycle.tick(rest, 0.0, 0.0)
    assert cycle.phase == Phase.DRIVE
    cycle.tick(rest, -0.001, 0.0)
    assert cycle.phase == Phase.HOLD, "at the rear end there is nothing left to go back"
    robot = FollowerRobot(SHORT)
    assert settle(robot, -0.012, 0.0, 30)[0] == pytest.approx(-0.012, abs=2e-5)


def test_leader_maps_linearly_within_its_stroke() -> None:
    leader = Leader(translation_scale=0.5, rotation_scale=2.0, stroke=0.020)
    assert leader.move(0.010, 0.3) == pytest.approx((0.005, 0.6))
    assert leader.move(-0.004, -0.1) == pytest.approx((-0.002, -0.2))
    first, second = Leader(stroke=1.0), Leader(stroke=1.0)
    together = first.move(0.003 + 0.004, 0.5)
    apart = np.add(second.move(0.003, 0.2), second.move(0.004, 0.3))
    assert together == pytest.approx(tuple(apart)), "additive"
    assert leader.move(1.0, 0.0)[0] == pytest.approx(0.5 * 0.014), "the handle stops at its stroke"
    assert leader.position == 0.020
    leader.engaged = False
    assert leader.move(-0.040, 1.0) == (0.0, 0.0)
    assert leader.position == -0.020
    leader.engaged = True
    assert leader.move(0.010, 0.0)[0] == pytest.approx(0.005), "from the handle's new place"


def test_environment_is_fed_stroke_by_stroke(make_env: MakeEnv) -> None:
    env = make_env(drive="robot", observation="feeder", max_steps=100)
    env.reset(seed=3)
    robot, simulation = env.robot, env.simulation
    assert robot is not None
    start, fed, driven = simulation.insertion, 0.0, []
    for _ in range(60):
        before = robot.data.time
        _, _, _, _, info = env.step(np.array([1.0, 0.2]))
        assert robot.data.time - before == pytest.approx(0.1)
        driven.append(info["driven"])
    strokes = robot.cycle.strokes * robot.settings.stroke
    if robot.phase != Phase.RETURN:
        fed = strokes + (position(robot, DRIVING_CLAMP) if robot.phase in (Phase.DRIVE, Phase.HOLD) else 0.0)
        assert simulation.insertion - start == pytest.approx(fed, abs=1.5e-3)
    assert 5 < driven.count(False) < 40
    assert simulation.insertion < start + 0.1, "slower than the direct drive's 0.12 m"


def test_same_seed_same_bits_also_after_another_episode(make_env: MakeEnv) -> None:
    first, second = (make_env(drive="robot", observation=("joints", "force")) for _ in range(2))
    second.reset(seed=9)
    for _ in range(30):
        second.step(np.array([1.0, 1.0]))
    traces = []
    for env in (first, second):
        env.reset(seed=1)
        generator = np.random.default_rng(0)
        traces.append([env.step(generator.uniform(-0.2, 1.0, 2))[0] for _ in range(40)])
    for one, other in zip(*traces, strict=True):
        assert all(np.array_equal(one[name], other[name]) for name in one)


def test_motors_of_the_tip_go_on_while_the_robot_returns(make_env: MakeEnv) -> None:
    env = make_env(drive="robot", actions="tip_motors", observation="joints")
    env.reset(seed=0)
    action = np.zeros(21)
    action[-1] = 1.0
    while env.robot is not None and env.robot.phase != Phase.RETURN:
        env.step(action)
    still = env.step(np.zeros(21))[0]
    bent = env.step(np.concatenate((np.ones(20), [0.0])))[0]
    assert np.abs(bent - still).max() > 0.05


def test_direct_drive_has_no_robot_and_others_are_refused(make_env: MakeEnv) -> None:
    env = make_env()
    assert env.robot is None
    _, info = env.reset(seed=0)
    assert "driven" not in info
    with pytest.raises(ValueError, match="unknown drive 'rail'; there are direct, robot"):
        make_env(drive="rail")
    with pytest.raises(ValueError, match=r"stroke must lie in 0 \(excluded\) to 1 m, got 0"):
        RobotSettings(stroke=0)
    with pytest.raises(ValueError, match="translation_scale must lie in"):
        Leader(translation_scale=-1)
    with pytest.raises(ValueError, match=r"expected a finite translation \(m\) and rotation \(rad\), got nan"):
        FollowerRobot().advance(float("nan"), 0.0)


@pytest.mark.parametrize("direction", [[0, 0, 1], [0.3, 0.2, 0.9], [0, 1, 0], [0, -1, 0]])
def test_robot_stands_behind_the_sheath(direction: list[float]) -> None:
    forward = np.array(direction) / np.linalg.norm(direction)
    origin, rotation = robot_pose(np.array([0.1, 0.2, 0.3]), forward)
    assert np.allclose(rotation @ [0, 0, 1], forward)
    assert np.allclose(rotation @ rotation.T, np.eye(3))
    assert np.linalg.det(rotation) == pytest.approx(1)
    assert (np.array([0.1, 0.2, 0.3]) - origin) @ forward > 0.005


def test_robot_is_drawn_and_seen_to_move(make_env: MakeEnv) -> None:
    env = make_env(drive="robot", render_mode="rgb_array")
    env.reset(seed=0)
    try:
        view = View(env.phantom, width=16, height=16)
    except RenderingUnavailableError as error:
        pytest.skip(str(error))
    view.close()
    pictures = []
    for _ in range(3):
        for _ in range(8):
            env.step(np.array([1.0, 0.0]))
        pictures.append(env.render())
    first, second, third = pictures
    assert first is not None
    assert second is not None
    assert third is not None
    red, _, blue = np.moveaxis(first.astype(int), -1, 0)
    assert (red - blue > 100).sum() > 200, "jaws"
    assert (blue - red > 30).sum() > 200, "platforms"
    assert (first != second).any(axis=-1).sum() > 100
    assert (second != third).any(axis=-1).sum() > 100
