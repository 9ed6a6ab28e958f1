"""What an X-ray picture needs besides devices and C-arm: the pedal, contrast medium, the roadmap."""

from __future__ import annotations

import math

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


class XRayRoom:
    """Pedal, injector and roadmap; its clock runs with the pictures that are shown.

    Attributes:
        beam: whether the pedal is down. While it is up, the last image is held.
        roadmap: whether the vessels are laid over the image.
        dose: time with the beam on in this procedure, s.
        injections: in this procedure.
    """

    def __init__(self) -> None:
        self.beam, self.roadmap = True, False
        self.restart()

    def restart(self) -> None:
        """Begins another procedure; pedal and roadmap stay as they are."""
        self.dose, self.injections, self._since = 0.0, 0, math.inf

    def inject(self) -> None:
        """Injects contrast medium."""
        self._since = 0.0
        self.injections += 1

    def advance(self, seconds: float, *, counting: bool) -> None:
        """Lets time pass, which counts as dose during a procedure with the beam on."""
        self._since += seconds
        if counting and self.beam:
            self.dose += seconds

    @property
    def contrast(self) -> float:
        """Contrast medium in the lumen, 0 to 1, in steps of 1/50."""
        return round(50 * concentration(self._since)) / 50
