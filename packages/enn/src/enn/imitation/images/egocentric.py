"""Egocentric view: what fluoroscopic images show of wire, vessel and target, measured from the wire's tip.

Everything is computed from images: the wire is traced in its mask, the vessel comes as a map of lumen made from the
episode's first image, and the way to the target's dot is the cheapest one through that map. Lengths are shares of the
image's side, directions are those of the tip's frame (x along the wire and out of its tip), so that anatomies
differ by their shape alone.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from enn.imitation.images.wire_tracing import at_arcs, smoothed, trace_wire, without_specks, without_wire

Array = NDArray[np.float64]

MAP_SIZE = 96  # px: side of the map in which ways are sought
OUTSIDE_COST = 12.0  # a way outside the lumen counts as so many times longer
WAY_ARCS = np.array([0.015, 0.03, 0.05, 0.08, 0.12, 0.18, 0.25])  # ahead, shares of the image's side
WIRE_ARCS = np.array([0.015, 0.03, 0.045, 0.06, 0.09, 0.14, 0.2, 0.3])  # behind
RAY_REACH, RAY_SAMPLES, RAYS = 0.15, 16, 8
HEADING_ARC = 0.03  # the tip's direction is that of this much of the wire
LENGTH_SCALE, MOTION_SCALE = 0.1, 0.02
SEEN = 12  # px: of a wire whose entry is believed
_SMOOTHING = 5  # points
_STEPS = ((0, 1, 1.0), (1, 0, 1.0), (1, 1, 2**0.5), (1, -1, 2**0.5))

_COVERED, _COVERED_SHARE = 8, 0.75  # points from the catheter's end on, and how many of them are to lie in it

VIEW_SIZE = 2 * len(WAY_ARCS) + 2 * len(WIRE_ARCS) + 2 * RAYS + 17
CATHETER_SIZE = 7  # further numbers where a catheter lies over the wire


def lumen_distance(lumen: NDArray[np.floating], target: Array) -> tuple[Array, NDArray[np.intp]]:
    """Length of the cheapest way from every pixel to a target; a way outside the lumen counts OUTSIDE_COST times.

    Args:
        lumen: probability that a pixel shows the vessel's lumen. Shape (n, n).
        target: row and column. Shape (2,).

    Returns:
        Lengths in pixels, shape (n, n), and for each pixel the flat index of the next one on its way, shape (n * n,).
    """
    size = lumen.shape[0]
    cost = 1.0 + (OUTSIDE_COST - 1.0) * (1.0 - np.clip(lumen, 0.0, 1.0).astype(float)) ** 2
    cost = np.pad(cost, 1, constant_values=np.inf)
    length = np.full(cost.shape, np.inf)
    row, column = np.clip(np.rint(target).astype(int), 0, size - 1) + 1
    length[row, column] = 0.0
    wide = size + 2
    shifts = [(a * wide + b, c) for a, b, c in _STEPS] + [(-a * wide - b, c) for a, b, c in _STEPS]
    flat, price = length.reshape(-1), cost.reshape(-1)
    inner = (np.arange(1, size + 1)[:, None] * wide + np.arange(1, size + 1)).ravel()
    mean_price = [0.5 * scale * (price[inner] + price[inner + shift]) for shift, scale in shifts]
    while True:  # every sweep extends ways by one pixel
        before = flat[inner]
        best = before
        for (shift, _), step in zip(shifts, mean_price, strict=True):
            best = np.minimum(best, flat[inner + shift] + step)
        flat[inner] = best
        if not (best < before - 1e-9).any():
            break
    through = np.stack([flat[inner + shift] + step for (shift, _), step in zip(shifts, mean_price, strict=True)])
    chosen = inner + np.array([shift for shift, _ in shifts])[np.argmin(through, axis=0)]
    own_index = row * wide + column
    chosen[inner == own_index] = own_index
    return flat[inner].reshape(size, size), (chosen // wide - 1) * size + chosen % wide - 1


class EgocentricView:
    """The view from the tip over one episode; begin with `start`, then `look` once a decision.

    Attributes:
        axis: of the devices as last looked at, from the tip to the entry, rows and columns over the image's side.
            Shape (n, 2).
        catheter_arc: length along it to the catheter's end, in the same unit; None: there is none.
    """

    axis: Array
    catheter_arc: float | None

    def start(
        self,
        image: NDArray[np.uint8],
        mask: NDArray[np.uint8],
        target_image: NDArray[np.uint8],
        lumen: NDArray[np.floating],
        empty: NDArray[np.uint8] | None = None,
    ) -> None:
        """Begins an episode with its first images.

        Args:
            image: grey. Shape (1, size, size).
            mask: the wire's pixels, not 0. Shape (1, size, size).
            target_image: the target's dot alone. Shape (1, size, size).
            lumen: probability of the vessel's lumen. Shape (size, size).
            empty: grey, from before the wire came in, shape (1, size, size); None: `image` with the wire filled in.

        Raises:
            ValueError: images of different sizes, or without a target's dot.
        """
        size = image.shape[-1]
        shapes = {image.shape, mask.shape, target_image.shape, (1, *lumen.shape)}
        shapes |= set() if empty is None else {empty.shape}
        if shapes != {(1, size, size)}:
            raise ValueError(f"expected images of one shape (1, size, size), got {sorted(shapes)}")
        weight = target_image[0].astype(float)
        if not weight.any():
            raise ValueError("the target's image shows no dot: the target lies outside the view")
        self.size = size
        rows, columns = np.mgrid[:size, :size]
        self.target = np.array([(weight * rows).sum(), (weight * columns).sum()]) / weight.sum() / size
        self._empty = without_wire(image[0], mask[0] > 0) if empty is None else empty[0].astype(float)
        self._lumen = np.asarray(lumen, float)
        grid = (np.arange(MAP_SIZE) + 0.5) * size / MAP_SIZE - 0.5
        small = sample(self._lumen, np.stack(np.meshgrid(grid, grid, indexing="ij"), axis=-1))
        length, following = lumen_distance(small, (self.target * MAP_SIZE) - 0.5)
        self._length, self._following = length / MAP_SIZE, following.tolist()
        self._entry: tuple[int, int] | None = None
        self._before: tuple[Array, Array, float] | None = None

    @property
    def lumen(self) -> Array:
        """Probability of the lumen that the episode began with. Shape (size, size)."""
        return self._lumen

    def wire(self, image: NDArray[np.uint8], mask: NDArray[np.uint8]) -> Array:
        """The wire's axis from tip to entry, rows and columns over the image's side. Shape (n, 2)."""
        traced = trace_wire(without_specks(mask[0] > 0), self._entry)
        if len(traced) < 2:
            entry = np.array(self._entry or (self.size - 1, self.size // 2), float)
            return np.stack((entry - (1.0, 0.0), entry)) / self.size
        if self._entry is None and len(traced) >= SEEN:
            self._entry = int(traced[-1, 0]), int(traced[-1, 1])
        last = self.size - 1
        dark = np.clip(self._empty - image[0], 0.0, None) * (mask[0] > 0) + 1e-3
        total, centre = np.zeros(len(traced)), np.zeros((len(traced), 2))
        for a in (-1, 0, 1):
            for b in (-1, 0, 1):
                rows, columns = np.clip(traced[:, 0] + a, 0, last), np.clip(traced[:, 1] + b, 0, last)
                weight = dark[rows, columns]
                total += weight
                centre += weight[:, None] * np.stack((rows, columns), axis=1)
        axis = centre / total[:, None]
        return (smoothed(axis, _SMOOTHING) + 0.5) / self.size

    def way(self, place: Array) -> tuple[Array, float]:
        """The way from a place to the target through the lumen.

        Args:
            place: row and column over the image's side. Shape (2,).

        Returns:
            Its beginning, shape (n, 2), in the same unit, and its whole length, outside the lumen counted more.
        """
        at = np.clip((place * MAP_SIZE).astype(int), 0, MAP_SIZE - 1)
        start = int(at[0]) * MAP_SIZE + int(at[1])
        remaining = float(self._length[at[0], at[1]])
        nodes = [start]
        for _ in range(round(1.3 * WAY_ARCS[-1] * MAP_SIZE) + 3):
            following = self._following[nodes[-1]]
            if following == nodes[-1]:
                break
            nodes.append(following)
        flat = np.array(nodes)
        points = (np.stack((flat // MAP_SIZE, flat % MAP_SIZE), axis=1) + 0.5) / MAP_SIZE
        points[0] = place
        if len(points) > 4:
            inner = 0.25 * points[:-2] + 0.5 * points[1:-1] + 0.25 * points[2:]
            points = np.concatenate((points[:1], inner, points[-1:]))
        return points, remaining

    def look(
        self,
        image: NDArray[np.uint8],
        mask: NDArray[np.uint8],
        action: ArrayLike,
        catheter: NDArray[np.uint8] | None = None,
    ) -> NDArray[np.float32]:
        """What the images show from the tip.

        Args:
            image: grey. Shape (1, size, size).
            mask: the wire's pixels, with a catheter those of both devices, not 0. Shape (1, size, size).
            action: of the wire in the previous decision, zeros for the first. Shape (2,).
            catheter: its pixels, not 0, shape (1, size, size); None: there is none.

        Returns:
            Points of the way ahead over their distances (14); length of the way and the hyperbolic tangent of it (2);
            the target over its distance, and its distance (3); points of the wire behind over their distances (16);
            distance to the lumen's border along eight directions and the lumen's mean along them (16); the tip's
            direction in the image (2), its place relative to the entry (2); length of the wire seen (1) and its change
            (1); motion of the tip (2) and turn of its direction (2) since the last look; the previous action (2).
            Shape (VIEW_SIZE,); with a catheter `catheter_end` follows, shape (VIEW_SIZE + CATHETER_SIZE,).
        """
        self.axis = points = self.wire(image, mask)
        tip = points[0]
        arc = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))))
        back = at_arcs(points, arc, np.array([HEADING_ARC]))[0]
        heading = tip - back
        heading /= max(float(np.hypot(*heading)), 1e-9)
        axes = np.array([heading, (-heading[1], heading[0])]).T  # columns: along the wire, across it
        behind = (at_arcs(points, arc, WIRE_ARCS) - tip) @ axes / WIRE_ARCS[:, None]
        way, remaining = self.way(tip)
        along = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(way, axis=0).T))))
        ahead = (at_arcs(way, along, WAY_ARCS) - tip) @ axes / WAY_ARCS[:, None]
        goal = (self.target - tip) @ axes
        away = float(np.hypot(*goal))
        angle = np.arange(RAYS) * 2 * np.pi / RAYS
        directions = np.stack((np.cos(angle), np.sin(angle)), axis=1) @ axes.T
        reach = np.arange(1, RAY_SAMPLES + 1) * RAY_REACH / RAY_SAMPLES
        seen = sample(self._lumen, (tip + directions[:, None] * reach[:, None]) * self.size - 0.5)
        inside = np.minimum.accumulate(seen > 0.5, axis=1).mean(axis=1)
        before = self._before or (tip, heading, float(arc[-1]))
        self._before = tip, heading, float(arc[-1])
        entry = points[-1]
        cosine, sine = float(heading @ before[1]), float(heading[1] * before[1][0] - heading[0] * before[1][1])
        of_catheter = [] if catheter is None else [catheter_end(points, arc, axes, catheter[0] > 0)]
        self.catheter_arc = float(of_catheter[0][1]) * 5 * LENGTH_SCALE if of_catheter else None
        return np.concatenate(
            (
                ahead.ravel(),
                (remaining / (5 * LENGTH_SCALE), np.tanh(remaining / LENGTH_SCALE)),
                goal / max(away, 1e-3),
                (np.tanh(away / LENGTH_SCALE),),
                behind.ravel(),
                2 * inside,
                seen.mean(axis=1),
                heading,
                (tip - entry) / (5 * LENGTH_SCALE),
                (arc[-1] / (5 * LENGTH_SCALE), (arc[-1] - before[2]) / MOTION_SCALE),
                np.clip((tip - before[0]) @ axes / MOTION_SCALE, -5, 5),
                (cosine, sine),
                np.asarray(action, float),
                *of_catheter,
            )
        ).astype(np.float32)


def catheter_end(points: Array, arc: Array, axes: Array, catheter: NDArray[np.bool_]) -> Array:
    """Where a catheter ends on the wire that comes out of it.

    Args:
        points: the axis of both devices from the tip on, rows and columns over the image's side. Shape (n, 2).
        arc: its length up to each point, from 0. Shape (n,).
        axes: columns along the tip and across it. Shape (2, 2).
        catheter: its pixels. Shape (size, size).

    Returns:
        Whether it is seen (1), the distance along the axis from the tip to its end and the hyperbolic tangent of it
        (2), the place of its end from the tip (2) and its direction there (2) in the tip's frame. Shape (7,). Where it
        is not seen it ends at the access site.
    """
    size = len(catheter)
    wide = np.pad(catheter, 1)
    beside = [wide[a : a + size, b : b + size] for a in range(3) for b in range(3)]  # of a thin tube pixels are missed
    rows, columns = np.clip((points * size).astype(int), 0, size - 1).T
    covered = np.concatenate((np.any(beside, axis=0)[rows, columns], np.zeros(_COVERED)))
    shares = np.convolve(covered, np.ones(_COVERED) / _COVERED, "valid")[: len(points)]
    covered_points = np.flatnonzero((shares >= _COVERED_SHARE) & (covered[: len(points)] > 0))
    end = int(covered_points[0]) if len(covered_points) else len(points) - 1
    far = float(arc[end])
    back = at_arcs(points, arc, np.array([far + HEADING_ARC]))[0]
    direction = points[end] - back
    direction = direction / max(float(np.hypot(*direction)), 1e-9)
    place = (points[end] - points[0]) @ axes / LENGTH_SCALE
    lengths = (far / (5 * LENGTH_SCALE), np.tanh(far / LENGTH_SCALE))
    return np.concatenate(((float(len(covered_points) > 0),), lengths, place, direction @ axes))


def sample(values: Array, places: Array) -> Array:
    """Bilinear interpolation; outside the image its border's value counts.

    Args:
        values: shape (height, width).
        places: rows and columns, px. Shape (..., 2).

    Returns:
        Shape (...).
    """
    limit = np.array(values.shape) - 1
    at = np.clip(places, 0.0, limit)
    low = np.minimum(at.astype(np.intp), limit - 1)
    (a, b), (row, column) = np.moveaxis(at - low, -1, 0), np.moveaxis(low, -1, 0)
    upper = values[row, column] * (1 - b) + values[row, column + 1] * b
    lower = values[row + 1, column] * (1 - b) + values[row + 1, column + 1] * b
    return upper * (1 - a) + lower * a
