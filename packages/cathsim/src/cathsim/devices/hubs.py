"""Where the hubs of two devices stand, and where a control step moves them within the pair's limits."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cathsim.devices.arena import PROTRUSION
from cathsim.devices.pair import DevicePair
from cathsim.devices.rod import CATHETER, DEVICES, WIRE, Rod

DEVICE_NAMES = ("wire", "catheter")
Move = tuple[float, float]  # translation (m) and rotation (rad)


class Hubs:
    """Lead and hub angles of a pair whose chain is fed by one feeder.

    Attributes:
        lead: how far the wire's tip is ahead of the catheter's, m.
        angles: of wire's and catheter's hub, rad.
        travel: how far the chain can be fed, m.
    """

    def __init__(self, pair: DevicePair, travel: float) -> None:
        self.pair, self.travel = pair, travel
        self.lead = self._lead_target = 0.0
        self.angles, self._angle_targets = [0.0] * DEVICES, [0.0] * DEVICES

    @property
    def only(self) -> int:
        """The device that is alone, or the wire of two."""
        return WIRE if self.pair.wire else CATHETER

    @property
    def leading(self) -> int:
        """The device whose tip is the chain's end."""
        return CATHETER if self.pair.both and self.lead < 0 else self.only

    def lead_limits(self) -> tuple[float, float]:
        """Least and largest lead, m; both 0 with one device."""
        return (-self.pair.most_behind, self.pair.most_ahead) if self.pair.both else (0.0, 0.0)

    def insertions(self, chain: float) -> tuple[float, float]:
        """Insertions of wire and catheter, m, where the chain's is `chain`."""
        return chain + min(self.lead, 0.0), chain - max(self.lead, 0.0)

    def place(self, insertion: float, rotation: float, catheter: Move | None = None) -> float:
        """Puts the hubs at a start; returns the chain's insertion, m.

        Arguments and refusals are those of `DualSimulation.reset`.
        """
        low, high = self.lead_limits()
        if catheter is None:
            catheter = (max(insertion - high, 0.0), 0.0)
        lead = insertion - catheter[0] if self.pair.both else 0.0
        if not low - 1e-9 <= lead <= high + 1e-9 or not np.isfinite((*catheter, lead)).all():
            raise ValueError(
                f"the wire may be {1e3 * low:.0f} to {1e3 * high:.0f} mm ahead of the catheter, asked for "
                f"{1e3 * lead:.0f} mm"
            )
        for device, at in zip(DEVICE_NAMES, (insertion, catheter[0] if self.pair.both else insertion), strict=True):
            if not 0 <= at <= self.travel:
                raise ValueError(f"insertion of the {device} must lie in 0 to {self.travel:.3f} m, got {at:.3f}")
        self.set(float(lead), (rotation, float(catheter[1]) if self.pair.wire else rotation))
        return insertion - min(self.lead, 0.0)

    def set(self, lead: float, angles: Sequence[float]) -> None:
        """Puts the hubs at a lead (m) and angles (rad) at once."""
        self.lead = self._lead_target = lead
        self.angles[:] = self._angle_targets[:] = angles

    def command(self, chain: float, wire: Move, catheter: Move, reach: tuple[float, float]) -> Move:
        """Sets where the coming control step moves the hubs; what would leave the limits is cut short.

        Args:
            chain: insertion of the chain, m.
            wire: of the wire's feeder, or of the device that is alone.
            catheter: of the catheter's.
            reach: least and most that the chain's drive, whose force is limited, can move in the step, m. Beyond it
                the feeders slip, each in proportion to its own movement: one that is still stays where it is.

        Returns:
            Translation (m) and rotation (rad) of the chain.
        """
        low, high = self.lead_limits()
        translation, turns = wire[0], (wire[1], catheter[1] if self.pair.both else wire[1])
        if self.pair.both:
            inner, outer = self.insertions(chain)
            inner_to = min(max(inner + wire[0], 0.0), self.travel)
            outer_to = min(max(outer + catheter[0], 0.0), self.travel)
            excess = inner_to - outer_to - min(max(inner_to - outer_to, low), high)
            # who moves apart is held back: first the wire, then the catheter
            held = min(max(excess, min(inner_to - inner, 0.0)), max(inner_to - inner, 0.0))
            inner_to -= held
            outer_to += excess - held
            translation = max(inner_to, outer_to) - max(inner, outer)
            driven = min(max(translation, reach[0]), reach[1])
            if driven != translation and translation != 0.0:
                share = min(max(driven / translation, 0.0), 1.0)
                inner_to, outer_to = inner + share * (inner_to - inner), outer + share * (outer_to - outer)
            translation = driven
            self._lead_target = inner_to - outer_to
        self._angle_targets = [at + turn for at, turn in zip(self.angles, turns, strict=True)]
        return translation, self._frame_turn(chain, turns)

    def _frame_turn(self, chain: float, turns: tuple[float, float]) -> float:
        # the outer surface of what lies in the vessel turns with its own device
        if not self.pair.both:
            return turns[self.only]
        inner, outer = self.insertions(chain)
        covered = min(max((outer + PROTRUSION) / (max(inner, outer) + PROTRUSION), 0.0), 1.0)
        return turns[WIRE] + covered * (turns[CATHETER] - turns[WIRE])

    def hand_over(self, rod: Rod) -> None:
        """Tells the rod how the coming control step moves the hubs."""
        rod.move(self.lead, self._lead_target, self.angles, self._angle_targets)

    def arrive(self) -> None:
        """The control step is over."""
        self.set(self._lead_target, self._angle_targets)
