"""Manoeuvres that leave a local minimum: draw back, turn, advance again, as an operator does who gets no further."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cathsim.presets import Pace

Array = NDArray[np.float64]
Ending = tuple[float, int]  # cost of a plan, and after how many of its steps it is reached

OUT = 0.06  # m that the wire is fed in the last phase, or its lead at the end of it
_DRAWN, _VARIED, _ROUNDS, _ELITES = 40, 20, 2, 6  # manoeuvres at first and a round, rounds, best ones that are varied
_SPREAD, _NARROWING = 0.2, 0.75  # of a parameter about an elite's, of its range; from round to round
# Least and largest value of each parameter.
_WIRE = np.array(
    (
        (0.0, 0.10),  # m by which the wire is withdrawn
        (-np.pi, np.pi),  # rad turned meanwhile
        (-1.0, 1.0),  # rotation while the wire is fed, of the most in a step
    )
)
_TWO_DEVICES = np.array(
    (
        (-0.10, 0.06),  # m of lead after the first phase
        (-0.08, 0.12),  # m by which the catheter is moved in it
        (-np.pi, np.pi),  # rad by which both are turned in it
        (0.0, 0.06),  # m by which both are then withdrawn, as a reverse curve is to engage
        (-np.pi, np.pi),  # rad by which both are turned meanwhile
        (-1.0, 1.0),  # rotation while the wire is fed, of the most in a step
        (-0.5, 0.7),  # translation of the catheter meanwhile, of the most in a step
    )
)
# Of a retreat: m by which the foremost tip is withdrawn, rad of turn of each device, m of lead after it.
_RETREAT, _TURN, _LEAD = (0.03, 0.10), (-np.pi, np.pi), (0.0, 0.05)


@dataclass(frozen=True, eq=False)
class Manoeuvre:
    """A plan in phases, of which the last feeds the wire."""

    parameters: Array  # (k,), see `parameter_limits`
    plan: Array  # (n, 2) or (n, 4), shares of the largest movement in a step
    fed_from: int  # step at which the last phase begins


def parameter_limits(actions: int) -> tuple[Array, Array]:
    """Least and largest parameters of a manoeuvre, each of shape (k,): of the wire (2 actions), or of both devices."""
    limits = _WIRE if actions == 2 else _TWO_DEVICES
    return limits[:, 0], limits[:, 1]


def manoeuvre(parameters: Array, pace: Pace, *, lead: float = 0.0) -> Manoeuvre:
    """The manoeuvre of some parameters, as fast as the feeders can.

    Args:
        parameters: within `parameter_limits`: shape (3,) of a wire, (7,) of wire and catheter.
        lead: of the wire before the catheter at its start, m.
    """
    if len(parameters) == len(_WIRE):
        back, turn, spin = parameters.tolist()
        phases = [_phase(pace, (-back, turn))]
        last = np.tile([1.0, spin], (_count((back + OUT) / pace.translation), 1))
    else:
        to_lead, moved, turn, back, turn_back, spin, follow = parameters.tolist()
        phases = [
            _phase(pace, (moved + to_lead - lead, turn, moved, turn)),
            _phase(pace, (-back, turn_back, -back, turn_back)),
        ]
        last = np.tile([1.0, spin, follow, 0.0], (_count((OUT - to_lead) / pace.translation), 1))
    return Manoeuvre(parameters, np.concatenate((*phases, last)), sum(len(phase) for phase in phases))


def search_manoeuvres(
    evaluate: Callable[[Sequence[Manoeuvre]], Sequence[Ending]],
    generator: np.random.Generator,
    actions: int,
    pace: Pace,
    *,
    lead: float = 0.0,
) -> list[tuple[Ending, Manoeuvre]]:
    """Draws manoeuvres, varies the best of them, and returns all with their endings, the cheapest first.

    Args:
        evaluate: endings of manoeuvres.
        actions: 2 for the wire, 4 for wire and catheter.
        lead: of the wire before the catheter at their start, m.
    """
    low, high = parameter_limits(actions)
    drawn = generator.uniform(low, high, (_DRAWN, len(low)))
    endings: list[tuple[Ending, Manoeuvre]] = []
    for number in range(_ROUNDS + 1):
        if number:
            elites = np.stack([one.parameters for _, one in endings[:_ELITES]])
            spread = _SPREAD * _NARROWING ** (number - 1) * (high - low)
            drawn = elites[generator.integers(0, len(elites), _VARIED)]
            drawn = np.clip(drawn + spread * generator.normal(size=drawn.shape), low, high)
        candidates = [manoeuvre(parameters, pace, lead=lead) for parameters in drawn]
        endings += zip(evaluate(candidates), candidates, strict=True)
        endings.sort(key=lambda row: row[0])
        if endings[0][0][0] < 0:
            break
    return endings


def retreat(generator: np.random.Generator, actions: int, pace: Pace, *, lead: float = 0.0) -> Array:
    """The plan of a retreat: the end of what is fed is withdrawn by a random length, each device turned at random.

    Args:
        actions: 2 for the wire, 4 for wire and catheter.
        lead: of the wire before the catheter at its start, m; random at its end.

    Returns:
        Shape (n, actions), shares of the largest movement in a step.
    """
    back, turn = generator.uniform(*_RETREAT), generator.uniform(*_TURN)
    if actions == 2:
        return _phase(pace, (-back, turn))
    to_lead, turned = generator.uniform(*_LEAD), generator.uniform(*_TURN)
    return _phase(pace, (max(-lead, 0.0) - back, turn, max(lead, 0.0) - back - to_lead, turned))


def _phase(pace: Pace, movements: tuple[float, ...]) -> Array:
    """Steps that share movements (m, rad, m, rad) evenly, as few as the feeders' pace allows; at least one."""
    shares = np.array(movements) / np.resize([pace.translation, pace.rotation], len(movements))
    steps = _count(float(np.abs(shares).max()))
    return np.tile(shares / steps, (steps, 1))


def _count(steps: float) -> int:
    return max(int(np.ceil(steps - 1e-9)), 1)
