"""A wire in a vessel: state, stepping, forces and shape, without any task."""

from __future__ import annotations

import ctypes
import math
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from cathsim.anatomy import Phantom
from cathsim.anatomy.entry import EntryLike, entry_name
from cathsim.blood.flow import BloodFlow
from cathsim.contact.breathing import Breathing
from cathsim.contact.compliance import checked_wall_stiffness
from cathsim.contact.native import Contacts, MeasuredContacts, StepSummary, address, engine, library
from cathsim.contact.sdf import Vessel
from cathsim.contact.sdf import vessel_of as vessel_of
from cathsim.devices.active_chain import ActiveChain, ActiveChains, chain_models, pass_on
from cathsim.devices.arena import max_insertion
from cathsim.guidewire import Guidewire
from cathsim.presets import CONTROL_STEP as CONTROL_STEP
from cathsim.presets import PACES, Accuracy, Pace, dividing

if TYPE_CHECKING:
    from cathsim.blood.drag import Drag
    from cathsim.contact.hulls import Decomposition

# The servo's target never runs further ahead of the wire than its force limit can use.
LEAD_ADVANCE, LEAD_ROTATION = 0.004, 0.4
SETTLE_STEPS = 3
NO_STATE = "the state is no state of this simulation: take one that its own state() gave"


