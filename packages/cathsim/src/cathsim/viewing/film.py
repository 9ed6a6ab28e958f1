"""A short film of an episode: fluoroscopy on the left, the devices in the vessel in 3-D on the right."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from cathsim.environment import NavigateEnv
    from cathsim.fluoroscopy import XRayScene
    from cathsim.simulation import Simulation

HEIGHT_PX, BIPLANE_PX = 400, 320  # usually; with both C-arms and an X-ray background
VIEW_WIDTH_PX = 300
FRAMES_PER_SECOND = 12.5  # of playback; every second step is shown, so at 2.5 times the episode's own speed
STRIDE = 2
_GREYS, _COLOURS = 112, 144  # of the palette: for the fluoroscopy, and for the rest
_NOISY_GREYS = 32  # for images with noise, which more of them only make large
_GREY_RANGE = 12  # most difference of red, green and blue of what counts as grey

_LOGGER = logging.getLogger(__name__)


class Film:
    """Collects frames of an episode and writes them as an animated GIF.

    Where no OpenGL library is found the film is of the fluoroscopy alone, and a warning says how to have the rest.

    Args:
        stride: of so many steps one is shown, and the last.
        background: X-ray background around the vessels, such as a patient's CT (`cathsim.fluoroscopy.ct_scene`), from
            the front and from the side; None: the usual fluoroscopy, frontal and without a body.
    """

    def __init__(self, stride: int = STRIDE, background: XRayScene | None = None) -> None:
        self._stride, self._background = stride, background
        self._frames: list[np.ndarray] = []
        self._count = 0
        self._take_image: Callable[[], np.ndarray] | None = None
        self._view: Any = None

    def add(self, environment: NavigateEnv) -> None:
        """Looks at a step of the episode."""
        ended = bool(environment.steps and environment.ended)
        if self._count % self._stride == 0 or ended:
            self.look(environment.simulation, environment.task.goal(environment.phantom))
        self._count += 1

    def look(self, simulation: Simulation, goal: np.ndarray | None = None) -> None:
        """Adds a picture of a simulation, always of the same one.

        Args:
            goal: target to mark in the 3-D view, m. Shape (3,).
        """
        if self._take_image is None:
            self._take_image = self._open(simulation)
        frame = self._take_image()
        if self._view is not None:
            frame = np.concatenate((frame, self._view.render(simulation, goal)), axis=1)
        self._frames.append(frame)

    def append(self, other: Film) -> None:
        """Adds the frames of a film of the same size, such as of an episode in another anatomy."""
        self._frames += other._frames

    def _open(self, simulation: Simulation) -> Callable[[], np.ndarray]:
        from cathsim.viewing.camera_view import RenderingUnavailableError, View

        height = HEIGHT_PX if self._background is None else BIPLANE_PX
        try:
            self._view = View(simulation.phantom, width=VIEW_WIDTH_PX, height=height)
        except RenderingUnavailableError as error:
            _LOGGER.warning("the film shows fluoroscopy only: %s", error)
        return _usual_xray(simulation) if self._background is None else _biplane_xray(self._background, simulation)

    def write(self, path: Path) -> None:
        """Writes the film as a GIF."""
        # one palette for the whole film keeps colours from flickering
        greys = _GREYS if self._background is None else _NOISY_GREYS
        palette = film_palette(self._frames[:: max(1, len(self._frames) // 6)], greys, _COLOURS)
        write_gif(path, self._frames, palette, FRAMES_PER_SECOND)

    def close(self) -> None:
        """Frees the renderer."""
        if self._view is not None:
            self._view.close()
            self._view = None


def _usual_xray(simulation: Simulation) -> Callable[[], np.ndarray]:
    from cathsim.observations.fluoroscopes import Fluoroscope

    fluoroscope = Fluoroscope(simulation, HEIGHT_PX)

    def image() -> np.ndarray:
        fluoroscope.update()
        return np.repeat(fluoroscope.image()[:, :, None], 3, axis=2)

    return image


def _biplane_xray(background: XRayScene, simulation: Simulation) -> Callable[[], np.ndarray]:
    from cathsim.viewing.display_fluoroscope import DisplayFluoroscope

    return DisplayFluoroscope(simulation, BIPLANE_PX, background).image


def film_states(
    path: Path, simulation: Simulation, states: Iterable[np.ndarray], goal: np.ndarray | None = None
) -> None:
    """Writes the film of a simulation's states, one a control step, as `Simulation.state` gave them.

    Every second state and the last one are shown. The simulation is left in the last state.

    Args:
        simulation: of the same phantom, devices and numerics as the states.
        goal: target to mark in the 3-D view, m. Shape (3,).

    Raises:
        ValueError: there is no state, or one is of another simulation.
    """
    sequence = list(states)
    if not sequence:
        raise ValueError("a film needs at least one state")
    film = Film()
    try:
        for index, state in enumerate(sequence):
            if index % STRIDE == 0 or index == len(sequence) - 1:
                simulation.restore(state)
                film.look(simulation, goal)
        film.write(path)
    finally:
        film.close()


def write_gif(path: Path, frames: Sequence[np.ndarray], colours: Sequence[int], frames_per_second: float) -> None:
    """Writes an animated GIF, whatever the name of the file; its last frame stays for 1.5 s.

    Args:
        frames: (h, w, 3) uint8 each.
        colours: of the palette, red, green and blue of each in turn, at most 256.
    """
    Image = _pillow()

    palette = Image.new("P", (1, 1))
    palette.putpalette(list(colours))
    pictures = [Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    durations = [round(1000 / frames_per_second)] * (len(pictures) - 1) + [1500]
    pictures[0].save(
        path, format="GIF", save_all=True, append_images=pictures[1:], duration=durations, loop=0, disposal=1
    )


def film_palette(frames: Sequence[np.ndarray], greys: int, colours: int) -> list[int]:
    """A film's palette for `write_gif`: an even scale of greys, for X-ray images, and of the colours that are there.

    Args:
        frames: (h, w, 3) uint8 each.
        greys, colours: how many of each, at most 256 together.
    """
    Image = _pillow()

    scale = np.repeat(np.linspace(0, 255, greys).round().astype(np.uint8)[:, None], 3, axis=1)
    pixels = np.concatenate([frame.reshape(-1, 3) for frame in frames])
    coloured = pixels[np.ptp(pixels, axis=1) > _GREY_RANGE]
    if len(coloured) == 0:
        return scale.ravel().tolist()
    # the method that keeps rare colours, such as the target's
    quantized = Image.fromarray(coloured[None]).quantize(colours, method=Image.Quantize.MAXCOVERAGE)
    seen = np.array(quantized.getpalette(), np.uint8).reshape(-1, 3)[:colours]
    return np.concatenate((scale, seen)).ravel().tolist()


def _pillow() -> Any:
    """Pillow's module of images.

    Raises:
        ModuleNotFoundError: it is not installed; the message has the command that installs it.
    """
    try:
        from PIL import Image
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "GIF films are written with Pillow: pip install 'endonav-cathsim[pictures]'", name=error.name
        ) from None
    return Image
