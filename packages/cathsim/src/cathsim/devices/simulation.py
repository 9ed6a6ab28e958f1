"""A wire in a catheter in a vessel: state, stepping, forces and shapes, without any task."""

from __future__ import annotations

import ctypes
import math
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy import Phantom
from cathsim.contact.compliance import soften_contacts
from cathsim.contact.sdf import Vessel, vessel_of
from cathsim.devices.active_chain import ActiveChain
from cathsim.devices.arena import FEEDER, FEEDER_DAMPING, FEEDER_STIFFNESS, compiled_model, max_insertion
from cathsim.devices.hubs import DEVICE_NAMES, Hubs
from cathsim.devices.pair import DevicePair, points_behind
from cathsim.devices.rod import CATHETER, DEVICES, WIRE, Rod, device_tables, twin
from cathsim.guidewire import Guidewire
from cathsim.lifetime_cache import kept_with_owner
from cathsim.presets import PACES, Accuracy, Pace, dividing
from cathsim.simulation import NO_STATE, Simulation, not_finite

_ONE_DEVICE = (
    "the pair has one device, which translation and rotation move, or insertion and rotation place: leave catheter out"
)
_UNTWIST = 200  # iterations of the twist at a new start, at most

Array = NDArray[np.float64]


@kept_with_owner
def covered_model(
    vessel: Vessel, pair: DevicePair, chain: Guidewire, numerics: Accuracy, breathes: bool = False
) -> tuple[mujoco.MjModel, Array]:
    """The model of a chain that the outer device covers, and the inverse weights of a bare and of a covered chain."""
    tables = device_tables(pair)
    both = sum(table.linear_density for table in tables if table)
    inner = next(table for table in tables if table)
    spread = pair.chain(both, pair.radius).distal(len(chain.links))
    bare = pair.chain(inner.linear_density, inner.struct.radius).distal(len(chain.links))
    models = [compiled_model(vessel, one, numerics, breathes=breathes) for one in (bare, spread)]
    first = models[0].body(FEEDER).id
    weights = np.stack([model.body_invweight0[first : first + len(chain.links)] for model in models])
    return models[1], weights.copy()


class _PairChain(ActiveChain):
    """A chain whose model belongs to one simulation, with the rod that rewrites it."""

    def __init__(self, rod: Rod, model: mujoco.MjModel, links: int, **settings: Any) -> None:
        numerics: Accuracy = settings["numerics"]
        step = numerics.timestep / numerics.refinement
        twins = twin(model, step), twin(model, step / numerics.refinement)
        fine, finest = (ctypes.addressof(one) for one in twins)
        super().__init__((model, fine, finest), twins, links, **settings)
        self.rod = rod
        self.struct.rod = rod.address


