"""The demo's film: two X-ray views, what the policy reads drawn on those that it sees, and the scene in 3-D."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import numpy as np

from cathsim.viewing.display_fluoroscope import VIEWS, DisplayWindow
from cathsim.viewing.film import Film, film_palette, write_gif
from cathsim.viewing.opencv import cv2
from pipeline.demo.steering import Scene
from pipeline.store.atomic_files import atomic_path

VIEW_PX, SPACE_PX = 384, 300  # side of the X-ray views; width of the 3-D view
TITLE_PX = 30
FRAMES_PER_SECOND = 10.0  # of playback; every second step is shown, so at twice the episode's speed
STRIDE = 2
# red, green, blue
WIRE, WAY, LUMEN, TARGET = (255, 214, 10), (80, 220, 120), (90, 165, 255), (255, 92, 92)
TRUE_WIRE = (226, 226, 236)
_TITLE_BACK, _TITLE_INK = (24, 27, 31), (232, 236, 240)
_GIF_SHARE, _GIF_STRIDE, _GREYS, _COLOURS = 0.62, 2, 24, 72
_CONSTANT_RATE_FACTOR = 21  # of libx264
_LAST_FRAME = 15  # times that the last frame is shown
_SHIFT = 4  # bits of cv2's fixed-point places

_LOGGER = logging.getLogger(__name__)


class DemoFilm(Film):
    """Three panels: X-ray with what the policy reads, a second view, the vessel in 3-D; `curves`: a value a step."""

    def __init__(self, scene: Scene) -> None:
        super().__init__()
        self.scene = scene
        self.curves: dict[str, list[float]] = {"distance_mm": [], "force_n": []}
        self._noise = np.random.default_rng(scene.start_seed)
        self._projectors: dict[str, Any] = {}
        self._window = DisplayWindow()

    def add(self, environment: Any) -> None:
        """Looks at a step of the episode."""
        simulation, goal = environment.simulation, environment.task.goal(environment.phantom)
        tip = simulation.wire_points()[0]
        self.curves["distance_mm"].append(1e3 * float(np.linalg.norm(tip - goal)))
        self.curves["force_n"].append(float(simulation.summary.force_max))
        ended = bool(environment.steps and environment.ended)
        if self._count % STRIDE == 0 or ended:
            self._frames.append(self.picture(environment, goal))
        self._count += 1

    def picture(self, environment: Any, goal: np.ndarray) -> np.ndarray:
        """The frame of the moment, (height, width, 3) uint8."""
        simulation = environment.simulation
        panels = [self._titled_view(environment, goal, view) for view in self.views]
        space = self._space(simulation, goal)
        if space is not None:
            panels.append(_titled(space, f"in 3-D, for you   {environment.steps / 10:5.1f} s"))
        return np.concatenate(panels, axis=1)

    @property
    def views(self) -> tuple[str, ...]:
        """Those that the policy sees, and usual ones so that there are two."""
        seen = self.scene.cameras[: len(VIEWS)]
        return (*seen, *(view for view in VIEWS if view not in seen))[: len(VIEWS)]

    def _titled_view(self, environment: Any, goal: np.ndarray, view: str) -> np.ndarray:
        if view in self.scene.cameras:
            image = self.scene.environment.observation["image"][self.scene.cameras.index(view)]
            panel = self._grey(image, view)
            self._draw_reading(panel, view)
            whose = ": what it sees, and reads"
        else:
            panel = self._grey(self._xray(environment, view), view)
            whose = ", for you"
            if self.scene.by_images:  # the wire's shadow is faint through the shoulders
                _line(panel, self._project(environment, view, environment.simulation.wire_points()), TRUE_WIRE)
            else:
                self._draw_scan(panel, environment, view)
                whose += "; it sees a roadmap" * (view == self.views[0])
        _ring(panel, self._project(environment, view, goal[None])[0], TARGET)
        return _titled(panel, f"{view.replace('lao_', 'LAO ')} X-ray{whose}")

    def _grey(self, image: np.ndarray, view: str) -> np.ndarray:
        """A grey image as a panel: with more contrast, the same through the film; its pixels stay visible."""
        panel = self._window.shown(image, view)
        large = cv2.resize(panel, (VIEW_PX, VIEW_PX), interpolation=cv2.INTER_NEAREST)
        return np.repeat(large[:, :, None], 3, axis=2)

    def _draw_reading(self, panel: np.ndarray, view: str) -> None:
        read = self.scene.read_off_image(view)
        lumen = cv2.resize(read.lumen.astype(np.float32), (VIEW_PX, VIEW_PX), interpolation=cv2.INTER_LINEAR)
        borders, _ = cv2.findContours((lumen > 0.5).astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(panel, borders, -1, LUMEN, 1, cv2.LINE_AA)
        _line(panel, read.way, WAY)
        _line(panel, read.wire, WIRE)

    def _draw_scan(self, panel: np.ndarray, environment: Any, view: str) -> None:
        wire, way = self.scene.read_off_scan()
        _line(panel, self._project(environment, view, way), WAY)
        _line(panel, self._project(environment, view, wire), WIRE)

    def _project(self, environment: Any, view: str, points: np.ndarray) -> np.ndarray:
        """World points (n, 3) m to shares of a view's side, (n, 2)."""
        from cathsim.observations.framing import framed

        if view not in self._projectors:
            self._projectors[view] = framed(environment.phantom, view, VIEW_PX, self.scene.field)
        return (self._projectors[view].project(points) + 0.5) / VIEW_PX

    def _xray(self, environment: Any, view: str) -> np.ndarray:
        from cathsim.observations.fluoroscopes import catheter_in, frame_of, wire_radius_of
        from cathsim.observations.xray import fluoroscope_of

        radius, catheter = wire_radius_of(environment.simulation), catheter_in(environment.simulation)
        fluoroscope = fluoroscope_of(
            environment.phantom,
            VIEW_PX,
            radius,
            catheter,
            view,
            field=self.scene.field,
            background=self.scene.background,
        )
        return np.asarray(frame_of(environment.simulation, fluoroscope, self._noise, view).image)

    def _space(self, simulation: Any, goal: np.ndarray) -> np.ndarray | None:
        """The 3-D view; None where no OpenGL library is found, which is said once."""
        from cathsim.viewing.camera_view import RenderingUnavailableError, View

        if self._view is None and not self._frames:
            try:
                self._view = View(simulation.phantom, width=SPACE_PX, height=VIEW_PX)
            except RenderingUnavailableError as error:
                _LOGGER.warning("the film has no 3-D view: %s", error)
        return None if self._view is None else np.ascontiguousarray(self._view.render(simulation, goal))

    def write(self, path: Path) -> None:
        """Writes the film as a small GIF: every second frame, in fewer colours."""
        frames = self._frames[::_GIF_STRIDE]
        if len(self._frames) % _GIF_STRIDE == 0:
            frames = [*frames, self._frames[-1]]
        size = [2 * round(_GIF_SHARE * side / 2) for side in frames[0].shape[1::-1]]
        small = [cv2.resize(frame, size, interpolation=cv2.INTER_AREA) for frame in frames]
        palette = film_palette(small[:: max(1, len(small) // 6)], _GREYS, _COLOURS)
        with atomic_path(path) as temporary:
            write_gif(temporary, small, palette, FRAMES_PER_SECOND / _GIF_STRIDE)

    def write_mp4(self, path: Path) -> None:
        """Writes the film as H.264, which browsers play; its last frame stays for a while.

        Raises:
            OSError: it could not be written whole, as on a full disk; a film that was there before stays.
        """
        height, width = self._frames[0].shape[:2]
        frames = [*self._frames, *[self._frames[-1]] * _LAST_FRAME]
        with atomic_path(path) as temporary:
            writer = imageio_ffmpeg.write_frames(
                str(temporary), (width, height), fps=FRAMES_PER_SECOND, codec="libx264", pix_fmt_in="rgb24",
                pix_fmt_out="yuv420p", macro_block_size=2, quality=None, ffmpeg_log_level="error",
                output_params=["-crf", str(_CONSTANT_RATE_FACTOR), "-preset", "veryfast", "-movflags", "+faststart"],
            )  # fmt: skip
            writer.send(None)
            for frame in frames:
                writer.send(np.ascontiguousarray(frame))
            writer.close()  # which says nothing of a failure
            try:
                written, _ = imageio_ffmpeg.count_frames_and_secs(str(temporary))
            except RuntimeError:
                written = 0
            if written != len(frames):
                raise OSError(f"{path} could not be written whole: is there room on the disk?")


def _line(panel: np.ndarray, places: np.ndarray, colour: tuple[int, int, int]) -> None:
    """Draws a polyline, (n, 2) shares of the side."""
    fixed = np.rint((places * VIEW_PX - 0.5) * 2**_SHIFT).astype(np.int32)
    cv2.polylines(panel, [fixed[:, None]], False, colour, 2, cv2.LINE_AA, _SHIFT)


def _ring(panel: np.ndarray, place: np.ndarray, colour: tuple[int, int, int]) -> None:
    column, row = np.rint((place * VIEW_PX - 0.5) * 2**_SHIFT).astype(int).tolist()
    cv2.circle(panel, (column, row), 7 << _SHIFT, colour, 2, cv2.LINE_AA, _SHIFT)


def _titled(panel: np.ndarray, words: str) -> np.ndarray:
    title = np.full((TITLE_PX, panel.shape[1], 3), _TITLE_BACK, np.uint8)
    cv2.putText(title, words, (9, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.46, _TITLE_INK, 1, cv2.LINE_AA)
    return np.concatenate((title, panel))
