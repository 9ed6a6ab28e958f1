"""Which links of the wire are simulated: the inserted ones and a few in the sheath, so that cost follows the insertion.

A wire of N links has several models, each of its most distal links. All share the feeder's coordinates, so a state
passes from one chain to the next by adding or dropping straight links at the proximal end.
"""

from __future__ import annotations

import ctypes
import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from cathsim.contact.breathing import Breathing
from cathsim.contact.compliance import N_PER_MM, soften_contacts
from cathsim.contact.native import SimulationStruct, library
from cathsim.contact.sdf import GEOM_NAME, Vessel
from cathsim.devices.arena import FEEDER, PROTRUSION, RESERVE, compiled_model
from cathsim.guidewire import LINK_NAME, TIP_SITE, Guidewire
from cathsim.lifetime_cache import kept_with_owner
from cathsim.presets import Accuracy

if TYPE_CHECKING:
    from cathsim.blood.drag import Drag


SPACING = 0.016  # least difference in length between chains, m
HYSTERESIS = 0.010  # how far the wire is withdrawn before links are dropped, m


@dataclass(frozen=True)
class ActiveChains:
    """The numbers of links that can be simulated, and how far each reaches."""

    counts: tuple[int, ...]  # increasing; the last is the whole wire
    reach: tuple[float, ...]  # greatest insertion of each, m

    @staticmethod
    def of(wire: Guidewire) -> ActiveChains:
        """The chains of a wire."""
        lengths = list(itertools.accumulate(reversed(wire.links)))  # of the most distal 1, 2, … links
        counts = [len(wire.links)]
        # the tip's motors need their joints, and the shortest chain must hold the wire at zero insertion
        least = max(wire.motor_joints + 1, 2)
        for count in range(len(wire.links) - 1, least - 1, -1):
            if lengths[counts[-1] - 1] - lengths[count - 1] >= SPACING - 1e-9:
                counts.append(count)
        counts = [count for count in counts if lengths[count - 1] - PROTRUSION - RESERVE >= 0] or [len(wire.links)]
        counts.reverse()
        return ActiveChains(tuple(counts), tuple(lengths[count - 1] - PROTRUSION - RESERVE for count in counts))

    def index_for(self, insertion: float, current: int | None = None) -> int:
        """Index of the shortest chain for an insertion (m), keeping the current one within the hysteresis."""
        needed = next((i for i, reach in enumerate(self.reach) if reach >= insertion - 1e-9), len(self.reach) - 1)
        if current is None or needed >= current:
            return needed
        lower = next(i for i, reach in enumerate(self.reach) if reach >= insertion + HYSTERESIS or i == current)
        return min(lower, current)


@kept_with_owner
def chain_models(
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


class ActiveChain:
    """A chain of links that is simulated: its model with its data, and the native struct of both.

    Args:
        models: the model, and the addresses of its twins with shorter timesteps.
        references: what must live as long as the chain, because the native struct points to it.
        links: number of links of the model.
        depth_samples: points a link at which the penetration is measured; 0: it is not.
        wall_stiffness: of each contact with the wall, N/mm; None: the usual contact's.
        breathing: of the vessel, for which the models have memory; None: it does not move.
    """

    def __init__(
        self,
        models: tuple[mujoco.MjModel, int, int],
        references: tuple[Any, ...],
        links: int,
        *,
        vessel: Vessel,
        numerics: Accuracy,
        depth_samples: int,
        drag: Drag | None,
        wall_stiffness: float | None,
        breathing: Breathing | None,
    ) -> None:
        self.model, fine, finest = models
        self.data = mujoco.MjData(self.model)
        self._references = references
        self._saved = np.zeros(self.model.nq + 2 * self.model.nv)
        self._workspace = np.empty(library().cathsim_solver_workspace(self.model.nv))
        first = self.model.geom(LINK_NAME.format(0)).id
        self.loads = np.zeros((links if drag else 0, 6))
        self.struct = SimulationStruct(
            model=self.model._address,
            fine=fine,
            finest=finest,
            data=self.data._address,
            saved=self._saved.ctypes.data,
            workspace=self._workspace.ctypes.data,
            solver_rows=library().cathsim_solver_rows(),
            vessel_geom=self.model.geom(GEOM_NAME).id,
            hulls=vessel.wall_parts(self.model),
            first_geom=first,
            last_geom=first + links - 1,
            refinement=numerics.refinement,
            tolerance=numerics.tolerance,
            rise=numerics.rise,
            deep=numerics.deep,
            depth_samples=depth_samples,
            drag=drag.address if drag else None,
            loads=self.loads.ctypes.data,
            wall_stiffness=N_PER_MM * (wall_stiffness or 0.0),
            breath_rate=breathing.rate if breathing else 0.0,
        )
        self.struct.breath[:] = breathing.farthest.tolist() if breathing else [0.0] * 3
        self.reference = ctypes.byref(self.struct)
        self._tip_site = self.model.site(TIP_SITE).id
        self.tip = self.data.site_xpos[self._tip_site]
        # links 1, 2, … follow the feeder's body in the order of the chain
        feeder = self.model.body(FEEDER).id
        self.nodes = self.data.xpos[feeder : feeder + links]

    def go_on_from(self, other: ActiveChain) -> None:
        """Takes over the state of another chain of the same wire."""
        old, new = other.data, self.data
        mujoco.mj_resetData(self.model, new)
        new.qpos[:] = pass_on(old.qpos, self.model.nq, bend=True)
        new.qvel[:] = pass_on(old.qvel, self.model.nv, bend=False)
        new.qacc_warmstart[:] = pass_on(old.qacc_warmstart, self.model.nv, bend=False)
        new.time, self.struct.depth = old.time, other.struct.depth

    def tip_velocity(self) -> np.ndarray:
        """Velocity of the tip, m/s, world frame. Shape (3,)."""
        velocity = np.empty(6)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_comVel(self.model, self.data)
        mujoco.mj_objectVelocity(self.model, self.data, mujoco.mjtObj.mjOBJ_SITE, self._tip_site, velocity, 0)
        return velocity[3:]
