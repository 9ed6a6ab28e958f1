"""Placing the devices along a way through the lumen: states beyond a branch's ostium, reached without steering."""

from __future__ import annotations

import logging
from collections.abc import Iterator

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from cathsim.anatomy.centreline import arc_length
from cathsim.devices.arena import FEEDER, PROTRUSION
from cathsim.devices.simulation import DualSimulation
from cathsim.environment import ROTATION_STEP, TRANSLATION_STEP, NavigateEnv
from cathsim.planning.path import UnreachableError, plan_path
from cathsim.simulation import Simulation
from cathsim.statics.laying import joint_angles

REST_STEPS = 10  # control steps in which the wire finds its place between the walls
WAY_CLEARANCE, PREFERRED_CLEARANCE = 1e-3, 3e-3  # m from the wall that a planned way keeps, and would rather keep
_AT_ENTRY = 5e-4  # m from the entry at which a way may begin
SHORT_OF_END = (0.012, 0.018, 0.025, 0.032, 0.040, 0.050)  # m from the tip to the target along the planned way
WITHDRAWALS, WITHDRAWAL_STEPS = 3, 4  # rest states of a withdrawal, steps between them
MOST_FORCE = 0.5  # N: with more the wire lies jammed
SHAPES = 6  # from one inserted wire
CATHETER_BEHIND = 0.05  # m: a placed wire is so far ahead of its catheter
LEADS = (0.0, 0.08)  # m, of inserted start states and pushed shapes
_SHALLOWEST = 0.01  # m of wire inside the vessel
_MOVES = 8  # of 0.1 s, before each shape
# mean of a wire's pushes, of the most in a step: a wire pushed on folds at the wall
_LEAN = -0.3, 1.0
_FORWARD, _TURN = 0.4, 0.7  # spread of the moves, of the most in a step

_LOGGER = logging.getLogger(__name__)


def plan_way(simulation: Simulation, place: ArrayLike) -> np.ndarray:
    """Plans the way along which a wire can be placed up to a place (3,) m in the lumen.

    Returns:
        Points (n, 3) m from the entry to the place: straight on to where the tip lies at zero insertion, off the walls
        from there on.

    Raises:
        UnreachableError: no way keeps `WAY_CLEARANCE` from the walls.
    """
    vessel = simulation.vessel
    first = vessel.entry + PROTRUSION * vessel.direction
    path = plan_path(
        simulation.phantom.grid, first, place, clearance=WAY_CLEARANCE, preferred_clearance=PREFERRED_CLEARANCE
    )
    return np.vstack((vessel.entry, path.points))


def place_wire(
    simulation: Simulation,
    way: ArrayLike,
    short_of_end: float,
    *,
    lead: float | None = None,
    rest_steps: int = REST_STEPS,
) -> None:
    """Places the wire along a way, its tip some distance short of the way's end, and lets it come to rest.

    Of two devices both lie along the way, and the tip is that of the device that is further in.

    Each joint turns so that its link points along the way; twist and the pre-shaped tip settle during the
    rest. The tip may slip back out of a branch meanwhile: look at where it is.

    Args:
        simulation: whose wire it is; it ends in the new state.
        way: points from the entry on, m, world frame, such as `plan_way` gives. Shape (n, 3).
        short_of_end: distance along the way from the tip to its end, m.
        lead: of two devices, how far the wire's tip is ahead of the catheter's, m; None: 50 mm. A device that would
            have to be withdrawn beyond its start stays there.
        rest_steps: control steps of 0.1 s without a movement of the feeder.

    Raises:
        ValueError: the way does not begin at the entry, or is too short or too long for the wire.
    """
    points = np.asarray(way, float)
    gap = float(np.linalg.norm(points[0] - simulation.vessel.entry))
    if gap > _AT_ENTRY:  # else the wire would lie that far behind the way
        raise ValueError(
            f"a way for the wire begins at the vessel's entry, this one begins {1e3 * gap:.1f} mm from it: plan it "
            "with plan_way, or put the entry before it"
        )
    arcs = arc_length(points)
    tip_arc = float(arcs[-1]) - short_of_end
    insertion = tip_arc - PROTRUSION
    if not 0 <= insertion <= simulation.max_insertion:
        raise ValueError(
            f"the wire can lie 0 to {simulation.max_insertion:.3f} m along a way beyond its start, this one asks for "
            f"{insertion:.3f} m"
        )
    _reset(simulation, insertion, lead)
    links = np.asarray(simulation.wire.links[-simulation.active_links :])
    behind_tip = np.concatenate((np.cumsum(links[::-1])[::-1], [0.0]))
    nodes = _points_at(tip_arc - behind_tip, arcs, points, simulation.vessel.direction)
    model, data = simulation.model, simulation.data
    axes = data.xmat[model.body(FEEDER).id].reshape(3, 3).copy()
    data.qpos[2:] = joint_angles(nodes[1:], axes).ravel()
    data.qvel[:] = 0.0
    if isinstance(simulation, DualSimulation):
        simulation.let_untwist()
    mujoco.mj_forward(model, data)
    for _ in range(rest_steps):
        simulation.advance(0.0, 0.0)


