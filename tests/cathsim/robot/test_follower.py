"""The robot that feeds: strokes, clamps, limits, pace."""

import numpy as np
import pytest

from cathsim import NavigateEnv
from cathsim.presets import PACES, Pace
from cathsim.robot.follower import CLOSED, FollowerRobot, Leader, Phase
from cathsim.robot.model import CLAMPS, DRIVING_CLAMP, HOLDING_CLAMP, JAWS, ROTARIES, WHEEL, RobotSettings
from cathsim.viewing.camera_view import RenderingUnavailableError, View
from tests.cathsim.makers import MakeEnv

SHORT = RobotSettings(stroke=0.010, backlog=1.0, rotation_backlog=100.0)


def settle(robot: FollowerRobot, translation: float, rotation: float, steps: int) -> tuple[float, float]:
    """One command, then time to carry it out: how far the wire was moved (m) and turned (rad)."""
    moves = [robot.advance(translation, rotation)] + [robot.advance(0.0, 0.0) for _ in range(steps)]
    moved, turned = np.sum(moves, axis=0)
    return float(moved), float(turned)


def position(robot: FollowerRobot, joint: str) -> float:
    return float(robot.data.joint(joint).qpos[0])


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
        before, carriage = robot.driven, position(robot, DRIVING_CLAMP)
        wheel = position(robot, WHEEL.format(ROTARIES[1]))
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


def test_speed_is_limited_and_what_exceeds_the_backlog_is_lost() -> None:
    robot = FollowerRobot(RobotSettings(stroke=0.050))
    moves = [robot.advance(0.010, 0.0)[0] for _ in range(5)]
    assert max(moves) < 0.030 * 0.1 + 1e-5
    assert sum(moves) + robot.pending_translation < 0.050 - 0.010
    assert robot.pending_translation == pytest.approx(0.004)
    robot.reset()
    assert robot.pending_translation == 0
    assert robot.advance(0.0, 0.0) == (0.0, 0.0)


def test_environment_is_fed_stroke_by_stroke(make_env: MakeEnv) -> None:
    env = make_env(drive="robot", observation="feeder", max_steps=100)
    env.reset(seed=3)
    robot, simulation = env.robot, env.simulation
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


def test_robot_and_wire_have_the_same_time_at_any_pace(make_env: MakeEnv) -> None:
    for pace in ("arch_variety", Pace(interval=0.012)):
        env = make_env(drive="robot", observation="feeder", pace=pace)
        env.reset(seed=0)
        env.step(np.array([1.0, 0.0]))
        assert env.robot.data.time == pytest.approx(env.simulation.data.time)


def test_direct_drive_has_no_robot_and_others_are_refused(make_env: MakeEnv) -> None:
    env = make_env()
    assert env.robot is None
    _, info = env.reset(seed=0)
    assert "driven" not in info
    with pytest.raises(ValueError, match="unknown drive 'rail'"):
        make_env(drive="rail")
    with pytest.raises(ValueError, match="stroke must lie in"):
        RobotSettings(stroke=0)
    with pytest.raises(ValueError, match="translation_scale must lie in"):
        Leader(translation_scale=-1)
    with pytest.raises(ValueError, match="expected a finite translation"):
        FollowerRobot().advance(float("nan"), 0.0)


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
    red, _, blue = np.moveaxis(first.astype(int), -1, 0)
    assert (red - blue > 100).sum() > 200, "jaws"
    assert (blue - red > 30).sum() > 200, "platforms"
    assert (first != second).any(axis=-1).sum() > 100
    assert (second != third).any(axis=-1).sum() > 100


def test_full_actions_move_at_the_published_speeds(type_1) -> None:
    environment = NavigateEnv(type_1, "lcca", pace="arch_variety", observation="tip")
    environment.reset(seed=0)
    simulation, pace = environment.simulation, PACES["arch_variety"]
    environment.step(np.array([1.0, 1.0]))
    before = simulation.insertion, simulation.rotation, simulation.data.time
    for _ in range(5):
        environment.step(np.array([1.0, 1.0]))
    seconds = simulation.data.time - before[2]
    assert seconds == pytest.approx(5 / 7.5)
    assert (simulation.insertion - before[0]) / seconds == pytest.approx(0.035, rel=0.02)
    assert (simulation.rotation - before[1]) / seconds == pytest.approx(np.pi, rel=0.02)
    assert pace.interval == pytest.approx(0.1333, abs=1e-4)
