"""Scripted roll-outs: what the wire looks like all over an anatomy, with the truth beside every picture."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np

from enn.reinforcement.sampling import start_state_of

TRUTH = ("shape", "feeder", "force")  # observations that the targets are read from
# what `feeder` is multiplied by, for lengths in mm: one device, or two with the lead of the wire
FEEDER_SCALES = {3: (1e3, 1.0, 1.0), 7: (1e3, 1.0, 1.0, 1e3, 1.0, 1.0, 1e3)}
ARC_LENGTHS_MM = (0.0, 4.0, 8.0, 16.0, 32.0, 64.0)  # of the wire points, behind the tip
ROLL_OUT = (15, 60)  # steps, from and to
BRANCH = 0.85  # share of roll-outs that go on from where an earlier one had come
KEPT_EVERY = 4  # steps
JUMP = 0.35  # share of roll-outs that start at a demonstration's state, where there are any


@dataclass(frozen=True)
class Samples:
    """Observations, and what is to be read off them."""

    observations: dict[str, np.ndarray]  # by name. Shapes (n, ...), images uint8.
    points_mm: np.ndarray  # wire points at `ARC_LENGTHS_MM` behind the tip, world frame. Shape (n, points, 3).
    direction: np.ndarray  # unit vector along the tip. Shape (n, 3).
    # insertion in mm, cosine and sine of the rotation; of two devices each, and the lead in mm. Shape (n, 3) or (n, 7).
    feeder: np.ndarray
    force: np.ndarray  # contact force, N, world frame. Shape (n, 3).
    episode: np.ndarray  # number of the roll-out that a sample is from. Shape (n,).

    def __post_init__(self) -> None:
        count = len(self.points_mm)
        rows = {name: len(array) for name, array in self.observations.items()}
        rows |= {name: len(getattr(self, name)) for name in ("direction", "feeder", "force", "episode")}
        wrong = [f"{name} {length}" for name, length in rows.items() if length != count]
        if wrong:
            raise ValueError(f"expected {count} rows in every array, got {', '.join(wrong)}")

    def __len__(self) -> int:
        return len(self.points_mm)

    def take(self, rows: np.ndarray) -> Samples:
        """The samples of some rows, or of a boolean mask."""
        observations = {name: array[rows] for name, array in self.observations.items()}
        fields = ("points_mm", "direction", "feeder", "force", "episode")
        return Samples(observations, **{name: getattr(self, name)[rows] for name in fields})


def points_behind_tip(shape: np.ndarray, arc_lengths: np.ndarray) -> np.ndarray:
    """Points of a wire at given lengths along it, linear between its nodes.

    Args:
        shape: nodes from the tip to the proximal end, any unit. Shape (nodes, 3).
        arc_lengths: same unit; beyond the proximal end the last node stands. Shape (n,).

    Returns:
        Shape (n, 3).
    """
    lengths = np.linalg.norm(np.diff(shape, axis=0), axis=1)
    at = np.concatenate(([0.0], np.cumsum(lengths)))
    return np.stack([np.interp(arc_lengths, at, shape[:, axis]) for axis in range(3)], axis=1)


class Moves:
    """Persistent random actions: advance, retract, turn on the spot, tremble, each for a while.

    Args:
        size: of an action; two are translation and rotation of the feeder, otherwise the last one is the translation
            and the others are motors of the tip.
    """

    def __init__(self, size: int, generator: np.random.Generator) -> None:
        self.size, self.generator = size, generator
        self._left = 0
        self._translation, self._spread = 0.0, 0.2
        self._others = np.zeros(size - 1)

    def start(self) -> None:
        """Begins a roll-out: the next action belongs to a new move."""
        self._left = 0

    def _draw(self) -> None:
        generator = self.generator
        kind = generator.choice(4, p=(0.5, 0.2, 0.18, 0.12))
        low, high = ((0.2, 1.0), (-1.0, -0.2), (-0.15, 0.15), (-0.3, 0.6))[kind]
        self._translation, self._spread = generator.uniform(low, high), (0.15, 0.15, 0.05, 0.8)[kind]
        self._others = generator.uniform(-1.0, 1.0, self.size - 1)
        if kind < 2 and generator.random() < 0.4:
            self._others[:] = 0.0  # straight in or out
        self._left = int(generator.integers(3, 22))

    def action(self) -> np.ndarray:
        """The next action. Shape (size,), float32."""
        if self._left == 0:
            self._draw()
        self._left -= 1
        noise = self._spread * self.generator.standard_normal(self.size)
        translation = self._translation + noise[0]
        others = self._others + noise[1:]
        parts = (translation, *others) if self.size == 2 else (*others, translation)
        return np.clip(parts, -1.0, 1.0).astype(np.float32)


class PairMoves:
    """Persistent random actions of a wire in a catheter: one of them moves, or both, each by its own or together."""

    def __init__(self, generator: np.random.Generator) -> None:
        self.generator = generator
        self._wire, self._catheter = Moves(2, generator), Moves(2, generator)
        self._left, self._kind = 0, 0

    def start(self) -> None:
        """Begins a roll-out: the next action belongs to a new move."""
        self._left = 0
        self._wire.start()
        self._catheter.start()

    def action(self) -> np.ndarray:
        """The next action: translation and rotation of the wire, then of the catheter. Shape (4,), float32."""
        if self._left == 0:
            self._kind = int(self.generator.choice(4, p=(0.3, 0.25, 0.15, 0.3)))
            self._left = int(self.generator.integers(3, 22))
        self._left -= 1
        wire, catheter = self._wire.action(), self._catheter.action()
        if self._kind == 0:
            catheter[:] = 0.0
        elif self._kind == 1:
            wire[:] = 0.0
        elif self._kind == 2:
            catheter[0] = wire[0]  # both are fed together
        return np.concatenate((wire, catheter))


def moves_of(size: int, generator: np.random.Generator) -> Moves | PairMoves:
    """Random actions of a size: four are those of two devices."""
    return PairMoves(generator) if size == 4 else Moves(size, generator)


class Frontier:
    """States that earlier roll-outs came to, by the cell of space their tip lay in; rarely visited cells come first.

    Roll-outs that always begin in the sheath crowd into the branch that lies straight ahead.
    """

    CELL = 0.006  # side of a cell, m
    CAPACITY = 12  # states kept a cell; with more, each seen one is kept with equal probability

    def __init__(self, generator: np.random.Generator) -> None:
        self.generator = generator
        self._cells: list[list[np.ndarray]] = []
        self._visits: list[int] = []
        self._index: dict[tuple[int, ...], int] = {}

    def __len__(self) -> int:
        return len(self._cells)

    def add(self, state: np.ndarray, tip: np.ndarray) -> None:
        """Keeps a state whose tip lies at a position, m. Shape (3,)."""
        key = tuple(int(number) for number in np.floor(tip / self.CELL))
        index = self._index.setdefault(key, len(self._cells))
        if index == len(self._cells):
            self._cells.append([])
            self._visits.append(0)
        self._visits[index] += 1
        states = self._cells[index]
        if len(states) < self.CAPACITY:
            states.append(state)
        elif (place := int(self.generator.integers(self._visits[index]))) < self.CAPACITY:
            states[place] = state

    def draw(self) -> np.ndarray | None:
        """A kept state; None while there is none."""
        if not self._cells:
            return None
        weights = 1.0 / np.asarray(self._visits, np.float64)
        cell = self._cells[int(self.generator.choice(len(weights), p=weights / weights.sum()))]
        return cell[int(self.generator.integers(len(cell)))]


def _boxes(env: gymnasium.Env[Any, Any]) -> dict[str, gymnasium.spaces.Box]:
    space = env.observation_space
    if not isinstance(space, gymnasium.spaces.Dict):
        raise ValueError(f"expected an environment with a Dict observation, got {space}: pass observation=(name, ...)")
    missing = [name for name in TRUTH if name not in space.spaces]
    if missing:
        raise ValueError(
            f"samples need the observations {', '.join(TRUTH)} for their targets, but {', '.join(missing)} is missing: "
            "add it to the environment's observation"
        )
    return {name: box for name, box in space.spaces.items() if isinstance(box, gymnasium.spaces.Box)}


def scripted_samples(
    make_env: Callable[[], gymnasium.Env[Any, Any]],
    count: int,
    seed: int,
    *,
    starts: np.ndarray | None = None,
    seen: Sequence[str] = (),
    progress: Callable[[int, int], None] | None = None,
) -> Samples:
    """Rolls out random moves, from the sheath, from states that earlier ones reached, and from demonstrations.

    Args:
        make_env: makes the environment. Its observation is a Dict with `TRUTH` and the names to learn from; with a tiny
            success radius no roll-out ends at the target, so that one set serves every target of an anatomy.
        starts: states that `reset(options={"start": ...})` takes, such as those along demonstrations. Shape (k, size).
        seen: those of `TRUTH` that are also learnt from.
        progress: called with the samples so far and `count`, about a hundred times.

    Raises:
        ValueError: count is not positive, or the environment does not observe the targets.
    """
    if count < 1:
        raise ValueError(f"count must be at least 1, got {count}")
    env = make_env()
    boxes = _boxes(env)
    generator = np.random.default_rng(seed)
    size = int(np.prod(env.action_space.shape or (0,)))
    moves, frontier = moves_of(size, generator), Frontier(generator)
    state_of: Callable[[], np.ndarray] | None = None
    with contextlib.suppress(ValueError):  # without states, roll-outs begin where the environment begins
        state_of = start_state_of(env)
    observations = {name: np.empty((count, *box.shape), box.dtype) for name, box in boxes.items()}
    episode = np.empty(count, np.int32)
    row, number, report = 0, -1, max(count // 100, 1)
    while row < count:
        number += 1
        start = None
        if starts is not None and len(starts) and generator.random() < JUMP:
            start = np.asarray(starts[int(generator.integers(len(starts)))])
        elif generator.random() < BRANCH:
            start = frontier.draw()
        options = None if start is None else {"start": start}
        observation, _ = env.reset(seed=int(generator.integers(2**31)), options=options)
        moves.start()
        for _ in range(int(generator.integers(ROLL_OUT[0], ROLL_OUT[1]))):
            for name, array in observations.items():
                array[row] = observation[name]
            episode[row] = number
            row += 1
            if progress is not None and (row % report == 0 or row == count):
                progress(row, count)
            if row == count:
                break
            observation, _, terminated, truncated, _ = env.step(moves.action())
            if terminated or truncated:
                break
            if state_of is not None and row % KEPT_EVERY == 0:
                frontier.add(state_of(), observation["shape"][0])
    env.close()
    return _with_targets(observations, episode, seen)


def _with_targets(observations: dict[str, np.ndarray], episode: np.ndarray, seen: Sequence[str]) -> Samples:
    shapes = 1e3 * observations["shape"].astype(np.float64)
    at = np.asarray(ARC_LENGTHS_MM)
    points = np.stack([points_behind_tip(shape, at) for shape in shapes])
    ahead = shapes[:, 0] - shapes[:, 1]
    direction = ahead / np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-9)
    feeder = observations["feeder"].astype(np.float64)
    feeder *= FEEDER_SCALES[feeder.shape[1]]
    seen_arrays = {name: array for name, array in observations.items() if name not in TRUTH or name in seen}
    return Samples(
        seen_arrays,
        points.astype(np.float32),
        direction.astype(np.float32),
        feeder.astype(np.float32),
        observations["force"].astype(np.float32),
        episode,
    )