class DualSimulation(Simulation):
    """A guidewire and a catheter, fed through one sheath into a phantom.

    Both lie in one chain of links, whose end is the tip of the device that is further in (`tip`, `wire_points`);
    `device_points` gives each device. Insertions and rotations are those of the devices' hubs. Friction between the
    devices is left out, and where the catheter covers the wire, moving the wire moves the catheter's surface along the
    wall with it.

    Args:
        pair: the devices, of which one may be absent.
        pace: as of `Simulation`.
        settings: entry, measure_penetration, wall_stiffness and breathing, as of `Simulation`; blood, which flows past
            a rod of the outer device's diameter.

    Raises:
        ValueError: the phantom has no such entry, or the devices are too short.
    """

    def __init__(
        self,
        phantom: Phantom,
        pair: DevicePair,
        numerics: Accuracy,
        *,
        contact: str = "sdf",
        tip_motors: bool = False,
        pace: Pace = PACES["usual"],
        **settings: Any,
    ) -> None:
        if contact != "sdf" or tip_motors:
            raise ValueError(
                "two devices are simulated with contact 'sdf' and without tip motors: leave out the catheter for the "
                "others"
            )
        self.pair = pair
        numerics = dividing(numerics.with_catheter, pace.interval)
        self.tables = device_tables(pair, numerics)
        both = sum(table.linear_density for table in self.tables if table)
        chain = pair.chain(both, pair.radius)
        self.twist = np.zeros((DEVICES, chain.joints))
        self._hubs = Hubs(pair, max_insertion(chain))
        super().__init__(phantom, chain, numerics, pace=pace, **settings)

    def arguments(self) -> tuple[tuple[Phantom, Any, Accuracy], dict[str, Any]]:
        """As of `Simulation`, with the devices as a pair."""
        return (self.phantom, self.pair, self.numerics), super().arguments()[1]

    def _make_vessel(self) -> Vessel:
        return vessel_of(self.phantom, self.entry, self.pair.sheath_radius, self.pair.sheath_flare)

    def _make_chain(self, wire: Guidewire) -> ActiveChain:
        pattern, weights = covered_model(
            self.vessel, self.pair, wire, self.numerics, breathes=self.breathing is not None
        )
        model = pattern.__copy__()
        if self.wall_stiffness is not None:
            soften_contacts(model, len(wire.links))
        twist = self.twist[:, self.twist.shape[1] - len(wire.links) + 1 :]
        rod = Rod(model, self.tables, wire.links, weights, twist, rigid=self.pair.torsion == "rigid")
        return _PairChain(rod, model, len(wire.links), **self._chain_settings())

    @property
    def _rod(self) -> Rod:
        assert isinstance(self._chain, _PairChain)
        return self._chain.rod

    def device_insertions(self) -> tuple[float, float]:
        """How far wire and catheter are advanced, m; of an absent one, as the other."""
        return self._hubs.insertions(float(self.data.qpos[0]))

    def device_rotations(self) -> tuple[float, float]:
        """Angles of both hubs, rad."""
        return self._hubs.angles[WIRE], self._hubs.angles[CATHETER]

    def catheter_place(self) -> tuple[float, float]:
        """Insertion (m) of the catheter and angle (rad) of its hub; of an absent one, as the wire's, and 0."""
        return self.device_insertions()[CATHETER], self._hubs.angles[CATHETER] if self.pair.catheter else 0.0

    def tip_rotations(self) -> Array:
        """Angles of both tips, rad: those of the hubs, less the torsion between. Shape (2,), NaN of an absent one."""
        turns = np.full(DEVICES, np.nan)
        around = self._turns_about_links()
        for device, table in enumerate(self.tables):
            if table is not None:
                turns[device] = self.twist[device, -1] + self.data.qpos[1] + around.sum() - around[-1] / 2
        return turns

    def _turns_about_links(self) -> Array:
        # what the two hinges of each joint turn a link about its own axis, rad
        bends = self.data.qpos[2:].reshape(-1, 2)
        return np.asarray(2 * np.arctan(np.tan(bends[:, 0] / 2) * np.tan(bends[:, 1] / 2)))

    @property
    def leading(self) -> int:
        """The device whose tip is the chain's end: 0 the wire, 1 the catheter."""
        return self._hubs.leading

    def turn_of_leading(self) -> float:
        """Angle by which the leading device's cross-section at its tip is turned about the chain's last link, rad."""
        return float(self.twist[self.leading, -1] - self._turns_about_links()[-1] / 2)

    @property
    def insertion(self) -> float:
        """How far the wire is advanced, or the catheter that is alone, m."""
        return self.device_insertions()[self._hubs.only]

    @property
    def rotation(self) -> float:
        """Angle of the wire's hub, or of the catheter's that is alone, rad."""
        return self._hubs.angles[self._hubs.only]

    @property
    def device_lead(self) -> float:
        """How far the wire's tip is ahead of the catheter's, m; negative: withdrawn into it; 0 with one device."""
        return self._hubs.lead

    def reset(
        self,
        insertion: float = 0.0,
        rotation: float = 0.0,
        *,
        time: float = 0.0,
        catheter: tuple[float, float] | None = None,
    ) -> None:
        """Puts both devices straight into the sheath and lets them unbend for 0.3 s.

        Args:
            insertion: of the wire, m; of the catheter where there is no wire.
            rotation: of its hub, rad.
            time: at which they then are, s: where in a breath.
            catheter: the catheter's insertion (m) and rotation of its hub (rad); None: as far back as it may be, and
                not turned. With one device, the same as `insertion` and `rotation`.

        Raises:
            ValueError: an insertion out of range, a rotation that is not finite, a lead beyond the pair's limits, or a
                place of a second device where there is one device.
        """
        if catheter is not None:
            if not self.pair.both and tuple(catheter) != (insertion, rotation):
                raise ValueError(_ONE_DEVICE)
            if not all(map(math.isfinite, catheter)):
                place = ", ".join(map(str, catheter))
                raise ValueError(f"the catheter's insertion (m) and rotation (rad) must be finite, got {place}")
        chain = self._hubs.place(insertion, rotation, catheter)
        self.twist[:] = np.array(self._hubs.angles)[:, None] - rotation
        super().reset(chain, rotation, time=time)
        # while the chain gave way for a moment, a hub at its start kept it from taking the lead along
        self._hubs.place(insertion, rotation, catheter)

    def let_untwist(self) -> None:
        """Lets the devices' twist come to rest for the bends of the moment, which were set from outside."""
        self._rod.place(self._hubs.lead, self._hubs.angles)
        self._rod.untwist(self.data, most=_UNTWIST)

    def _change_chain(self, index: int) -> None:
        before = self.active_links - 1
        super()._change_chain(index)
        joints, total = self.active_links - 1, self.twist.shape[1]
        if joints > before:  # the added links are straight: twist is linear between the hub and them
            known = self.twist[:, total - before]
            at_hub = np.array(self._hubs.angles) - self.data.qpos[1]
            lengths = np.array([table.struct.length if table else 1.0 for table in self.tables])
            from_end = np.cumsum(self.wire.links[::-1])[::-1][-before:][0]
            added = np.cumsum(self.wire.links[::-1])[::-1][total + 1 - joints : total + 1 - before]
            share = (added[None, :] - from_end) / (lengths[:, None] - from_end)
            self.twist[:, total - joints : total - before] = known[:, None] + share * (at_hub - known)[:, None]
        self._hubs.hand_over(self._rod)

    def advance(
        self,
        translation: float,
        rotation: float,
        motors: Array | None = None,
        *,
        catheter: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        """One control step, both feeders moving at constant speed.

        A movement that would leave the limits of lead, or of the insertion, is cut short.

        Args:
            translation: of the wire's feeder, m; positive inserts. With a catheter alone, the catheter's.
            rotation: of the wire's hub, rad; positive about the direction of insertion.
            motors: must be None.
            catheter: translation (m) and rotation (rad) of the catheter's; zeros with one device.

        Raises:
            ValueError: a movement that is not finite, motors, or a second device's movement where there is one device.
        """
        if not math.isfinite(translation + rotation + catheter[0] + catheter[1]):
            raise ValueError(not_finite(translation, rotation, *catheter))
        if motors is not None:
            raise ValueError("a simulation with a catheter has no tip motors: leave motors out")
        if (catheter[0] or catheter[1]) and not self.pair.both:
            raise ValueError(_ONE_DEVICE)
        hubs, at = self._hubs, float(self.data.qpos[0])
        translation, turn = hubs.command(at, (translation, rotation), catheter, self._reach(at))
        hubs.hand_over(self._rod)
        self._advance(translation, turn)
        hubs.arrive()

    def feeder_forces(self) -> Array:
        """What wire's and catheter's feeders push with, N, positive inserts. Shape (2,), 0 of an absent one."""
        drive = self._to[0] - self.data.qpos[0]
        chain = FEEDER_STIFFNESS * drive - FEEDER_DAMPING * self.data.qvel[0]
        forces = np.array(self._rod.struct.feeder_force[:])
        forces[self.leading] += chain
        return forces

    def hub_torques(self) -> Array:
        """Torques by which both hubs are held, N m. Shape (2,), 0 of an absent one."""
        return np.array(self._rod.struct.hub_torque[:])

    def device_points(self, device: str) -> Array:
        """A device from its tip to the chain's proximal end, m. Shape (k, 3); (0, 3) of an absent one.

        Raises:
            ValueError: there is no such device.
        """
        if device not in DEVICE_NAMES:
            raise ValueError(f"unknown device '{device}'; there are {', '.join(DEVICE_NAMES)}")
        index = DEVICE_NAMES.index(device)
        if self.tables[index] is None:
            return np.empty((0, 3))
        behind = max(-self.device_lead, 0.0) if index == WIRE else max(self.device_lead, 0.0)
        return points_behind(self.wire_points(), self.wire.links, behind)

    def state(self) -> Array:
        """As of `Simulation`, followed by lead, both hubs' angles and both devices' twist at each joint."""
        return np.concatenate((super().state(), [self._hubs.lead, *self._hubs.angles], self.twist.ravel()))

    def restore(self, state: Array) -> None:
        """Returns to a state of a simulation with the same arguments.

        Raises:
            ValueError: the state has another size, is not finite, or is of another simulation.
        """
        extra = 1 + DEVICES + self.twist.size
        if len(state) != len(super().state()) + extra:
            raise ValueError(f"expected a state of shape ({len(super().state()) + extra},), got {state.shape}")
        if not np.isfinite(state[-extra:]).all():
            raise ValueError(NO_STATE)
        self._hubs.set(float(state[-extra]), state[1 - extra : 1 - extra + DEVICES].tolist())
        super().restore(state[:-extra])
        self.twist[:] = state[len(state) - self.twist.size :].reshape(self.twist.shape)
        rod = self._rod
        rod.struct.feeder_force[:] = rod.struct.hub_torque[:] = [0.0] * DEVICES
        rod.place(self._hubs.lead, self._hubs.angles)
        rod.untwist(self.data, most=0)  # the model is that of the lead, also before the next step

    def force_state(self) -> tuple[bytes, Array, Array, Array]:
        """As of `Simulation`, with forces and torques of the feeders."""
        summary, points, forces, loads = super().force_state()
        rod = self._rod.struct
        return summary + bytes(rod.feeder_force) + bytes(rod.hub_torque), points, forces, loads

    def restore_forces(self, state: tuple[bytes, Array, Array, Array]) -> None:
        """Returns to a measurement of `force_state`."""
        super().restore_forces(state)
        held = np.frombuffer(state[0], np.float64, 2 * DEVICES, len(state[0]) - 2 * DEVICES * 8)
        rod = self._rod.struct
        rod.feeder_force[:], rod.hub_torque[:] = held[:DEVICES].tolist(), held[DEVICES:].tolist()
