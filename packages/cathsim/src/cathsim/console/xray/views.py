"""The console's two views: what they show last, and how a C-arm is turned without holding up the loop."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from typing import Any

import numpy as np

from cathsim.console.xray.monitor import FIRST_VIEWS, CArm, FluoroscopyMonitor
from cathsim.console.xray.room import XRayRoom
from cathsim.navigation import NavigationTask
from cathsim.simulation import Simulation


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
