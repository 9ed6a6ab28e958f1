"""The operator's controls: two axes, held until they are released or no message comes any more."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

SILENCE = 0.6  # s without a word from the page after which the controls count as released


@dataclass(frozen=True)
class Controls:
    """The two axes of the feeder, each -1 to 1."""

    advance: float = 0.0  # share of the full speed; positive inserts
    rotate: float = 0.0  # share of the full speed; positive about the direction of insertion
    sequence: int = 0  # number that the page gave to this reading: it says which picture shows the reading's effect

    def __post_init__(self) -> None:
        for name in ("advance", "rotate"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
                raise ValueError(f"{name} must be a number from -1 to 1, got {value!r}")
            object.__setattr__(self, name, min(max(float(value), -1.0), 1.0))
        if isinstance(self.sequence, bool) or not isinstance(self.sequence, int):
            raise ValueError(f"sequence must be a whole number, got {self.sequence!r}")

    @property
    def pressed(self) -> bool:
        """Whether anything is asked for."""
        return self.advance != 0.0 or self.rotate != 0.0


class ControlPanel:
    """Takes the page's readings and gives them to the simulation, between threads.

    A key that was pressed and released between two control steps still counts for one of them: a tap moves the wire.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._held = Controls()
        self._tapped: Controls | None = None
        self._heard = -math.inf

    def set(self, controls: Controls) -> None:
        """Takes what is pressed now."""
        with self._lock:
            if controls.pressed:
                self._tapped = controls
            self._held = controls
            self._heard = self._clock()

    def release(self) -> None:
        """Lets go of everything at once, taps included: the operator has left or a device was pulled out."""
        with self._lock:
            self._held, self._tapped = Controls(sequence=self._held.sequence), None

    @property
    def touched(self) -> bool:
        """Whether the next reading would move the wire."""
        with self._lock:
            return self._reading().pressed

    def take(self) -> Controls:
        """The controls of the next step; a tap is used up by it."""
        with self._lock:
            reading = self._reading()
            self._tapped = None
            return reading

    def _reading(self) -> Controls:
        if self._clock() - self._heard > SILENCE:
            return Controls(sequence=self._held.sequence)
        if not self._held.pressed and self._tapped is not None:
            return Controls(self._tapped.advance, self._tapped.rotate, self._held.sequence)
        return self._held
