"""Contact forces from the shape of a device: the simulated device is laid along the curve, held, and left to rest."""

from __future__ import annotations

import dataclasses
import math
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cathsim.anatomy import Phantom
from cathsim.devices.pair import DevicePair
from cathsim.devices.simulation import DualSimulation
from cathsim.guidewire import Guidewire
from cathsim.presets import ACCURACY, Accuracy
from cathsim.simulation import LEAD_ADVANCE, LEAD_ROTATION, Simulation
from cathsim.statics.ensemble_summary import ContactForces, RestingContacts, resting_contacts, summarise
from cathsim.statics.laying import Feeder, checked_catheter, checked_number, distance_to, found_rotation, lay_along
from cathsim.statics.observed_curve import ObservedCurve, checked_insertion, noisy_curve, observed_curve
from cathsim.statics.uncertainty import Deviation, Uncertainty, deviations, simulated_device
from cathsim.validation import named, quantity

MEMBERS = 40  # with 16 the ends of a 90 % interval are two of 16 numbers, and 78 to 88 % of them held the truth
REST_STEPS = 10  # control steps of 0.1 s in which the device finds its place between the walls
FOLLOW_DISTANCE = 2.0e-3  # m between a followed device and the curve beyond which it is laid anew
MOST_REFINEMENT = 3  # of substeps that end in the wall: with more, forces stay the same and hard states take minutes
# Standard deviations of a feeder that is found from the curve.
FOUND_INSERTION, FOUND_ROTATION = 1.5e-3, 0.3


class ContactForceEstimator:
    """Contact forces from a sequence of curves; each frame starts from the last.

    With feeder data a frame moves the feeder from its last position to the new one, so that friction acts against the
    motion; where the device then lies too far from the curve (`FOLLOW_DISTANCE`), it is laid along the curve and rests.
    Without feeder data each frame is laid, and its rotation searched near the last.

    Args:
        phantom: the anatomy, in the curve's frame.
        device: that lies in it: a wire, or a wire in a catheter.
        entry: name of the phantom's entry.
        members: of the ensemble, the nominal one included; 1: no intervals.
        uncertainty: what the ensemble varies.
        seed: of the ensemble.
        accuracy: "accurate", "fast", "reference", or an `Accuracy`.
        friction: nominal coefficient; None: the device's, 0.1 at least, which keeps the device at the observed shape.
        workers: threads among which the members are divided.

    Raises:
        ValueError: an unknown entry or accuracy, something else than a phantom, a guidewire or a pair, no member.
    """

    def __init__(
        self,
        phantom: Phantom,
        device: Guidewire | DevicePair,
        *,
        entry: str = "descending",
        members: int = 1,
        uncertainty: Uncertainty | None = None,
        seed: int = 0,
        accuracy: str | Accuracy = "accurate",
        friction: float | None = None,
        workers: int = 1,
    ) -> None:
        if not isinstance(phantom, Phantom):
            raise ValueError(f"phantom must be a Phantom, as load_phantom gives it, got {phantom!r}")
        members, workers = quantity("members", members, int), quantity("workers", workers, int)
        if members < 1 or workers < 1:
            raise ValueError(f"members and workers must be 1 at least, got {members} and {workers}")
        phantom.entry(entry)
        numerics = accuracy if isinstance(accuracy, Accuracy) else named("accuracy", accuracy, ACCURACY)
        numerics = dataclasses.replace(numerics, refinement=min(numerics.refinement, MOST_REFINEMENT))
        self.phantom, self.device, self.entry = phantom, device, entry
        self.uncertainty = Uncertainty() if uncertainty is None else uncertainty
        self._case = (phantom, device, numerics, entry, friction)
        self._nominal = simulated_device(*self._case, Deviation())
        self.max_insertion = self._nominal.max_insertion
        self._workers, self._members = workers, [_Member(self._nominal)]
        # Both cases, a measured feeder and one that is found from the curve, take the same draws in other widths.
        self._deviations = tuple(
            deviations(members, one, seed) for one in (self.uncertainty, _of_found_feeder(self.uncertainty))
        )
        self._feeder: Feeder | None = None

    def reset(self) -> None:
        """Forgets the last frame."""
        self._feeder = None

    def update(
        self,
        curve: ArrayLike,
        insertion: float | None = None,
        rotation: float | None = None,
        *,
        catheter: tuple[float, float] | None = None,
    ) -> ContactForces:
        """The contact forces of a frame.

        Args:
            curve: points (n, 3) m, world frame, from the entry to the tip; `inserted_curve` or
                `curve_from_entry`.
            insertion: of the feeder, m; None: from the curve's length.
            rotation: of the feeder, rad; None: searched.
            catheter: insertion (m) and rotation (rad) of a catheter over the wire, which has to be given.

        Raises:
            ValueError: a curve or feeder that cannot be; the device does not come to rest.
        """
        observed = observed_curve(curve, self.phantom, self.entry, self.max_insertion)
        known, last = insertion is not None and rotation is not None, self._feeder
        feeder = self._feeder = self._found_feeder(observed, insertion, rotation, catheter)
        cases = self._deviations[0 if known else 1]
        for case in cases[len(self._members) :]:
            self._members.append(_Member(simulated_device(*self._case, case)))
        follow = known and last is not None

        def estimate(member: _Member, case: Deviation) -> RestingContacts | None:
            moved = feeder.deviating(case, self.max_insertion)
            return member.estimate(observed, self._noisy(observed, case), moved, follow=follow)

        if self._workers > 1:
            with ThreadPoolExecutor(self._workers) as pool:
                read = list(pool.map(estimate, self._members, cases))
        else:
            read = [estimate(member, case) for member, case in zip(self._members, cases, strict=True)]
        rested = [one for one in read if one is not None]
        if not rested:
            self._feeder = None
            raise ValueError(
                "the simulated device does not come to rest along this curve: check the curve, the phantom it is "
                "registered to and the device's stiffness"
            )
        return summarise(rested, feeder.insertion, feeder.rotation)

    def _found_feeder(
        self,
        observed: ObservedCurve,
        insertion: float | None,
        rotation: float | None,
        catheter: tuple[float, float] | None,
    ) -> Feeder:
        """The feeder's position as given, or found from the curve."""
        insertion = None if insertion is None else checked_number("insertion", insertion, "m")
        rotation = None if rotation is None else checked_number("rotation", rotation, "rad")
        if rotation is not None and not math.isfinite(rotation):
            raise ValueError(f"rotation must be a finite number (rad), got {rotation}")
        device = self.device
        if isinstance(device, DevicePair) and device.wire is not None and device.catheter is not None:
            if catheter is None or insertion is None or rotation is None:
                raise ValueError(
                    "a wire in a catheter needs the feeders' positions: give insertion, rotation and "
                    "catheter=(insertion, rotation)"
                )
            catheter = checked_catheter(catheter, self.max_insertion)
            checked_insertion(max(insertion, catheter[0]), observed, self.max_insertion)
            return Feeder(insertion, rotation, catheter)
        if catheter is not None:
            raise ValueError("catheter is for a wire in a catheter: give a DevicePair with both, or leave it out")
        if insertion is None:
            insertion = min(observed.insertion, self.max_insertion)
        insertion = checked_insertion(insertion, observed, self.max_insertion)
        if rotation is None:
            last = None if self._feeder is None else self._feeder.rotation
            rotation = found_rotation(self._nominal, observed, insertion, last)
        return Feeder(insertion, float(rotation))

    def _noisy(self, observed: ObservedCurve, case: Deviation) -> ObservedCurve:
        """The curve with the noise of a case."""
        if case.curve_seed is None or self.uncertainty.curve == 0:
            return observed
        sizes, generator = self.uncertainty, np.random.default_rng(case.curve_seed)
        return ObservedCurve(
            noisy_curve(observed.points, sizes.curve, generator, width=sizes.curve_width), observed.length
        )


