"""Two devices in a composer model: the rod that rewrites the chain as one device slides and turns along the other."""

from __future__ import annotations

import numpy as np
from dm_control import mjcf

from cathsim.contact.sdf import Vessel
from cathsim.devices.arena import ROTATE, max_insertion
from cathsim.devices.hubs import Hubs, Move
from cathsim.devices.pair import DevicePair
from cathsim.devices.rod import CATHETER, DEVICES, Rod, device_tables
from cathsim.devices.simulation import covered_model
from cathsim.presets import Accuracy

CHAIN, FEEDER = "feeder/guidewire/", "feeder/"


class TwoDevices:
    """A wire in a catheter, or a catheter alone, in the model of one `Physics`.

    Attributes:
        chain: the chain in which both lie, as a wire.
        hubs: where the devices' hubs stand.
    """

    def __init__(self, vessel: Vessel, pair: DevicePair, numerics: Accuracy) -> None:
        self.pair, self._tables = pair, device_tables(pair, numerics)
        both = sum(table.linear_density for table in self._tables if table)
        self.chain = pair.chain(both, pair.radius)
        self._weights = covered_model(vessel, pair, self.chain, numerics)[1]
        self.hubs = Hubs(pair, max_insertion(self.chain))
        self._twist = np.zeros((DEVICES, self.chain.joints))
        self._rod: Rod | None = None

    def join(self, physics: mjcf.Physics) -> None:
        """Takes over the model of a physics, which was just compiled."""
        self._rod = Rod(
            physics.model.ptr,
            self._tables,
            self.chain.links,
            self._weights,
            self._twist,
            rigid=self.pair.torsion == "rigid",
            chain=CHAIN,
            rotation=FEEDER + ROTATE,
        )

    def place(self, insertion: float, rotation: float, catheter: Move) -> float:
        """Puts both devices at a start, without twist; returns the chain's insertion, m; arguments as `Hubs.place`."""
        at = self.hubs.place(insertion, rotation, catheter)
        self._twist[:] = np.array(self.hubs.angles)[:, None] - rotation
        assert self._rod is not None
        self._rod.place(self.hubs.lead, self.hubs.angles)
        return at

    def command(self, chain: float, wire: Move, catheter: Move, reach: tuple[float, float]) -> Move:
        """Sets the coming control step's movements; returns the chain's; arguments as `Hubs.command`."""
        move = self.hubs.command(chain, wire, catheter, reach)
        assert self._rod is not None
        self.hubs.hand_over(self._rod)
        return move

    def update(self, physics: mjcf.Physics, share: float) -> None:
        """Brings the model to a share (0 to 1) of the control step."""
        assert self._rod is not None
        self._rod.update(physics.data.ptr, share)

    def info(self, chain: float) -> dict[str, float]:
        """What `info` of `NavigateEnv` says of both devices, less forces, at the chain's insertion (m)."""
        hubs, places = self.hubs, self.hubs.insertions(chain)
        return {
            "insertion": places[hubs.only],
            "rotation": hubs.angles[hubs.only],
            "catheter_insertion": places[CATHETER],
            "catheter_rotation": hubs.angles[CATHETER] if self.pair.catheter else 0.0,
            "lead": hubs.lead,
        }

    def state(self, chain: float) -> np.ndarray:
        """Insertion (m) and angle of the hub (rad), wire first, where the chain's insertion (m) is given. Shape (2, 2).

        An absent device's row is zero.
        """
        rows = np.array((self.hubs.insertions(chain), self.hubs.angles)).T
        present = [self.pair.wire is not None, self.pair.catheter is not None]
        return np.where(np.array(present)[:, None], rows, 0.0)
