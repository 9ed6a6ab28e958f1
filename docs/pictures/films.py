"""Makes the films of the readme and of the environments' pages: python docs/pictures/films.py [NAME ...].

Episodes of the sampling expert, or scripted motions; a few CPU-minutes in all. Without names, every film is made.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from PIL import Image

import cathsim  # noqa: F401  registers the environments
from cathsim import NavigateEnv, load_guidewire, load_phantom
from cathsim.fluoroscopy import BiplaneFluoroscope
from cathsim.observations.fluoroscopes import catheter_in, frame_of, material_of
from cathsim.planning.sampling import SamplingExpert
from cathsim.simulation import Simulation
from cathsim.viewing.camera_view import View
from cathsim.viewing.film import HEIGHT_PX, VIEW_WIDTH_PX, Film

README_FILM = Path(__file__).parent / "navigation.gif"
GALLERY = Path(__file__).parent / "films"
STRIP_PX = HEIGHT_PX // 2  # width of each X-ray image: two stand where the frontal one stands in a plain film
IMAGE_PX, MARGIN_PX = 1024, 12  # side of the X-ray images, and what is shown around the vessels
DARKER = 15.0  # grey levels that the devices are darker than the darkest vessel
STEEP_ARCH = 33_009  # a common trunk, out of which the wire alone does not reach the LCCA


class BiplaneFilm(Film):
    """Both C-arms' images without noise, cut to the vessels, beside the view in 3-D."""

    def __init__(self) -> None:
        super().__init__()
        self._windows: dict[str, Window] = {}

    def look(self, simulation: Simulation, goal: np.ndarray | None = None) -> None:
        """Adds a picture of a simulation, as `Film.look` does."""
        if self._view is None:
            self._open(simulation)
        frames = {name: frame_of(simulation, self._fluoroscope, None, name).image for name in self._fluoroscope.names}
        if not self._windows:
            vertices = simulation.phantom.lumen_mesh.vertices
            cameras = self._fluoroscope.cameras
            self._windows = {name: Window.about(cameras[name].pixels(vertices), frames[name]) for name in frames}
        grey = np.concatenate([self._windows[name].cut(image) for name, image in frames.items()], axis=1)
        view = self._view.render(simulation, goal)
        self._frames.append(np.concatenate((np.repeat(grey[:, :, None], 3, axis=2), view), axis=1))

    def _open(self, simulation: Simulation) -> None:
        fluoroscope = BiplaneFluoroscope.of(
            simulation.phantom, "clinical", surroundings="patient", filling="contrast", size=IMAGE_PX
        )
        catheter = catheter_in(simulation)
        self._fluoroscope = fluoroscope if catheter is None else fluoroscope.with_catheter(material_of(catheter))
        self._view = View(simulation.phantom, width=VIEW_WIDTH_PX, height=HEIGHT_PX)


@dataclass(frozen=True)
class Window:
    """A part of an image and the grey levels that are shown of it."""

    left: int
    top: int
    width: int
    height: int
    low: float
    high: float

    @classmethod
    def about(cls, pixels: np.ndarray, image: np.ndarray) -> Window:
        """The part with the shape of a strip about pixels (n, 2)."""
        low, high = pixels.min(axis=0) - MARGIN_PX, pixels.max(axis=0) + MARGIN_PX
        height = min(max(high[1] - low[1], (high[0] - low[0]) * HEIGHT_PX / STRIP_PX), IMAGE_PX)
        size = np.array([height * STRIP_PX / HEIGHT_PX, height])
        left, top = (int(value) for value in np.clip((low + high - size) / 2, 0, IMAGE_PX - size))
        width, height = (int(value) for value in size)
        darkest, brightest = np.percentile(image[top : top + height, left : left + width], (0.1, 98))
        return cls(left, top, width, height, float(darkest) - DARKER, float(brightest))

    def cut(self, image: np.ndarray) -> np.ndarray:
        """The part of an image, (HEIGHT_PX, STRIP_PX) uint8."""
        part = image[self.top : self.top + self.height, self.left : self.left + self.width]
        spread = np.clip((part - self.low) / (self.high - self.low), 0, 1) * 255
        strip = Image.fromarray(spread.round().astype(np.uint8))
        return np.asarray(strip.resize((STRIP_PX, HEIGHT_PX), Image.Resampling.LANCZOS))


