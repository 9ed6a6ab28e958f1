"""Search of a way into a branch: random motions from states that were kept, most often from those near the target.

It asks only for distances along the lumen, so it finds motions that lead away from the target for a while, such as
drawing back to make the tip rise in a branch that turns back from the arch.

Source: Ecoffet et al. 2021, "First return, then explore", Nature 590: an archive of cells, return to one by its state,
random exploration from there. Cells, motions and weights are this module's own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from cathsim.devices.simulation import DualSimulation
from cathsim.environment import NavigateEnv
from cathsim.planning.path import UnreachableError
from cathsim.presets import ACCURACY, Accuracy
from cathsim.simulation import Simulation
from cathsim.validation import Count, Unit, settings
from cathsim.wire_placement import place_wire, plan_way

_BEGINNINGS = (0.080, 0.110)  # m from the laid tip to the target, along the way
_CELL_WAY, _CELL_INSERTION, _CELL_TURN = 0.003, 0.012, math.pi / 3  # m, m, rad
_CELL_LEAD = 0.02  # m, with two devices
_MOTIONS = 3  # in a row, from each state that is returned to
_LEAST, _MOST = 3, 10  # steps of a motion
_BACKWARDS, _STRAIGHT = 0.4, 0.3  # shares of motions drawn over the full range of translation; without a rotation
_FORWARDS = 0.3  # least translation of the others, of the most in a step
_FAVOURED, _FEW = 0.15, 3  # share and number of the cells nearest to the target over which the weight falls by e


@settings
class StateSearchSettings:
    """How long is searched.

    Attributes:
        steps: control steps in all, at most.
        most_force: a motion ends with a contact force beyond it, N.
    """

    steps: Count = 20_000
    most_force: Annotated[float, Interval(gt=0, le=1000), Unit("N")] = 2.0


@dataclass(frozen=True, eq=False)
class FoundStates:
    """What was found."""

    states: NDArray[np.float64]  # from the beginning to the one nearest to the target, (k, n)
    reached: bool  # whether the last of them is at the target
    nearest: float  # way that remains in the last of them, m
    steps: int  # control steps that were simulated


@dataclass(eq=False)
class _Cell:
    state: NDArray[np.float64]
    remaining: float  # m
    parent: tuple[int, ...] | None
    visits: int = 0


def search_states(
    environment: NavigateEnv,
    generator: np.random.Generator,
    *,
    settings: StateSearchSettings | None = None,
    numerics: Accuracy = ACCURACY["fast"],
) -> FoundStates:
    """Searches states of the devices that lead to the target, whatever motions they take.

    It begins with the wire laid along the way, 80 and 110 mm from the target; where it cannot be laid there, with the
    environment's own start.

    Args:
        environment: with anatomy, devices and target; its simulation is moved.
        generator: of the motions.
        numerics: time steps of the search; states are those of the environment's own simulation, too.

    Returns:
        The states of one chain, as `reset(options={"start": row})` takes them.
    """
    return _StateSearch(environment, generator, settings or StateSearchSettings(), numerics).run()


class _StateSearch:
    def __init__(
        self,
        environment: NavigateEnv,
        generator: np.random.Generator,
        chosen: StateSearchSettings,
        numerics: Accuracy,
    ) -> None:
        self._environment, self._generator, self._settings = environment, generator, chosen
        self._copy: Simulation = environment.simulation.stepped_by(numerics)
        self._pair = self._copy if isinstance(self._copy, DualSimulation) and self._copy.pair.both else None
        self._cells: dict[tuple[int, ...], _Cell] = {}
        self._steps = 0

    def run(self) -> FoundStates:
        for state in self._beginnings():
            self._copy.restore(state)
            self._keep(None)
        while self._steps < self._settings.steps:
            key = self._draw_cell()
            cell = self._cells[key]
            cell.visits += 1
            self._copy.restore(cell.state)
            for _ in range(_MOTIONS):
                if not self._move():
                    break
                if self._reached():
                    return self._found(key, reached=True)
                key = self._keep(key)
        best = min(self._cells, key=lambda one: self._cells[one].remaining)
        return self._found(best, reached=False)

    def _beginnings(self) -> list[NDArray[np.float64]]:
        simulation, states = self._environment.simulation, []
        try:
            way = plan_way(simulation, self._environment.goal)
            for short in _BEGINNINGS:
                place_wire(simulation, way, short)
                states.append(simulation.state())
        except (UnreachableError, ValueError):  # no way with a clearance, or one shorter than that
            if not states:
                self._environment.task.start(simulation, self._generator)
                states.append(simulation.state())
        return states

    def _draw_cell(self) -> tuple[int, ...]:
        keys = list(self._cells)
        remaining = np.array([cell.remaining for cell in self._cells.values()])
        visits = np.array([cell.visits for cell in self._cells.values()])
        rank = np.argsort(np.argsort(remaining, kind="stable"))
        weights = np.exp(-rank / (_FAVOURED * len(keys) + _FEW)) / np.sqrt(1 + visits)
        return keys[int(self._generator.choice(len(keys), p=weights / weights.sum()))]

    def _move(self) -> bool:
        """One motion of every device; False: it failed, or pressed too hard."""
        draw, pace, copy = self._generator, self._copy.pace, self._copy
        moves = []
        for _ in range(2 if self._pair else 1):
            lowest = -1.0 if draw.random() < _BACKWARDS else _FORWARDS
            turn = 0.0 if draw.random() < _STRAIGHT else draw.uniform(-1.0, 1.0)
            moves.append((pace.translation * draw.uniform(lowest, 1.0), pace.rotation * turn))
        for _ in range(int(draw.integers(_LEAST, _MOST + 1))):
            if self._pair:
                self._pair.advance(*moves[0], catheter=moves[1])
            else:
                copy.advance(*moves[0])
            self._steps += 1
            if not copy.valid or copy.summary.force_max > self._settings.most_force:
                return False
            if self._reached():
                return True
        return True

    def _keep(self, parent: tuple[int, ...] | None) -> tuple[int, ...]:
        """Keeps the moment if its cell is empty; returns the cell, to which what comes next belongs."""
        copy, remaining = self._copy, self._remaining()
        place = [remaining / _CELL_WAY, copy.insertion / _CELL_INSERTION, copy.rotation % (2 * math.pi) / _CELL_TURN]
        if self._pair:
            place += [self._pair.device_lead / _CELL_LEAD, self._pair.catheter_place()[1] % (2 * math.pi) / _CELL_TURN]
        key = tuple(math.floor(value) for value in place)
        if key not in self._cells:
            self._cells[key] = _Cell(copy.state(), remaining, parent)
        return key

    def _found(self, key: tuple[int, ...], *, reached: bool) -> FoundStates:
        chain: list[NDArray[np.float64]] = [self._copy.state()] if reached else []
        nearest = self._remaining() if reached else self._cells[key].remaining
        at: tuple[int, ...] | None = key
        while at is not None:
            chain.append(self._cells[at].state)
            at = self._cells[at].parent
        return FoundStates(np.array(chain[::-1]), reached, nearest, self._steps)

    def _reached(self) -> bool:
        distance = np.linalg.norm(self._copy.tip_in_vessel - self._environment.goal)
        return bool(distance < self._environment.task.success_radius)

    def _remaining(self) -> float:
        return self._environment.task.remaining(self._environment.phantom, self._copy.tip_in_vessel)
