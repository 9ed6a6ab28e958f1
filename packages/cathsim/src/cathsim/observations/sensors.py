"""What an environment observes: its views, roadmap and history, and the observables that read them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

import gymnasium
import numpy as np
from annotated_types import Interval

from cathsim.anatomy.point_target import TargetLike
from cathsim.observations.fluoroscopes import BiplaneView, Fluoroscope, wire_radius_of
from cathsim.observations.observables import channels_behind, make_observable
from cathsim.observations.progress_history import History
from cathsim.observations.roadmap import Roadmap
from cathsim.observations.scan import Scan
from cathsim.observations.tracking import Tracking
from cathsim.registration.description import resolve_argument
from cathsim.simulation import Simulation
from cathsim.validation import Listed, quantity

if TYPE_CHECKING:
    from cathsim.fluoroscopy import BiplaneFluoroscope

_Degrees = Annotated[float, Interval(ge=-360, le=360)]


class Sensors:
    """Reads a simulation under the names of an environment's observation.

    Attributes:
        space: of the observation, a `Box` where one name is given alone, else a `Dict`.
        reads_way: whether the way left to the target is read.

    Args:
        observation: one name, or several.
        remaining: gives the way from a place (3,) m to the target of the moment, m.
        channels_last: whether images have their channels behind height and width.
        cameras: the C-arms that see the simulation, by name or as a `BiplaneFluoroscope`, or None.
        wire: name of the wire's preset, of whose material it is in their images.
        scan: what roadmap and history show of the vessel; None: the vessel itself.
        view: of `tracking`, as its `VIEW`.

    Raises:
        ValueError: no name, an unknown one, or an image size or noise out of range.
    """

    def __init__(
        self,
        simulation: Simulation,
        observation: str | Sequence[str],
        target: TargetLike,
        remaining: Callable[[np.ndarray], float],
        *,
        image_size: int,
        channels_last: bool,
        registration_noise: float,
        cameras: str | BiplaneFluoroscope | None,
        wire: str,
        scan: Scan | None,
        view: tuple[float, float],
    ) -> None:
        self._simulation, self._remaining = simulation, remaining
        selection: Any = observation
        several = isinstance(selection, Iterable) and not isinstance(selection, str)
        names: list[str] = list(selection) if several else [selection]
        if not names or not all(isinstance(name, str) for name in names):
            raise ValueError(f"observation must name at least one observable, got {observation!r}")
        self.reads_way = "history" in names
        self.fluoroscope = Fluoroscope(simulation, image_size)
        self.biplane: BiplaneView | None = None
        if cameras is not None:
            from cathsim.fluoroscopy import BiplaneFluoroscope, wire_material

            material = wire_material(wire, wire_radius_of(simulation))
            pair = partial(BiplaneFluoroscope.of, simulation.phantom, size=image_size, material=material)
            self.biplane = BiplaneView(simulation, resolve_argument("cameras", cameras, BiplaneFluoroscope, pair))
        shown = None if scan is None else resolve_argument("scan", scan, Scan)
        self.roadmap = Roadmap(simulation, target, registration_noise, shown)
        # its way through the geodesic field costs something: only where it is wanted
        self.history = History(simulation, self.way_left) if self.reads_way else None
        view = quantity("view", view, Annotated[tuple[_Degrees, _Degrees], Listed])
        self.tracking = Tracking(simulation, self.roadmap, view) if "tracking" in names else None
        parts = self.fluoroscope, self.biplane, self.roadmap, self.history, self.tracking
        made = {name: make_observable(name, simulation, *parts) for name in names}
        self._observables = {name: channels_behind(one) if channels_last else one for name, one in made.items()}
        self._single = names[0] if isinstance(observation, str) else None
        spaces: dict[str, gymnasium.Space[Any]] = {name: one.space for name, one in self._observables.items()}
        self.space = spaces[self._single] if self._single else gymnasium.spaces.Dict(spaces)

    def way_left(self) -> float:
        """The way from the tip to the target as the displaced scan shows it, m."""
        return self._remaining(self.roadmap.in_scan(self._simulation.tip))

    def begin(self, generator: np.random.Generator) -> None:
        """Starts an episode at the moment; draws the noise of images and registration."""
        self.fluoroscope.update(restart=True)
        if self.biplane is not None:
            self.biplane.update(seed=int(generator.integers(2**32)))
        self.roadmap.reset(generator)
        if self.history is not None:
            self.history.begin()
        if self.tracking is not None:
            self.tracking.begin()

    def advance(self, moves: Sequence[float]) -> None:
        """Says that a control step has passed.

        Args:
            moves: translation and rotation of each feeder, as shares of those at full action.
        """
        self.fluoroscope.update()
        if "sequential" in self._observables:  # the last three steps' images, whether somebody looks at them or not
            self.fluoroscope.sequence()
        if self.biplane is not None:
            self.biplane.update()
        if self.history is not None:
            self.history.advance(*moves)
        if self.tracking is not None:
            self.tracking.advance(moves)

    def observe(self) -> Any:
        """The observation of the moment."""
        if self._single:
            return self._observables[self._single].read()
        return {name: observable.read() for name, observable in self._observables.items()}

    def state(self) -> dict[str, Any]:
        """All that later observations depend on, to be pickled; for `restore`."""
        return {
            "fluoroscope": self.fluoroscope.state(),
            "registration": self.roadmap.offset.copy(),
            "history": None if self.history is None else self.history.state(),
            "tracking": None if self.tracking is None else self.tracking.state(),
            "biplane": None if self.biplane is None else self.biplane.state(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Returns to a saved moment; the simulation has been restored before."""
        self.fluoroscope.restore(state["fluoroscope"])
        self.roadmap.offset = state["registration"].copy()
        if self.history is not None:
            self.history.restore(state["history"])
        if self.tracking is not None:
            self.tracking.restore(state["tracking"])
        if self.biplane is not None:
            self.biplane.restore(state["biplane"])
