"""The operator's X-ray room: pedal, contrast medium, roadmap, and what its two C-arms show last."""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from cathsim.console.xray.monitor import FIRST_VIEWS, CArm, FluoroscopyMonitor
from cathsim.navigation import NavigationTask
from cathsim.simulation import CONTROL_STEP, Simulation

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


class Views:
    """Frontal and lateral C-arm, `a` and `b`, and the last picture of each.

    Args:
        room: whose contrast medium, roadmap and pedal the pictures follow.
        when_ready: has the loop's thread call a function, under a name that a later call replaces.
        turned: called in the loop's thread when a C-arm that was turned is shown.
    """

    def __init__(
        self, room: XRayRoom, when_ready: Callable[[str, Callable[[], None]], None], turned: Callable[[], None]
    ) -> None:
        self._room, self._when_ready, self._tell = room, when_ready, turned
        self._wanted = dict(FIRST_VIEWS)
        self._monitors: dict[str, FluoroscopyMonitor] = {}
        self._simulation: Simulation | None = None
        self._drawn: tuple[tuple[Any, ...], tuple[bytes, ...]] | None = None  # what the last pictures show, and they
        self._builder = ThreadPoolExecutor(1, "views")  # a turned C-arm takes 0.35 s: too long for the loop

    @property
    def size(self) -> int:
        """Side of the pictures, px."""
        return self._monitors["a"].size

    def open(self, simulation: Simulation) -> None:
        """Looks at another simulation, from where the C-arms stand."""
        self._simulation = simulation
        self._monitors = {name: FluoroscopyMonitor(simulation, view) for name, view in self._wanted.items()}
        self._drawn = None

    def restart(self) -> None:
        """Draws the next picture whatever the last one showed."""
        self._drawn = None

    def turn(self, camera: str, view: CArm) -> None:
        """Builds a view beside the loop; the latest one wanted of a camera is shown."""
        self._wanted[camera] = view
        simulation = self._simulation
        assert simulation is not None

        def build() -> None:
            if self._wanted[camera] == view:  # else a later one is wanted
                built = FluoroscopyMonitor(simulation, view)
                self._when_ready(f"turned {camera}", lambda: self._show(camera, built, simulation))

        self._builder.submit(build)

    def _show(self, camera: str, built: FluoroscopyMonitor, simulation: Simulation) -> None:
        if simulation is self._simulation:
            self._monitors[camera] = built
            self._drawn = None
            self._tell()

    def marks(self, task: NavigationTask) -> dict[str, Any]:
        """Of each view its angles, zoom, and where the target lies in it."""
        return {name: {**asdict(one.view), "mark": one.mark(task)} for name, one in self._monitors.items()}

    def pictures(
        self, moment: tuple[Any, ...], wire: np.ndarray, catheter: np.ndarray | None, *, held: bool
    ) -> tuple[bytes, ...]:
        """A JPEG a view.

        Args:
            moment: what tells the devices' state from others; the same pictures are not drawn twice.
            wire: its points, m. Shape (n, 3).
            catheter: those of the catheter, or None.
            held: the last pictures are shown, whatever has moved since.
        """
        picture_key = (*moment, self._room.contrast, self._room.roadmap)
        if self._drawn is None or not (held or self._drawn[0] == picture_key):
            further: dict[str, Any] = {"contrast": self._room.contrast, "roadmap": self._room.roadmap}
            self._drawn = picture_key, tuple(one.jpeg(wire, catheter, **further) for one in self._monitors.values())
        return self._drawn[1]

    def close(self) -> None:
        """Builds no more views."""
        self._builder.shutdown(wait=False, cancel_futures=True)