def _reset(simulation: Simulation, insertion: float, lead: float | None) -> None:
    """Resets the devices so that the tip of the one that is further in is advanced by `insertion` (m)."""
    if not (isinstance(simulation, DualSimulation) and simulation.pair.both):
        if lead is not None:
            raise ValueError("a lead is that of two devices, and there is one: leave it out")
        simulation.reset(insertion)
        return
    pair = simulation.pair
    if lead is None:
        lead = min(CATHETER_BEHIND, pair.most_ahead)
    if not -pair.most_behind <= lead <= pair.most_ahead:
        raise ValueError(
            f"a lead must lie in {-1e3 * pair.most_behind:.0f} to {1e3 * pair.most_ahead:.0f} mm, got {1e3 * lead:.0f}"
        )
    lead = min(max(lead, -insertion), insertion)
    simulation.reset(insertion + min(lead, 0.0), catheter=(insertion - max(lead, 0.0), 0.0))


def inserted_starts(environment: NavigateEnv, generator: np.random.Generator) -> np.ndarray:
    """Start states with the wire inserted towards the target, and withdrawn from there.

    Two devices are inserted at a lead from `LEADS` and withdrawn together.

    Args:
        environment: with the anatomy and the target; its simulation is moved.
        generator: of the turns while they are withdrawn, and of the leads.

    Returns:
        Shape (k, n); none where the wire is too short, or there is no way with a clearance.
    """
    simulation, target = environment.simulation, environment.task.target
    states: list[np.ndarray] = []
    try:
        way = plan_way(simulation, environment.phantom.target(target).position)
    except UnreachableError:
        _LOGGER.info("no way with a clearance to %s of %s: no starts there", target, environment.phantom.name)
        return np.empty((0, len(simulation.state())))
    for short in SHORT_OF_END:
        try:
            place_wire(simulation, way, short, lead=_drawn_lead(simulation, generator))
        except ValueError:  # the wire is too short for this one
            continue
        rest_states = [simulation.state()] if _at_rest(environment) else []
        for _ in range(WITHDRAWALS if rest_states else 0):
            for _ in range(WITHDRAWAL_STEPS):
                turns = generator.uniform(-0.26, 0.26, _feeders(simulation))
                _move(simulation, [(-0.002, float(turn)) for turn in turns])
            if _at_rest(environment):
                rest_states.append(simulation.state())
        states += rest_states
    return np.array(states) if states else np.empty((0, len(simulation.state())))


def pushed_shapes(simulation: Simulation, way: ArrayLike, generator: np.random.Generator) -> Iterator[np.ndarray]:
    """Shapes of a wire that is inserted a part of a way and moved on from there at random, as it folds at the wall.

    Two devices are inserted at a lead from `LEADS`, and each is moved by itself; their shape is that of both together.

    Args:
        way: as `place_wire` takes it.
        generator: of place and moves; the caller may draw from it between two shapes.

    Returns:
        Up to `SHAPES` times the wire's points from the tip, m, shape (n, 3); fewer where the simulation fails.

    Raises:
        ValueError: the wire is too short to be inserted that far.
    """
    length = float(np.linalg.norm(np.diff(np.asarray(way), axis=0), axis=1).sum())
    short = generator.uniform(0.005, length - _SHALLOWEST)
    place_wire(simulation, way, short, lead=_drawn_lead(simulation, generator))
    return _pushed(simulation, generator)


def _pushed(simulation: Simulation, generator: np.random.Generator) -> Iterator[np.ndarray]:
    means = [(generator.uniform(-1, 1), generator.uniform(*_LEAN)) for _ in range(_feeders(simulation))]
    for _ in range(SHAPES):
        for _ in range(_MOVES):
            moves = []
            for turn, lean in means:
                push = np.clip(lean + _FORWARD * generator.standard_normal(), -1, 1)
                twist = np.clip(turn + _TURN * generator.standard_normal(), -1, 1)
                moves.append((TRANSLATION_STEP * float(push), ROTATION_STEP * float(twist)))
            _move(simulation, moves)
        if not simulation.valid:
            break
        yield simulation.wire_points()


def _feeders(simulation: Simulation) -> int:
    return 2 if isinstance(simulation, DualSimulation) and simulation.pair.both else 1


def _drawn_lead(simulation: Simulation, generator: np.random.Generator) -> float | None:
    return float(generator.uniform(*LEADS)) if _feeders(simulation) == 2 else None


def _move(simulation: Simulation, moves: list[tuple[float, float]]) -> None:
    """One control step: translation (m) and rotation (rad) of each feeder, the wire's first."""
    if isinstance(simulation, DualSimulation) and len(moves) == 2:
        simulation.advance(*moves[0], catheter=moves[1])
    else:
        simulation.advance(*moves[0])


def _at_rest(environment: NavigateEnv) -> bool:
    """Whether a start there makes sense: the simulation holds, nothing jams, and the target is still to be reached."""
    simulation = environment.simulation
    near = np.linalg.norm(simulation.tip - environment.phantom.target(environment.task.target).position)
    return (
        simulation.valid
        and simulation.summary.force_max < MOST_FORCE
        and bool(near > environment.task.success_radius)
        and bool(np.isfinite(simulation.state()).all())
    )


def _points_at(at: np.ndarray, arcs: np.ndarray, points: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Points of the way at distances from its start; before it, on the sheath's axis. Shape (k, 3)."""
    on_way = np.stack([np.interp(at, arcs, points[:, axis]) for axis in range(3)], axis=1)
    return on_way + np.minimum(at, 0.0)[:, None] * direction
