"""Which links of the wire are simulated: the inserted ones and a few in the sheath, so that cost follows the insertion.

A wire of N links has a ladder of models, each of its most distal links. All share the feeder's coordinates, so a state
passes from one rung to the next by adding or dropping straight links at the proximal end.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import mujoco
import numpy as np

from cathsim.arena import PROTRUSION, RESERVE, compiled_model
from cathsim.contact.compliance import soften_contacts
from cathsim.contact.sdf import Vessel
from cathsim.guidewire import Guidewire
from cathsim.lifetime_cache import kept_with_owner
from cathsim.presets import Accuracy

SPACING = 0.016  # least difference in length between rungs, m
HYSTERESIS = 0.010  # how far the wire is drawn back before links are dropped, m


@dataclass(frozen=True)
class Ladder:
    """The numbers of links that can be simulated, and how far each reaches."""

    counts: tuple[int, ...]  # increasing; the last is the whole wire
    reach: tuple[float, ...]  # greatest insertion of each, m

    @staticmethod
    def of(wire: Guidewire) -> Ladder:
        """The ladder of a wire."""
        lengths = list(itertools.accumulate(reversed(wire.links)))  # of the most distal 1, 2, … links
        counts = [len(wire.links)]
        # the tip's motors need their joints, and the shortest rung must hold the wire at zero insertion
        least = max(wire.motor_joints + 1, 2)
        for count in range(len(wire.links) - 1, least - 1, -1):
            if lengths[counts[-1] - 1] - lengths[count - 1] >= SPACING - 1e-9:
                counts.append(count)
        counts = [count for count in counts if lengths[count - 1] - PROTRUSION - RESERVE >= 0] or [len(wire.links)]
        counts.reverse()
        return Ladder(tuple(counts), tuple(lengths[count - 1] - PROTRUSION - RESERVE for count in counts))

    def rung(self, insertion: float, current: int | None = None) -> int:
        """Index of the shortest rung for an insertion (m), keeping the current one within the hysteresis."""
        needed = next((i for i, reach in enumerate(self.reach) if reach >= insertion - 1e-9), len(self.reach) - 1)
        if current is None or needed >= current:
            return needed
        lower = next(i for i, reach in enumerate(self.reach) if reach >= insertion + HYSTERESIS or i == current)
        return min(lower, current)


@kept_with_owner
def rung_models(
    vessel: Vessel,
    wire: Guidewire,
    numerics: Accuracy,
    tip_motors: bool,
    compliant: bool = False,
    breathes: bool = False,
) -> tuple[mujoco.MjModel, mujoco.MjModel, mujoco.MjModel]:
    """The model of a wire and its twins, refined once and twice, shared by every simulation with the same arguments.

    Args:
        compliant: the wall's contacts are springs integrated implicitly, whose stiffness the native step sets.
        breathes: the vessel moves, as the native step says.
    """
    model = compiled_model(vessel, wire, numerics, tip_motors=tip_motors, breathes=breathes)
    fine, finest = model.__copy__(), model.__copy__()
    fine.opt.timestep = numerics.timestep / numerics.refinement
    finest.opt.timestep = fine.opt.timestep / numerics.refinement
    for one in (model, fine, finest) if compliant else ():
        soften_contacts(one, len(wire.links))
    return model, fine, finest


def pass_on(source: np.ndarray, size: int, *, bend: bool) -> np.ndarray:
    """A state vector (feeder's 2 numbers, then 2 a joint from the proximal end) for another number of joints.

    Args:
        source: positions, velocities or accelerations. Shape (2 + 2 joints,).
        size: of the result, which has shape (size,).
        bend: positions: the bend of dropped joints goes to the first that stays, so that the wire keeps its direction.
    """
    extra = size - len(source)
    if extra >= 0:
        return np.concatenate((source[:2], np.zeros(extra), source[2:]))
    result = np.concatenate((source[:2], source[2 - extra :]))
    if bend:
        result[2:4] += source[2 : 2 - extra].reshape(-1, 2).sum(0)
    return result
