"""Random fluoroscopy: composes courses, devices, clutter and sensor to images with masks, seeded by (seed, index)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from guide3d.opencv import cv2
from guide3d.random_fluoroscopy import sensor
from guide3d.random_fluoroscopy.anatomy import ANATOMY, contrast_vessels, tissue, vessel_around
from guide3d.random_fluoroscopy.canvas import Canvas, Image, Points
from guide3d.random_fluoroscopy.courses import STEP_PX, beside, drawn_on, given_course, resampled, wire_course
from guide3d.random_fluoroscopy.devices import catheter, edge_along, strip, tip_blob, wire
from guide3d.random_fluoroscopy.phantom_clutter import PHANTOM_CLUTTER, log_uniform
from guide3d.random_fluoroscopy.settings import FluoroscopySettings
from guide3d.random_fluoroscopy.small_marks import SMALL_MARKS

_SCENE, _WINDOW, _SENSOR, _CLUTTER = range(4)  # streams of random numbers of an image
_SMALLEST_PX = 32


@dataclass(frozen=True, eq=False)
class RandomImage:
    """A random X-ray image and what is in it.

    Attributes:
        image: (h, w) uint8 grey values.
        wire: (h, w) uint8, 255 along the wires' centre lines, smooth at the edges; also inside a catheter.
        catheter: (h, w) uint8, 255 on catheters.
        tip: (h, w) float32, 1 at each wire's tip, falling off like a Gaussian of 3 px.
        wires: of each wire, the polylines (n, 2) px of its visible parts, the nearest to the tip first, tip first.
        tips: (k, 2) px of the wires' tips that are seen.
        left, top: of the window in the whole image, px.
        kinds: names of what was drawn.
    """

    image: NDArray[np.uint8]
    wire: NDArray[np.uint8]
    catheter: NDArray[np.uint8]
    tip: Image
    wires: tuple[tuple[Points, ...], ...]
    tips: Points
    left: int
    top: int
    kinds: frozenset[str]


class RandomFluoroscopy:
    """Images and tiles by index; the same seed, index and settings give the same pixels."""

    def __init__(
        self,
        settings: FluoroscopySettings | None = None,
        seed: int = 0,
        courses: Sequence[NDArray[np.floating]] | None = None,
        backgrounds: Sequence[NDArray[np.floating]] | None = None,
    ) -> None:
        """Args:
        courses: curves of wires, tip first, each (n, 2) px or (n, 3) mm, mixed with random ones.
        backgrounds: attenuations (h, w) of what lies behind the wire, such as a projected CT.

        Raises:
            ValueError: a course or a background of another shape, or with values that are not finite.
        """
        self.settings = settings or FluoroscopySettings()
        self.seed = seed
        self.courses = [_checked(curve, "course", (2, 3)) for curve in courses or ()]
        self.backgrounds = [_checked(values, "background", None) for values in backgrounds or ()]

    def image(self, index: int) -> RandomImage:
        """The whole image of an index."""
        side = self.settings.image_px
        return self._window(index, 0, 0, side)

    def along(self, index: int, wires: Sequence[NDArray[np.floating]]) -> RandomImage:
        """A whole image of an index in which the wires lie where they are said to lie.

        Args:
            wires: each (n, 2) px of the whole image, tip first; none: an image without a wire.

        Raises:
            ValueError: a wire of another shape, or with values that are not finite.
        """
        checked = [_checked(points, "wire", (2,)).astype(float) for points in wires]
        courses = [resampled(points, STEP_PX) for points in checked]
        return self._window(index, 0, 0, self.settings.image_px, courses)

    def tile(self, index: int, size_px: int = 256) -> RandomImage:
        """A square window of the image of an index: around a tip, around another place of a wire, or anywhere.

        Raises:
            ValueError: the tile is smaller than 32 px or larger than the image.
        """
        side = self.settings.image_px
        if not _SMALLEST_PX <= size_px <= side:
            raise ValueError(f"size_px: expected {_SMALLEST_PX} to {side} px, the image's side, got {size_px}")
        generator = np.random.default_rng((self.seed, index, _WINDOW))
        courses, _ = self._courses(np.random.default_rng((self.seed, index, _SCENE)))
        draw, place = generator.random(), generator.uniform(0, side, 2)
        if courses and draw < self.settings.near_tip + self.settings.near_wire:
            course = courses[int(generator.integers(len(courses)))]
            inside = course[((course > 0) & (course < side)).all(axis=1)]
            if len(inside):
                place = inside[0] if draw < self.settings.near_tip else inside[int(generator.integers(len(inside)))]
                place = place + generator.uniform(-0.42, 0.42, 2) * size_px
        left, top = np.clip(np.rint(place - size_px / 2), 0, side - size_px).astype(int).tolist()
        return self._window(index, left, top, size_px)

    def clutter(self, index: int, size_px: int | None = None) -> Image:
        """What an image of an index shows beside devices, as attenuation: to be laid over images of another renderer.

        Args:
            size_px: side, at most that of the whole image, of which each pixel then is a mean; None: that side.

        Returns:
            (size_px, size_px): minus the logarithm of the share of the X-rays that pass; bright things are below 0.

        Raises:
            ValueError: a side of less than 32 px, or of more than the image's.
        """
        side = self.settings.image_px
        size_px = side if size_px is None else size_px
        if not _SMALLEST_PX <= size_px <= side:
            raise ValueError(f"size_px: expected {_SMALLEST_PX} to {side} px, the image's side, got {size_px}")
        canvas = Canvas(0, 0, side, side)
        self._scenery(canvas, np.random.default_rng((self.seed, index, _CLUTTER)))
        passed = cv2.resize(np.exp(-canvas.attenuation), (size_px, size_px), interpolation=cv2.INTER_AREA)
        return np.asarray(-np.log(passed), np.float32)

    def _courses(self, generator: np.random.Generator) -> tuple[list[Points], set[str]]:
        """Courses of the wires of an image, and what is special about them."""
        chosen, side = self.settings, self.settings.image_px
        if generator.random() < chosen.no_wire:
            return [], {"no wire"}
        courses, kinds = [], set()
        for _ in range(1 + int(generator.random() < 0.5 * chosen.two_devices)):
            if self.courses and generator.random() < chosen.given_course:
                courses.append(given_course(generator, self.courses, side))
                kinds.add("given course")
            else:
                course, special = wire_course(generator, side)
                courses.append(course)
                kinds |= special
        if len(courses) > 1:
            kinds.add("two wires")
        return courses, kinds

    def _window(self, index: int, left: int, top: int, size_px: int, paths: list[Points] | None = None) -> RandomImage:
        generator = np.random.default_rng((self.seed, index, _SCENE))
        courses, kinds = self._courses(generator)
        courses = courses if paths is None else paths
        canvas = Canvas(left, top, size_px, size_px)
        kinds |= self._scenery(canvas, generator)
        chosen, side = self.settings, self.settings.image_px
        wires, sheaths = np.zeros((2, size_px, size_px), np.uint8)
        for course in courses:
            draw = generator.random(4)
            if draw[0] < chosen.along_edge:
                edge_along(canvas, generator, course)
                kinds.add("wire along an edge")
            if draw[1] < chosen.in_vessel:
                off = generator.uniform(-14, 14)
                longer = drawn_on(generator, course)  # the vessel does not end where the wire does
                around = beside(generator, longer, off, generator.uniform(0, 12), int(generator.uniform(15, 120)))
                vessel_around(canvas, generator, around, filled=generator.random() < 0.35)
                kinds.add("wire in a vessel")
            if draw[2] < chosen.catheter:
                over = generator.random() < 0.6
                first = int(log_uniform(generator, 4, 0.6 * len(course) + 5))
                shift = generator.choice((-1, 1)) * generator.uniform(5, 20)
                sway = generator.uniform(0, 5)
                sheath = course if over else beside(generator, course, shift, sway, 9)
                sheath = sheath[min(first, len(sheath) - 3) :]
                np.maximum(sheaths, self._catheter(canvas, generator, sheath), out=sheaths)
                kinds.add("catheter over the wire" if over else "catheter beside the wire")
            kinds |= wire(canvas, generator, course, chosen)
            np.maximum(wires, strip(canvas, course, chosen.mask_px), out=wires)
        if generator.random() < (0.5 * chosen.two_devices if courses else 0.35):
            course, _ = wire_course(generator, side)
            np.maximum(sheaths, self._catheter(canvas, generator, course), out=sheaths)
            kinds.add("catheter alone")
        generator = np.random.default_rng((self.seed, index, _SENSOR))
        light, shape = sensor.light_field(canvas, generator, chosen)
        kinds.add(f"{shape} field")
        seen = sensor.visible(light)
        grey = sensor.exposed(canvas.attenuation, light, generator, chosen)
        pieces = tuple(_seen_parts(canvas.local(course), seen) for course in courses)
        tips = np.array([canvas.local(course)[0] for course in courses]).reshape(-1, 2)
        tips = tips[[_sees(seen, tip[None])[0] for tip in tips]] if len(tips) else tips
        return RandomImage(
            grey, wires * seen, sheaths * seen, tip_blob(Canvas(0, 0, size_px, size_px), tips), pieces, tips,
            left, top, frozenset(kinds),
        )  # fmt: skip

    def _scenery(self, canvas: Canvas, generator: np.random.Generator) -> set[str]:
        """Draws what is no device."""
        chosen, side = self.settings, self.settings.image_px
        draw = generator.random(3)
        anatomy = draw[0] < chosen.anatomy
        amount = chosen.clutter * log_uniform(generator, 0.35, 2.6) * (generator.random() > 0.06)
        kinds = {"anatomy" if anatomy else "phantom"}
        for things, share in (
            (PHANTOM_CLUTTER, 0.2 if anatomy else 1.0),
            (SMALL_MARKS, 0.8),
            (ANATOMY, 1.0 if anatomy else 0.08),
        ):
            for name, (draw_it, mean) in things.items():
                for _ in range(int(generator.poisson(mean * share * amount))):
                    draw_it(canvas, generator, side)
                    kinds.add(name)
        if draw[1] < chosen.contrast * min(chosen.clutter, 1.0):
            contrast_vessels(canvas, generator, side)
            kinds.add("contrast vessels")
        if self.backgrounds and draw[2] < chosen.background:
            values = self.backgrounds[int(generator.integers(len(self.backgrounds)))]
            canvas.attenuation += sensor.background_grid(generator, values, canvas, side)
            kinds.add("given background")
        if amount > 0:
            tissue(canvas, generator.spawn(1)[0], (0.08 if anatomy else 0.03) * generator.random())
        return kinds

    def _catheter(self, canvas: Canvas, generator: np.random.Generator, course: Points) -> NDArray[np.uint8]:
        width = catheter(canvas, generator, course, self.settings.markers)
        return strip(canvas, course, max(width, self.settings.mask_px))


def _seen_parts(points: Points, seen: NDArray[np.bool_]) -> tuple[Points, ...]:
    """The pieces of a polyline (n, 2) px of the window that lie where `seen` (h, w)."""
    inside = _sees(seen, points)
    edges = np.flatnonzero(np.diff(np.concatenate(([0], inside.astype(np.int8), [0]))))
    return tuple(points[a:b] for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a > 1)


def _sees(seen: NDArray[np.bool_], points: Points) -> NDArray[np.bool_]:
    places = np.rint(points).astype(int)
    height, width = seen.shape
    inside = (places >= 0).all(axis=1) & (places[:, 0] < width) & (places[:, 1] < height)
    inside[inside] = seen[places[inside, 1], places[inside, 0]]
    return np.asarray(inside)


def _checked(values: NDArray[np.floating], what: str, columns: tuple[int, ...] | None) -> NDArray[np.float32]:
    array = np.asarray(values, np.float32)
    shaped = array.ndim == 2 and len(array) >= 2 and (columns is None or array.shape[1] in columns)
    if not shaped or not np.isfinite(array).all():
        known: dict[tuple[int, ...] | None, str] = {None: "(h, w) attenuation", (2,): "(n, 2) px, n at least 2"}
        expected = known.get(columns, "(n, 2) px or (n, 3) mm, n at least 2")
        raise ValueError(f"a {what} must be {expected}, all finite, got an array of shape {array.shape}")
    return array
