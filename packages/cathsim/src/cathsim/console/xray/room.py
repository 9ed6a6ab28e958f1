"""What an X-ray picture needs besides devices and C-arm: the pedal, contrast medium, the roadmap."""

from __future__ import annotations

import math
from dataclasses import dataclass

from cathsim.simulation import CONTROL_STEP

FILLING = 0.4  # s from the injection to a full lumen
WASHOUT = 1.5  # s in which the concentration then falls to 1/e
_LEAST = 0.02  # of the full concentration; less is not seen


def concentration(since: float) -> float:
    """Contrast medium in the lumen a time (s) after its injection, 0 to 1.

    The lumen fills evenly in 0.4 s and washes out exponentially; the medium's way with the blood is not simulated.
    """
    if since < 0:
        return 0.0
    left = since / FILLING if since < FILLING else math.exp(-(since - FILLING) / WASHOUT)
    return left if left >= _LEAST or since < FILLING else 0.0


@dataclass(frozen=True)
class XRayStep:
    """What the X-ray side does in a control step."""

    on: bool = True  # the beam
    injections: int = 0  # of contrast medium, since the step before


class XRayRoom:
    """Pedal, injector and roadmap; its clock runs with the pictures that are shown, the dose with the control steps.

    Attributes:
        roadmap: whether the vessels are laid over the image.
        injections: in this procedure.
    """

    def __init__(self) -> None:
        self._beam, self.roadmap = True, False
        self.restart()

    @property
    def beam(self) -> bool:
        """Whether the pedal is down. While it is up, the last image is held."""
        return self._beam

    @beam.setter
    def beam(self, on: bool) -> None:
        self._beam = on
        self._pressed |= on

    @property
    def dose(self) -> float:
        """Time with the beam on in this procedure, s: as many control steps as it was on in."""
        return self._steps_on * CONTROL_STEP

    def restart(self) -> None:
        """Begins another procedure; pedal and roadmap stay as they are."""
        self.injections, self._told, self._since = 0, 0, math.inf
        self._steps_on, self._pressed = 0, False

    def inject(self) -> None:
        """Injects contrast medium."""
        self._since = 0.0
        self.injections += 1

    def advance(self, seconds: float) -> None:
        """Lets time pass with the pictures."""
        self._since += seconds

    def wait(self) -> None:
        """Lets time pass before the procedure, when a tap on the pedal counts for no step."""
        self._pressed = False

    def step(self) -> XRayStep:
        """Takes pedal and injections for the control step that begins, and counts it.

        A pedal that was pressed and released between two steps counts for one of them, as a tap on a key does.
        """
        on, self._pressed = self._beam or self._pressed, False
        new, self._told = self.injections - self._told, self.injections
        self._steps_on += on
        return XRayStep(on, new)

    @property
    def contrast(self) -> float:
        """Contrast medium in the lumen, 0 to 1, in steps of 1/50."""
        return round(50 * concentration(self._since)) / 50