class Simulation:
    """A guidewire fed through a sheath into a phantom; one control step lasts 0.1 s, or as `pace` says.

    Only the inserted links and a few in the sheath are simulated; `model` and `data` are those of the moment, and the
    arrays that this class returns always have the size of the whole wire.

    Args:
        entry: as of `Phantom.entry`: a name, or a point (3,) m in the lumen where the sheath ends.
        contact: "sdf", the signed-distance grid; "hulls", convex hulls of the wall, or how finely it is cut into them.
        tip_motors: with motors in the tip's joints.
        blood: that flows past the wire; None: there is none.
        measure_penetration: keeps the deepest penetration after every substep in `depths`, at about 3 % of the speed.
        wall_stiffness: N/mm, 0.1 to `stiffest_wall(numerics)`, of the wall at each contact: normal force over depth;
            takes a third of the speed. None: what the solver makes of the usual contact, 1-2 N/mm at rest.
        pace: duration of a control step and what full actions move in it; the timestep is made to divide it.
        breathing: moves the vessel with the simulated time; None: it does not move.

    Raises:
        ValueError: the phantom has no such entry, the wall is too soft or too stiff, or hulls that are to breathe.
    """

    def __init__(
        self,
        phantom: Phantom,
        wire: Guidewire,
        numerics: Accuracy,
        *,
        entry: EntryLike = "descending",
        contact: str | Decomposition = "sdf",
        tip_motors: bool = False,
        blood: BloodFlow | None = None,
        measure_penetration: bool = False,
        wall_stiffness: float | None = None,
        pace: Pace = PACES["usual"],
        breathing: Breathing | None = None,
    ) -> None:
        if breathing is not None and contact != "sdf":
            raise ValueError(f"a vessel breathes with contact 'sdf', got {contact!r}: leave one of them out")
        self.breathing = breathing
        numerics = dividing(numerics, pace.interval)
        self.phantom, self.wire, self.numerics, self.entry, self.pace = phantom, wire, numerics, entry_name(entry), pace
        self._most_lead = max(LEAD_ADVANCE, 1.5 * pace.translation), max(LEAD_ROTATION, 1.5 * pace.rotation)
        self.wall_stiffness = None if wall_stiffness is None else checked_wall_stiffness(wall_stiffness, numerics)
        self.contact = contact
        self.vessel = self._make_vessel()
        self.tip_motors = tip_motors
        self.substeps = round(pace.interval / numerics.timestep)
        self.max_insertion = max_insertion(wire)
        if self.max_insertion <= 0:
            raise ValueError(f"a wire of {wire.length:.3f} m is too short to be fed through the sheath")
        self.chains = ActiveChains.of(wire)
        self.nq = 2 + 2 * wire.joints
        self.motors = 2 * min(wire.motor_joints, wire.joints) if tip_motors else 0
        self.depth_samples = 6 if measure_penetration else 0
        self.blood = blood
        self.drag: Drag | None = None
        if blood:
            from cathsim.blood.drag import Drag
            from cathsim.blood.field import blood_field

            self.drag = Drag(blood_field(phantom, blood), wire)
        self._chains: dict[int, ActiveChain] = {}

        self.measured = MeasuredContacts(self.substeps)
        self._from, self._to = np.zeros(2 + self.motors), np.zeros(2 + self.motors)
        self._native_step = library().cathsim_step
        self._arguments = (
            ctypes.byref(engine()),
            self.substeps,
            *(address(array) for array in (self._from, self._to)),
            *self.measured.arguments(),
        )
        self.reset()

    def arguments(self) -> tuple[tuple[Phantom, Any, Accuracy], dict[str, Any]]:
        """The arguments by position and the keyword arguments that this simulation was made with."""
        names = "entry", "contact", "tip_motors", "blood", "wall_stiffness", "pace", "breathing"
        keywords = {name: getattr(self, name) for name in names}
        return (self.phantom, self.wire, self.numerics), keywords | {"measure_penetration": self.depth_samples > 0}

    def __getstate__(self) -> dict[str, Any]:
        # models and native structs are made again; MuJoCo's data go along, so that every value in them stays
        return {
            "arguments": self.arguments(),
            "state": self.state(),
            "data": self.data,
            "forces": self.force_state(),
            "depths": self.depths,
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        positional, arguments = state["arguments"]
        self.__init__(*positional, **arguments)  # type: ignore[misc]
        self.restore(state["state"])
        mujoco.mj_copyData(self.data, self.model, state["data"])
        self.depths[:] = state["depths"]
        self.restore_forces(state["forces"])

    def _make_vessel(self) -> Vessel:
        if self.contact == "sdf":
            return vessel_of(self.phantom, self.entry)
        from cathsim.contact.hull_vessel import hull_vessel
        from cathsim.contact.hulls import decomposition

        return hull_vessel(self.phantom, self.entry, decomposition(self.contact))

    def _chain_at(self, index: int) -> ActiveChain:
        if index not in self._chains:
            self._chains[index] = self._make_chain(self.wire.distal(self.chains.counts[index]))
        return self._chains[index]

    def _make_chain(self, wire: Guidewire) -> ActiveChain:
        changed = {"compliant": self.wall_stiffness is not None, "breathes": self.breathing is not None}
        model, fine, finest = chain_models(self.vessel, wire, self.numerics, self.tip_motors, **changed)
        return ActiveChain(
            (model, fine._address, finest._address), (fine, finest), len(wire.links), **self._chain_settings()
        )

    def _chain_settings(self) -> dict[str, Any]:
        names = "vessel", "numerics", "depth_samples", "drag", "wall_stiffness", "breathing"
        return {name: getattr(self, name) for name in names}

    @property
    def model(self) -> mujoco.MjModel:
        """Model of the links that are simulated now."""
        return self._chain.model

    @property
    def data(self) -> mujoco.MjData:
        """State of the links that are simulated now."""
        return self._chain.data

    @property
    def active_links(self) -> int:
        """How many links are simulated now."""
        return self.chains.counts[self._index]

    def reset(self, insertion: float = 0.0, rotation: float = 0.0, *, time: float = 0.0) -> None:
        """Puts the wire straight into the sheath and lets its tip unbend for 0.3 s.

        Args:
            insertion: how far it is advanced, m.
            rotation: of its proximal end, rad.
            time: at which it then is, s: where in a breath.
        """
        self._check_insertion(insertion)
        if not math.isfinite(rotation):
            raise ValueError(f"rotation must be a finite number (rad), got {rotation}")
        self._index = self.chains.index_for(insertion)
        self._chain = self._chain_at(self._index)
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:2] = insertion, rotation
        self._to[:] = 0.0
        self._to[:2] = insertion, rotation
        self._chain.struct.depth = 0.0
        if self.breathing is not None:
            self.data.time = time - SETTLE_STEPS * self.pace.interval
        for _ in range(SETTLE_STEPS):
            self.advance(0.0, 0.0)
        self.data.time = time
        self.measured.clear()

    def _check_insertion(self, insertion: float) -> None:
        if not 0 <= insertion <= self.max_insertion:
            raise ValueError(f"insertion must lie in 0 to {self.max_insertion:.3f} m, got {insertion}")

    def _change_chain(self, index: int) -> None:
        """Goes on with more or fewer links, in the same state."""
        old, self._index, self._chain = self._chain, index, self._chain_at(index)
        self._chain.go_on_from(old)

    def advance(self, translation: float, rotation: float, motors: np.ndarray | None = None) -> None:
        """One control step, the feeder moving at constant speed.

        Args:
            translation: of the feeder, m; positive inserts.
            rotation: of the feeder, rad; positive about the direction of insertion.
            motors: of the tip, share of their range, -1 to 1. Shape (motors,).

        Raises:
            ValueError: a movement that is not finite.
        """
        if not math.isfinite(translation + rotation):
            raise ValueError(not_finite(translation, rotation))
        if motors is not None and not np.isfinite(motors).all():
            raise ValueError(f"the motors' shares must be finite, got {np.asarray(motors).tolist()}")
        self._advance(translation, rotation, motors)

    def _advance(self, translation: float, rotation: float, motors: np.ndarray | None = None) -> None:
        """As `advance`, of a movement that may be that of a state which is no longer finite."""
        to, qpos = self._to, self.data.qpos
        self._from[:] = to
        at, angle = float(qpos[0]), float(qpos[1])
        most_advance, most_rotation = self._most_lead
        lead = min(max(float(to[0]) + translation - at, -most_advance), most_advance)
        target = min(max(at + lead, 0.0), self.max_insertion)
        to[0] = target
        lead = min(max(float(to[1]) + rotation - angle, -most_rotation), most_rotation)
        to[1] = angle + lead
        if motors is not None:
            to[2:] = motors * self.model.actuator_ctrlrange[2:, 1]
        index = self.chains.index_for(max(target, at), self._index)
        if index != self._index:
            self._change_chain(index)
        self._native_step(self._chain.reference, *self._arguments)

    def _reach(self, at: float) -> tuple[float, float]:
        # least and most that the feeder's drive can move in a step from the insertion `at`, m
        ahead, most = float(self._to[0]) - at, self._most_lead[0]
        return -most - ahead, most - ahead

    @property
    def last_effort(self) -> int:
        """What the last control step cost, in steps of one link: a guess of what the next one will."""
        return (self.substeps + self.summary.refined * self.numerics.refinement) * self.active_links

    @property
    def valid(self) -> bool:
        """Whether the state is finite and MuJoCo has not complained about it."""
        return self.summary.warnings == 0 and bool(np.isfinite(self.data.qpos).all())

    @property
    def insertion(self) -> float:
        """How far the feeder has advanced, m."""
        return float(self.data.qpos[0])

    @property
    def rotation(self) -> float:
        """Angle of the feeder, rad."""
        return float(self.data.qpos[1])

    @property
    def tip(self) -> np.ndarray:
        """Tip position, m. Shape (3,)."""
        return self._chain.tip.copy()

    @property
    def vessel_displacement(self) -> np.ndarray:
        """By how much breathing displaces the vessel at the moment, m, world frame. Shape (3,)."""
        return np.zeros(3) if self.breathing is None else self.breathing.displacement(float(self.data.time))

    @property
    def tip_in_vessel(self) -> np.ndarray:
        """Tip position in the frame that moves with the vessel, where the phantom lies, m. Shape (3,)."""
        return self.tip if self.breathing is None else self.tip - self.vessel_displacement

    def tip_velocity(self) -> np.ndarray:
        """Velocity of the tip, m/s, world frame. Shape (3,)."""
        return self._chain.tip_velocity()

    def lead(self) -> np.ndarray:
        """How far the feeder's drive is ahead of the wire, -1 to 1 of what it may be: advance, rotation. Shape (2,)."""
        return (self._to[:2] - self.data.qpos[:2]) / self._most_lead

    def joint_positions(self) -> np.ndarray:
        """Feeder's advance (m) and rotation (rad), then two angles (rad) a joint from the proximal end. Shape (nq,)."""
        return pass_on(self.data.qpos, self.nq, bend=False)

    def set_joint_positions(self, positions: np.ndarray) -> None:
        """Puts the wire into `joint_positions` of another moment, without a velocity, its feeder held there.

        Raises:
            ValueError: another shape, or an insertion that the wire cannot have.
        """
        if np.shape(positions) != (self.nq,):
            raise ValueError(f"joint positions must have shape ({self.nq},), got {np.shape(positions)}")
        self._check_insertion(float(positions[0]))
        size = 3 * self.nq + len(self._to) + 3
        state = self.state()
        state[:size] = 0.0
        state[: self.nq] = positions
        state[3 * self.nq : 3 * self.nq + 2] = positions[:2]
        state[size - 2] = np.inf  # it may be set within the wall: only substeps that bring it deeper are repeated
        state[size - 1] = self.chains.index_for(float(positions[0]))
        self.restore(state)

    def joint_velocities(self) -> np.ndarray:
        """Rates of `joint_positions`. Shape (nq,)."""
        return pass_on(self.data.qvel, self.nq, bend=False)

    def wire_points(self) -> np.ndarray:
        """Ends of the links from the tip to the proximal end, m, those in the sheath included. Shape (links + 1, 3)."""
        points, waiting = self.inserted_points(), len(self.wire.links) - self.active_links
        if waiting:
            behind = np.cumsum(self.wire.links[waiting - 1 :: -1])
            points = np.concatenate((points, points[-1] - behind[:, None] * self.vessel.direction))
        return points

    def inserted_points(self) -> np.ndarray:
        """The simulated links' ends from the tip down to the sheath, m. Shape (active links + 1, 3)."""
        return np.concatenate((self._chain.tip[None], self._chain.nodes[::-1]))

    @property
    def summary(self) -> StepSummary:
        """What the last control step was like as a whole."""
        return self.measured.summary

    @property
    def depths(self) -> np.ndarray:
        """Deepest penetration after each substep of the last control step, m, if it is measured. Shape (substeps,)."""
        return self.measured.depths

    def contacts(self) -> Contacts:
        """Contacts of the last control step, where their resultant was largest."""
        return self.measured.contacts()

    def force(self) -> np.ndarray:
        """Resultant of the wall's contact forces on the wire, largest of the last control step, N. Shape (3,)."""
        return np.array(self.summary.force)

    def blood_forces(self) -> np.ndarray:
        """Drag of the blood on each simulated link, from the tip back, of the last substep, N. Shape (links, 3)."""
        return self._chain.loads[::-1, :3].copy() if self.drag else np.zeros((self.active_links, 3))

    def state(self) -> np.ndarray:
        """Everything that a continuation depends on, for `restore`. Shape (3 nq + controls + 3,)."""
        data = self.data
        parts = [pass_on(vector, self.nq, bend=False) for vector in (data.qpos, data.qvel, data.qacc_warmstart)]
        return np.concatenate((*parts, self._to, [data.time, self._chain.struct.depth, self._index]))

    def restore(self, state: np.ndarray) -> None:
        """Returns to a state of a simulation with the same arguments.

        Raises:
            ValueError: the state has another size, is not finite, or is of another simulation.
        """
        size = 3 * self.nq + len(self._to) + 3
        if state.shape != (size,):
            raise ValueError(f"expected a state of shape ({size},), got {state.shape}")
        known = np.isfinite(state[:-2]).all() and not np.isnan(state[-2])  # the depth may be infinite
        if not known or state[-1] not in range(len(self.chains.counts)):
            raise ValueError(NO_STATE)
        self._index = int(state[-1])
        self._chain = self._chain_at(self._index)
        data, active = self.data, self.model.nq
        mujoco.mj_resetData(self.model, data)
        vectors = state[: 3 * self.nq].reshape(3, self.nq)
        for target, source in zip((data.qpos, data.qvel, data.qacc_warmstart), vectors, strict=True):
            target[:] = pass_on(source, active, bend=False)
        self._to[:] = state[3 * self.nq : -3]
        data.time, self._chain.struct.depth = state[-3], state[-2]
        mujoco.mj_kinematics(self.model, data)
        self.measured.clear()

    def force_state(self) -> tuple[bytes, np.ndarray, np.ndarray, np.ndarray]:
        """What the last control step measured: forces, contacts and drag, which no continuation depends on."""
        return *self.measured.state(), self._chain.loads.copy()

    def restore_forces(self, state: tuple[bytes, np.ndarray, np.ndarray, np.ndarray]) -> None:
        """Returns to a measurement of `force_state`."""
        self.measured.restore(state[:3])
        self._chain.loads[:] = state[3]


def not_finite(*movement: float) -> str:
    """The sentence that refuses translations (m) and rotations (rad) of which one is not finite."""
    return f"translation (m) and rotation (rad) must be finite numbers, got {', '.join(map(str, movement))}"