def steered(environment: NavigateEnv, film: Film, options: dict[str, Any] | None = None) -> Film:
    """Adds the sampling expert's episode to a film."""
    environment.reset(seed=0, options=options)
    current = getattr(environment, "current", environment)  # of many anatomies, that of the episode
    expert = SamplingExpert(current, seed=0, threads=1)
    film.add(current)
    ended = False
    while not ended:
        _, _, terminated, truncated, _ = environment.step(expert.action())
        ended = terminated or truncated
        film.add(current)
    expert.close()
    return film


def one_after_the_other(environment: NavigateEnv, cases: Sequence[int]) -> Film:
    """A film of an episode in each of several anatomies."""
    films = [steered(environment, Film(), {"case": case}) for case in cases]
    for film in films[1:]:
        films[0].append(film)
        film.close()
    return films[0]


def made(identity: str, **arguments: Any) -> Any:
    """A registered environment without its wrappers."""
    return gymnasium.make(identity, disable_env_checker=True, **arguments).unwrapped


def navigation() -> Film:
    """A wire in a Simmons 2 catheter, where the wire alone fails."""
    environment = made(
        "cathsim/NavigateDual-v0",
        phantom=load_phantom("random", seed=STEEP_ARCH),
        target="lcca",
        wire=load_guidewire("default").scaled(0.36),
        catheter="simmons2",
        observation="tip",
        max_steps=600,
    )
    return steered(environment, BiplaneFilm())


def navigate() -> Film:
    """One anatomy, one target: the wire into the BCA."""
    return steered(made("cathsim/Navigate-v0", phantom="type_1", target="bca", observation="tip"), Film())


def navigate_goal() -> Film:
    """A goal anywhere in the branches, another one in each episode."""
    environment, film = made("cathsim/NavigateGoal-v0", phantom="type_1", observation=("tip", "feeder")), Film()
    for target in ("lsa", "lcca", "rcca"):
        steered(environment, film, {"target": target})
    return film


def navigate_many() -> Film:
    """Another anatomy in each episode: three random arches."""
    environment = made(
        "cathsim/NavigateMany-v0", phantoms=(40_001, 40_005, 40_009), targets=("bca",), observation="tip"
    )
    return one_after_the_other(environment, range(3))


def navigate_copies() -> Film:
    """Copies of one anatomy that differ as a patient may on the day, and breathe."""
    environment = made("cathsim/NavigateCopies-v0", phantom="type_2", copies=(1, 2), observation="tip")
    return one_after_the_other(environment, range(2))


def arch_variety() -> Film:
    """A published task in arches of six branching types: three of them."""
    environment = made("cathsim/ArchVariety-v0", arch_types=("I", "V", "VII"), seeds=(10_000,))
    return one_after_the_other(environment, range(3))


def robot() -> Film:
    """The follower robot feeds the wire stroke by stroke; X-ray from the front and from the side."""
    environment = made("cathsim/Navigate-v0", phantom="type_2", target="bca", observation="tip", drive="robot")
    return steered(environment, BiplaneFilm())


FILMS: dict[str, Callable[[], Film]] = {
    made_by.__name__: made_by
    for made_by in (navigation, navigate, navigate_goal, navigate_many, navigate_copies, arch_variety, robot)
}


def main(names: Sequence[str]) -> None:
    """Makes the films of these names, all of them without any."""
    for name in names or FILMS:
        film = FILMS[name]()
        path = README_FILM if name == "navigation" else GALLERY / f"{name}.gif"
        film.write(path)
        film.close()
        print(f"{path}: {path.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main(sys.argv[1:])
