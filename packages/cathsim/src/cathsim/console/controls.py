"""The operator's controls: two axes of each device, held until they are released or no message comes any more."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

Move = tuple[float, float]  # shares of the full speeds of a feeder: translation, rotation

SILENCE = 0.6  # s without a word from the page after which the controls count as released


@dataclass(frozen=True)
class Controls:
    """The two axes of the wire's feeder and the two of the catheter's, each -1 to 1."""

    advance: float = 0.0  # share of the full speed; positive inserts
    rotate: float = 0.0  # share of the full speed; positive about the direction of insertion
    sequence: int = 0  # number that the page gave to this reading: it says which picture shows the reading's effect
    catheter_advance: float = 0.0  # 0 where there is no catheter
    catheter_rotate: float = 0.0

    def __post_init__(self) -> None:
        for name in ("advance", "rotate", "catheter_advance", "catheter_rotate"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
                raise ValueError(f"{name} must be a number from -1 to 1, got {value!r}")
            object.__setattr__(self, name, min(max(float(value), -1.0), 1.0))
        if isinstance(self.sequence, bool) or not isinstance(self.sequence, int):
            raise ValueError(f"sequence must be a whole number, got {self.sequence!r}")

    @property
    def wire(self) -> Move:
        """What is asked of the wire's feeder."""
        return self.advance, self.rotate

    @property
    def catheter(self) -> Move:
        """What is asked of the catheter's feeder."""
        return self.catheter_advance, self.catheter_rotate

    @property
    def pressed(self) -> bool:
        """Whether anything is asked for."""
        return any(self.wire) or any(self.catheter)


class ControlPanel:
    """Takes the page's readings and gives them to the simulation, between threads.

    A key that was pressed and released between two control steps still counts for one of them: a tap moves the wire, or
    the catheter, also while the other device is steered.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._held = Controls()
        self._tapped_wire: Move | None = None
        self._tapped_catheter: Move | None = None
        self._heard = -math.inf

    def set(self, controls: Controls) -> None:
        """Takes what is pressed now."""
        with self._lock:
            self._tapped_wire = controls.wire if any(controls.wire) else self._tapped_wire
            self._tapped_catheter = controls.catheter if any(controls.catheter) else self._tapped_catheter
            self._held = controls
            self._heard = self._clock()

    def release(self) -> None:
        """Lets go of everything at once, taps included: the operator has left or a device was pulled out."""
        with self._lock:
            self._held = Controls(sequence=self._held.sequence)
            self._tapped_wire = self._tapped_catheter = None

    @property
    def touched(self) -> bool:
        """Whether the next reading would move the wire."""
        with self._lock:
            return self._reading().pressed

    def take(self) -> Controls:
        """The controls of the next step; a tap is used up by it."""
        with self._lock:
            reading = self._reading()
            self._tapped_wire = self._tapped_catheter = None
            return reading

    def _reading(self) -> Controls:
        if self._clock() - self._heard > SILENCE:
            return Controls(sequence=self._held.sequence)
        held = self._held
        wire = held.wire if any(held.wire) else self._tapped_wire or held.wire
        catheter = held.catheter if any(held.catheter) else self._tapped_catheter or held.catheter
        return Controls(*wire, held.sequence, *catheter)