def contact_forces(
    curve: ArrayLike,
    phantom: Phantom,
    device: Guidewire | DevicePair,
    insertion: float | None = None,
    rotation: float | None = None,
    *,
    catheter: tuple[float, float] | None = None,
    members: int = MEMBERS,
    **settings: Any,
) -> ContactForces:
    """Contact forces of a device that rests in a vessel, from its shape.

    The simulated device is laid along the curve, its feeder held, and left to rest; its contacts are read. An ensemble
    over what is not known (`Uncertainty`) gives medians and 90 % intervals. The device is assumed at rest, its
    stiffness measured; blood and pulsation are left out. A wire's torsion is rigid, a pair's as its `torsion` says.

    Args:
        curve: points (n, 3) m, world frame, from the entry to the tip: simulated (`inserted_curve`) or reconstructed
            (`curve_from_entry`).
        phantom: the anatomy, registered to the curve.
        device: with its stiffness, to which forces are proportional.
        insertion: of the feeder, m; None: from the curve's length.
        rotation: of the feeder, rad; None: searched.
        catheter: insertion (m) and rotation (rad) of a catheter over the wire; both feeders are needed then.
        members: of the ensemble; 1: the nominal case alone, without intervals.
        settings: entry, uncertainty, seed, accuracy, friction and workers, as of `ContactForceEstimator`.

    Raises:
        ValueError: a curve, feeder, entry or device that cannot be, in one sentence; the device does not come to rest.
    """
    estimator = ContactForceEstimator(phantom, device, members=members, **settings)
    return estimator.update(curve, insertion, rotation, catheter=catheter)


def _of_found_feeder(uncertainty: Uncertainty) -> Uncertainty:
    return dataclasses.replace(
        uncertainty,
        insertion=max(uncertainty.insertion, FOUND_INSERTION),
        rotation=max(uncertainty.rotation, FOUND_ROTATION),
    )


class _Member:
    """A case of the ensemble: its simulation, and where its feeder was in the last frame."""

    def __init__(self, simulation: Simulation) -> None:
        self.simulation = simulation
        self.feeder: Feeder | None = None

    def estimate(
        self, observed: ObservedCurve, laid: ObservedCurve, feeder: Feeder, *, follow: bool
    ) -> RestingContacts | None:
        """The contacts of a frame; None where the simulation fails.

        Args:
            observed: the frame's curve.
            laid: along which the device is laid where it is.
            follow: whether the feeder goes on from the last frame, if it can.
        """
        simulation = self.simulation
        if not (follow and self._follow(observed, feeder)):
            lay_along(simulation, laid, feeder)
            for _ in range(REST_STEPS):
                simulation.advance(0.0, 0.0)
        self.feeder = feeder
        return resting_contacts(simulation, observed) if simulation.valid else None

    def _follow(self, observed: ObservedCurve, feeder: Feeder) -> bool:
        """Moves the feeder to a new position; whether the device then lies along the curve."""
        simulation, last = self.simulation, self.feeder
        if last is None or not simulation.valid:
            return False
        wire, catheter = feeder.moves_from(last)
        if any(abs(move[0]) > LEAD_ADVANCE or abs(move[1]) > LEAD_ROTATION for move in (wire, catheter)):
            return False
        if isinstance(simulation, DualSimulation):
            simulation.advance(*wire, catheter=catheter)
        else:
            simulation.advance(*wire)
        return simulation.valid and distance_to(simulation, observed) < FOLLOW_DISTANCE
