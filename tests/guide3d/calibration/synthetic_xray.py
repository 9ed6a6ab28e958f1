"""X-ray images of a perforated sheet and of a bead cube, drawn with known truth: to rehearse and to test a calibration.

The detector is an image intensifier: a pincushion and a swirl between the ideal and the raw image, a round field, less
light towards its rim, noise that grows with the light.
"""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from guide3d.calibration.hexagonal_lattice import lattice_points
from guide3d.geometry.camera import Camera


@dataclass(frozen=True)
class SyntheticDetector:
    """An image intensifier with a distortion in closed form.

    width, height: of the image, px
    pincushion: relative growth of the raw image at half its width from the middle
    swirl: rotation of the raw image there, rad
    field: radius of the lit field over half the image's width
    counts: of the noise, at full light, in units of a grey value; more is quieter
    """

    width: int = 1024
    height: int = 1024
    pincushion: float = 0.05
    swirl: float = 0.03
    field: float = 1.15
    counts: float = 4.0

    @property
    def _middle(self) -> np.ndarray:
        return (np.array([self.width, self.height]) - 1) / 2

    def undistort(self, raw: np.ndarray) -> np.ndarray:
        """Ideal pixels (..., 2) of raw ones (..., 2)."""
        away = (np.asarray(raw, float) - self._middle) / (self.width / 2)
        r2 = (away**2).sum(axis=-1)
        factor = (1 - self.pincushion * r2) * np.exp(-1j * self.swirl * r2)
        turned = (away[..., 0] + 1j * away[..., 1]) * factor
        return np.stack([turned.real, turned.imag], axis=-1) * (self.width / 2) + self._middle

    def distort(self, ideal: np.ndarray) -> np.ndarray:
        """Raw pixels (..., 2) of ideal ones (..., 2)."""
        ideal = np.asarray(ideal, float)
        # far outside the image the closed form folds over: keep to where it is one to one
        ideal = np.clip(ideal, self._middle - self.width, self._middle + self.width)
        raw = ideal.copy()
        for _ in range(60):
            raw = raw + 0.8 * (ideal - self.undistort(raw))
        return raw

    def pixels(self) -> np.ndarray:
        """Raw places (h, w, 2) of all pixels."""
        x, y = np.meshgrid(np.arange(self.width, dtype=float), np.arange(self.height, dtype=float))
        return np.stack([x, y], axis=-1)

    def exposed(self, transmitted: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Grey image (h, w) uint8 of a share of light (h, w): falling towards the rim, dark beyond it, noisy."""
        away = np.linalg.norm(self.pixels() - self._middle, axis=-1) / (self.width / 2)
        rim = 1 / (1 + np.exp((away - self.field) / 0.012))
        light = 210 * (1 - 0.35 * (away / self.field) ** 2) * rim * transmitted
        noisy = light + rng.normal(size=light.shape) * np.sqrt(np.maximum(light, 1.0) / self.counts) + 4
        return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def draw_sheet(
    detector: SyntheticDetector,
    rng: np.random.Generator,
    pitch_px: float = 14.5,
    angle: float = 0.3,
    irregular: float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """An image (h, w) uint8 of a perforated sheet, and the true raw centres (n, 2) of the holes in the lit image.

    `angle` is that of the rows, rad, `irregular` the standard deviation of a hole's place, ideal px a coordinate.
    """
    turn = pitch_px * np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    middle = (np.array([detector.width, detector.height]) - 1) / 2
    reach = int(1.2 * max(detector.width, detector.height) / pitch_px)
    sites = np.stack(np.meshgrid(np.arange(-reach, reach + 1), np.arange(-reach, reach + 1)), axis=-1)
    ideal = lattice_points(sites) @ turn + middle
    ideal = ideal + irregular * rng.normal(size=ideal.shape)
    place = detector.undistort(detector.pixels())
    steps = (place - middle) @ np.linalg.inv(turn)
    r = np.rint(steps[..., 1] / np.sqrt(0.75)).astype(int)
    nearest = np.full(place.shape[:2], np.inf)
    for dr in (-1, 0, 1):  # the nearest hole lies in this row or one beside it
        q = np.rint(steps[..., 0] - 0.5 * (r + dr)).astype(int)
        hole = ideal[np.clip(r + dr + reach, 0, 2 * reach), np.clip(q + reach, 0, 2 * reach)]
        nearest = np.minimum(nearest, np.linalg.norm(place - hole, axis=-1))
    steel = 0.5 * (1 + np.tanh((nearest / pitch_px - 0.35) / 0.07))
    image = detector.exposed(1 - 0.72 * steel, rng)
    flat = ideal.reshape(-1, 2)
    near = np.linalg.norm(flat - middle, axis=1) < detector.field * detector.width / 2
    raw = detector.distort(flat[near])
    inside = ((raw >= 0) & (raw <= np.array([detector.width, detector.height]) - 1)).all(axis=1)
    lit = np.linalg.norm(raw - middle, axis=1) < (detector.field - 0.02) * detector.width / 2
    return image, raw[inside & lit]


def cube_points_mm(count: int = 4, pitch_mm: float = 65.0) -> np.ndarray:
    """Beads (count³, 3) mm of a cube, x running fastest, then y, then z."""
    steps = pitch_mm * np.arange(count)
    z, y, x = np.meshgrid(steps, steps, steps, indexing="ij")
    return np.column_stack([x.ravel(), y.ravel(), z.ravel()])


def draw_cube(
    detector: SyntheticDetector,
    camera: Camera,
    points_mm: np.ndarray,
    rng: np.random.Generator,
    marked: Mapping[str, int] | None = None,
    left_out: float = 0.0,
    clutter: int = 0,
    bead_mm: float = 3.2,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """An image (h, w) uint8 of a bead cube, the numbers (m,) of the beads in the lit image, their raw centres (m, 2).

    Some beads are `marked` by a wire beside them ("single", "double" or "circle"), a share is left out, and there may
    be discs of bead size that belong to nothing.
    """
    place = detector.undistort(detector.pixels())
    through = np.ones(place.shape[:2])
    there = rng.random(len(points_mm)) >= left_out
    scale = camera.K[0, 0] / camera.depth_mm(points_mm)
    ideal = camera.project(points_mm)
    for centre, radius in zip(ideal[there], scale[there] * bead_mm / 2, strict=True):
        _darken(through, place, centre[None], radius, 0.7)
    for _ in range(clutter):
        centre = np.array([rng.uniform(0, detector.width), rng.uniform(0, detector.height)])
        _darken(through, place, centre[None], float(np.median(scale)) * bead_mm / 2 * rng.uniform(0.8, 1.2), 0.7)
    for kind, bead in (marked or {}).items():
        for wire in _wires(kind, points_mm[bead]):
            _darken(through, place, camera.project(wire), 0.3 * scale[bead], 0.22)
    raw = detector.distort(ideal)
    middle = (np.array([detector.width, detector.height]) - 1) / 2
    seen = there & ((raw >= 0) & (raw <= np.array([detector.width, detector.height]) - 1)).all(axis=1)
    seen &= np.linalg.norm(raw - middle, axis=1) < (detector.field - 0.03) * detector.width / 2
    return detector.exposed(through, rng), np.flatnonzero(seen), raw[seen]


def _darken(through: np.ndarray, place: np.ndarray, line: np.ndarray, radius: float, share: float) -> None:
    """Take light away within `radius` of a polyline (k, 2), a disc where it has one point."""
    low, high = line.min(axis=0) - 4 * radius - 40, line.max(axis=0) + 4 * radius + 40
    columns = slice(max(int(low[0]), 0), max(int(high[0]), 0))
    rows = slice(max(int(low[1]), 0), max(int(high[1]), 0))
    own = place[rows, columns]
    if not own.size:
        return
    if len(line) == 1:
        distance = np.linalg.norm(own - line[0], axis=-1)
    else:
        distance = np.full(own.shape[:2], np.inf)
        for a, b in itertools.pairwise(line):
            along = np.clip(((own - a) @ (b - a)) / max(float((b - a) @ (b - a)), 1e-9), 0, 1)
            distance = np.minimum(distance, np.linalg.norm(own - a - along[..., None] * (b - a), axis=-1))
    through[rows, columns] *= 1 - share * 0.5 * (1 - np.tanh((distance - radius) / 1.2))


def _wires(kind: str, bead: np.ndarray) -> list[np.ndarray]:
    """The wires (k, 3) mm of a mark beside a bead, in the upright plane at 45 degrees to the cube's sides."""
    across, up = np.array([1.0, -1.0, 0.0]) / np.sqrt(2), np.array([0.0, 0.0, 1.0])
    if kind == "single":
        return [bead + np.array([4 * across + 4 * up, 6 * across - 18 * up])]
    if kind == "double":
        return [bead + np.array([-6 * across + height * up, 2 * across + height * up]) for height in (-3.2, 3.2)]
    if kind == "circle":
        turn = np.linspace(0.0, 5.2, 24)[:, None]
        return [bead + 3.8 * ((np.cos(turn) - 1) * across + np.sin(turn) * up)]
    return []
