"""One rung of the ladder of models: a model of the simulated links, its data, and the native struct of both."""

from __future__ import annotations

import ctypes
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from cathsim.arena import FEEDER
from cathsim.contact.breathing import Breathing
from cathsim.contact.compliance import N_PER_MM
from cathsim.contact.native import SimulationStruct, library
from cathsim.contact.sdf import GEOM_NAME, Vessel
from cathsim.guidewire import LINK_NAME, TIP_SITE
from cathsim.presets import Accuracy

if TYPE_CHECKING:
    from cathsim.blood.drag import Drag


class Rung:
    """One model of the ladder with its data, and the native struct of both.

    Args:
        models: the model, and the addresses of its twins with shorter timesteps.
        kept: what must live as long as the rung, because the native struct points to it.
        links: number of links of the model.
        depth_samples: points a link at which the penetration is measured; 0: it is not.
        wall_stiffness: of each contact with the wall, N/mm; None: the usual contact's.
        breathing: of the vessel, for which the models have room; None: it does not move.
    """

    def __init__(
        self,
        models: tuple[mujoco.MjModel, int, int],
        kept: tuple[Any, ...],
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
        self._kept = kept
        self._saved = np.zeros(self.model.nq + 2 * self.model.nv)
        self._room = np.empty(library().cathsim_solver_room(self.model.nv))
        first = self.model.geom(LINK_NAME.format(0)).id
        self.loads = np.zeros((links if drag else 0, 6))
        self.struct = SimulationStruct(
            model=self.model._address,
            fine=fine,
            finest=finest,
            data=self.data._address,
            saved=self._saved.ctypes.data,
            room=self._room.ctypes.data,
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
        self.tip = self.data.site_xpos[self.model.site(TIP_SITE).id]
        # links 1, 2, … follow the feeder's body in the order of the chain
        feeder = self.model.body(FEEDER).id
        self.nodes = self.data.xpos[feeder : feeder + links]
