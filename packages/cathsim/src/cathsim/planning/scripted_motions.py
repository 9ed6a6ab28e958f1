"""Scripted motions of a guidewire in an aortic arch: random moves in one manner, the wire's shape every few steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from cathsim.anatomy import Phantom
from cathsim.devices.wire_placement import place_wire
from cathsim.guidewire import load_guidewire
from cathsim.lifetime_cache import kept_with_owner
from cathsim.planning.path import plan_path
from cathsim.presets import ACCURACY
from cathsim.simulation import Simulation

WIRES = {"angled": "radifocus_angled", "straight": "nitrex_straight"}  # kind to preset
# Links from the proximal end, m: for smooth loops shorter than the presets', and 0.42 m in all, long enough for loops.
LINKS = (0.012,) * 26 + (0.006,) * 18
MAX_ADVANCE, MAX_TURN = 0.002, np.radians(15.0)  # a step: what a hand does in 0.1 s
ROOT = "root"  # the path down the ascending aorta, where a wire buckles
# How often each motion is filmed: into a branch, out of it, to and fro, and pushed on until it buckles into a loop.
MOTIONS = {"advance": 0.27, "withdraw": 0.13, "wander": 0.22, "buckle": 0.38}
# Where the branches of the arch end: the vessels beyond a branch's own target.
_ENDS = {"bca": ("rsa_end", "rcca_end", "bca"), "lcca": ("lcca_end", "lcca"), "lsa": ("lsa_end", "lsa")}
_BEHIND = 0.3  # m of wire outside the body, which no image shows the end of
_RESTARTS = 20  # of a motion whose wire the simulation lost or whose tip left the images
_PATIENCE = 10  # shapes whose tip is out of view


@dataclass(frozen=True)
class Script:
    """What the operator does in one acquisition.

    Attributes:
        target: branch that the wire is meant for, e.g. "bca".
        wire: a key of `WIRES`.
        shapes: number of shapes to film.
        steps: of 0.1 s between two shapes.
    """

    phantom: str
    target: str
    wire: str
    shapes: int
    steps: int
    seed: int


class RandomMoves:
    """Random moves of a motion: one advance and turn rate for 4 to 19 steps, then another, with noise on each step."""

    # motion to its moves: share, lowest and highest advance, turning; of the most in a step
    _MOVES: ClassVar = {
        "advance": ((0.7, 0.2, 1.0, 0.4), (0.1, -0.6, -0.1, 0.3), (0.2, -0.05, 0.2, 1.0)),
        "withdraw": ((0.75, -1.0, -0.2, 0.3), (0.1, 0.1, 0.5, 0.3), (0.15, -0.1, 0.05, 1.0)),
        "wander": ((0.4, 0.2, 1.0, 0.6), (0.3, -1.0, -0.2, 0.6), (0.3, -0.15, 0.15, 1.0)),
        "buckle": ((0.8, 0.4, 1.0, 0.5), (0.1, -0.4, -0.1, 0.3), (0.1, 0.0, 0.3, 1.0)),
    }  # fmt: skip

    def __init__(self, motion: str, generator: np.random.Generator) -> None:
        """Args:
        motion: a key of `MOTIONS`.
        """
        self._moves = np.array(self._MOVES[motion])
        self._generator = generator
        self._left = 0
        self._advance = self._turn = 0.0

    def next(self) -> tuple[float, float]:
        """Returns advance (m) and turn (rad) of the next step."""
        draw = self._generator
        if self._left == 0:
            _, low, high, turning = self._moves[draw.choice(len(self._moves), p=self._moves[:, 0])]
            self._advance = draw.uniform(low, high)
            self._turn = turning * draw.uniform(-1.0, 1.0) if draw.random() < 0.7 else 0.0
            self._left = int(draw.integers(4, 20))
        self._left -= 1
        advance = np.clip(self._advance + 0.1 * draw.standard_normal(), -1.0, 1.0)
        turn = np.clip(self._turn + 0.1 * draw.standard_normal(), -1.0, 1.0)
        return float(advance) * MAX_ADVANCE, float(turn) * MAX_TURN


def arch_branches(phantom: Phantom) -> tuple[str, ...]:
    """Returns the branches of an arch that a wire is brought into, without the parts that they divide into."""
    return tuple(name for name in _ENDS if any(end in phantom.targets for end in _ENDS[name]))


@kept_with_owner
def placement_paths(phantom: Phantom, target: str) -> tuple[np.ndarray, ...]:
    """Plans the paths along which a wire is inserted: to every end of a branch, or down the ascending aorta.

    Args:
        target: one of `arch_branches`, or `ROOT`.

    Returns:
        Paths of shape (n, 3) m, from the entry on; planned once for each phantom.
    """
    start, clearance = phantom.entry("descending").position, 0.003
    if target == ROOT:
        root = phantom.entry("ascending")
        ends, clearance = [root.position + 0.008 * root.direction], 0.005
    else:
        known = [end for end in _ENDS[target] if end in phantom.targets]
        # a branch's middle is on the path to its ends
        ends = [phantom.target(end).position for end in known if end != target or known == [target]]
    return tuple(plan_path(phantom.grid, start, end, preferred_clearance=clearance).points for end in ends)


class ScriptedOperator:
    """Films scripted motions of one wire in one anatomy.

    Args:
        wire: a key of `WIRES`.
    """

    def __init__(self, phantom: Phantom, wire: str) -> None:
        self.phantom = phantom
        self.simulation = Simulation(phantom, load_guidewire(WIRES[wire], links=LINKS), ACCURACY["fast"])

    def film(self, script: Script, in_view: Callable[[np.ndarray], bool]) -> tuple[str, list[np.ndarray]]:
        """Runs a script.

        Args:
            in_view: whether both cameras see a tip at (3,) m.

        Returns:
            The motion, a key of `MOTIONS`; and the wire's nodes of every shape, (n, 3) m from the tip, the part before
            the entry included.

        Raises:
            RuntimeError: the wire was lost, or out of view, again and again.
        """
        for attempt in range(_RESTARTS):
            generator = np.random.default_rng((script.seed, attempt))
            motion = str(generator.choice(list(MOTIONS), p=list(MOTIONS.values())))
            self._begin(motion, script.target, generator)
            shapes = self._shapes(RandomMoves(motion, generator), script, in_view)
            if len(shapes) == script.shapes:
                return motion, shapes
        raise RuntimeError(f"no motion of the {script.wire} wire to {script.target} of {script.phantom} came to an end")

    def _begin(self, motion: str, target: str, generator: np.random.Generator) -> None:
        simulation = self.simulation
        if motion == "buckle" and generator.random() < 0.4:
            # fed in from the groin with hardly any steering, it goes where it likes
            simulation.reset(0.0, generator.uniform(-np.pi, np.pi))
            for _ in range(int(generator.integers(150, 250))):
                simulation.advance(0.0016, 0.03 * generator.standard_normal())
            return
        paths = placement_paths(self.phantom, ROOT if motion == "buckle" else target)
        path = paths[int(generator.integers(len(paths)))]
        length = float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
        deepest = min(length - 0.07, 0.12) if motion != "withdraw" else min(length - 0.1, 0.05)
        place_wire(simulation, path, generator.uniform(0.004, 0.03 if motion == "buckle" else deepest))
        # the same shape, but with the tip turned another way
        turn = generator.uniform(-np.pi, np.pi)
        for _ in range(15):
            simulation.advance(0.0, turn / 15)
        if motion == "buckle":  # some films begin with the loop
            for _ in range(int(generator.integers(10, 110))):
                simulation.advance(0.0018, 0.05 * generator.standard_normal())

    def _shapes(self, moves: RandomMoves, script: Script, in_view: Callable[[np.ndarray], bool]) -> list[np.ndarray]:
        """Returns the shapes until there are enough; fewer where the wire is lost or stays out of view."""
        simulation, unseen = self.simulation, 0
        shapes: list[np.ndarray] = []
        while len(shapes) < script.shapes and unseen < _PATIENCE and simulation.valid:
            seen = in_view(simulation.tip)
            if seen:
                shapes.append(self._whole())
            else:
                unseen += 1
            for _ in range(script.steps):
                advance, turn = moves.next()
                simulation.advance(advance if seen else -MAX_ADVANCE, turn)  # one that is out of view is withdrawn
        return shapes

    def _whole(self) -> np.ndarray:
        """Returns the wire's nodes, and behind them the rest of a wire longer than the simulated one. Shape (n, 3)."""
        points = self.simulation.wire_points()
        return np.vstack([points, points[-1] - _BEHIND * self.simulation.vessel.direction])
