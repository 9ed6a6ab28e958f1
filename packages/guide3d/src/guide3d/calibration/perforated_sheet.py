"""The holes of a perforated steel sheet in an X-ray image: found, indexed on their lattice, and measured below a pixel.

The pitch comes from the spectrum, the holes from local maxima, the indices from growing the lattice outwards from the
middle, the centres from fitting blurred discs to the pixels that are in the image. No clicks.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np

from guide3d.calibration.hexagonal_lattice import grow_lattice, local_lattice, missed_sites, regular
from guide3d.image_filters import blurred, largest_around, least_around

logger = logging.getLogger(__name__)

_REACH = 0.6  # pitches around its centre, the pixels that a hole is measured from
_IRREGULAR = 0.055  # of a pitch: farther than this off its neighbours' quadratic, a hole is not one


@dataclass(frozen=True, eq=False)
class SheetHoles:
    """Holes of one sheet image.

    centres_px: (n, 2) sub-pixel centres, x right and y down
    indices: (n, 2) whole axial coordinates (q, r) on the lattice, unique, (0, 0) near the middle of the image
    partial: (n,) bool, cut by the border of the image or of the field
    """

    centres_px: np.ndarray
    indices: np.ndarray
    partial: np.ndarray
    width: int
    height: int

    def __post_init__(self) -> None:
        n = len(self.centres_px)
        if self.centres_px.shape != (n, 2) or self.indices.shape != (n, 2) or self.partial.shape != (n,):
            shapes = f"{self.centres_px.shape}, {self.indices.shape} and {self.partial.shape}"
            raise ValueError(f"expected centres (n, 2), indices (n, 2) and partial (n,), found {shapes}")
        if len(np.unique(self.indices, axis=0)) != n:
            raise ValueError("expected every hole to have its own lattice indices, found some twice")

    def __len__(self) -> int:
        return len(self.centres_px)


def find_holes(image: np.ndarray) -> SheetHoles:
    """Find and index the holes of a perforated sheet, brighter than the steel, in a grey image (h, w).

    Returns:
        The holes, sorted by lattice row and column.

    Raises:
        ValueError: The image is not a grey image, or shows no regular sheet of holes.
    """
    image = np.asarray(image)
    if image.ndim != 2 or min(image.shape) < 64:
        raise ValueError(f"expected a grey image (h, w) of at least 64 x 64 pixels, found shape {image.shape}")
    grey = image.astype(float)
    pitch = _pitch(grey)
    smooth = blurred(grey, 0.16 * pitch)
    bright = largest_around(smooth, int(0.7 * pitch) | 1)
    dark = least_around(smooth, int(1.2 * pitch) | 1)
    contrast = bright - dark
    typical = np.median(contrast)
    rows, columns = np.nonzero((smooth == bright) & (contrast > 0.08 * typical) & (contrast > 0.06 * bright))
    candidates = np.column_stack([columns, rows]).astype(float)
    if len(candidates) < 30:
        raise ValueError(f"expected an X-ray of a perforated sheet, found {len(candidates)} bright holes")
    centres = _centroids(smooth, candidates, pitch)
    chosen, indices = grow_lattice(centres, pitch, image.shape)
    if len(chosen) < 30:
        raise ValueError(f"expected an X-ray of a perforated sheet, found {len(chosen)} holes on one lattice")
    centres = centres[chosen]
    holes = regular(centres, indices, 2 * _IRREGULAR * pitch)
    centres, indices = centres[holes], indices[holes]
    radius, blur = _hole_shape(grey, centres, indices)
    centres, partial, seen = _measured(grey, centres, local_lattice(centres, indices, indices), radius, blur)
    holes = np.flatnonzero(seen)
    for _ in range(4):  # drop what is no hole, look for missed ones beside the kept
        holes = holes[regular(centres[holes], indices[holes], _IRREGULAR * pitch)]
        centres, indices, partial = centres[holes], indices[holes], partial[holes]
        missed, expected = missed_sites(centres, indices)
        new, new_partial, seen = _measured(grey, expected, local_lattice(centres, indices, missed), radius, blur)
        inside = ((new > -0.5) & (new < np.array(image.shape[::-1]) - 0.5)).all(axis=1)
        near = np.linalg.norm(new - expected, axis=1) < 0.15 * pitch
        found = seen & inside & near
        if not found.any():
            break
        centres = np.concatenate([centres, new[found]])
        indices = np.concatenate([indices, missed[found]])
        partial = np.concatenate([partial, new_partial[found]])
        holes = np.arange(len(centres))
    holes = np.flatnonzero(regular(centres, indices, _IRREGULAR * pitch))
    holes = holes[np.lexsort((indices[holes, 0], indices[holes, 1]))]
    logger.debug("%d candidates, %d on the lattice, %d kept", len(candidates), len(chosen), len(holes))
    return SheetHoles(centres[holes], indices[holes], partial[holes], image.shape[1], image.shape[0])


def _pitch(grey: np.ndarray) -> float:
    """Distance of neighbouring holes (px), from the strongest ring of the spectrum."""
    flat = grey - blurred(grey.astype(np.float32), 25.0)
    window = np.hanning(grey.shape[0])[:, None] * np.hanning(grey.shape[1])
    power = np.abs(np.fft.rfft2(flat * window)) ** 2
    frequency = np.hypot(np.fft.fftfreq(grey.shape[0])[:, None], np.fft.rfftfreq(grey.shape[1])[None])
    allowed = (frequency > 1 / 60) & (frequency < 1 / 5)  # pitches of 5 to 60 px
    ring = np.histogram(frequency[allowed], bins=240, range=(0, 0.25), weights=power[allowed])[0]
    strongest = frequency.flat[np.argmax(np.where(allowed, power, 0.0))]
    near = ring[max(int(strongest / 0.25 * 240) - 6, 0) : int(strongest / 0.25 * 240) + 7].sum()
    if near < 0.2 * ring.sum():
        share = near / max(ring.sum(), 1e-12)
        raise ValueError(
            f"expected an X-ray of a perforated sheet, found no regular pattern ({100 * share:.0f} % of "
            "the fine detail at one period, at least 20 % wanted)"
        )
    return float(1 / strongest / np.sqrt(0.75))  # rows of holes lie sqrt(3)/2 of a pitch apart


def _centroids(smooth: np.ndarray, starts: np.ndarray, pitch: float) -> np.ndarray:
    """Centroids (n, 2) of what is brighter than 0.45 of the local contrast, within 0.52 of a pitch."""
    reach = int(np.ceil(0.52 * pitch)) + 1
    offsets = np.arange(-reach, reach + 1)
    dy, dx = (grid.ravel() for grid in np.meshgrid(offsets, offsets, indexing="ij"))
    centres = starts.copy()
    for _ in range(3):
        base = np.rint(centres).astype(int)
        x, y = base[:, :1] + dx, base[:, 1:] + dy
        inside = (x >= 0) & (x < smooth.shape[1]) & (y >= 0) & (y < smooth.shape[0])
        inside &= np.hypot(x - centres[:, :1], y - centres[:, 1:]) < 0.52 * pitch
        values = smooth[np.clip(y, 0, smooth.shape[0] - 1), np.clip(x, 0, smooth.shape[1] - 1)]
        low = np.where(inside, values, np.inf).min(axis=1, keepdims=True)
        high = np.where(inside, values, -np.inf).max(axis=1, keepdims=True)
        weight = np.where(inside, np.clip(values - low - 0.45 * (high - low), 0, None), 0.0)
        total = np.maximum(weight.sum(axis=1), 1e-12)
        centres = np.column_stack([(weight * x).sum(axis=1) / total, (weight * y).sum(axis=1) / total])
    return centres


def _hole_shape(grey: np.ndarray, centres: np.ndarray, indices: np.ndarray) -> tuple[float, float]:
    """Radius of the holes and width of their edges, in pitches, from the holes in the middle of the sheet."""
    middle = np.argsort(np.linalg.norm(centres - centres.mean(axis=0), axis=1))[:200]
    shapes = local_lattice(centres, indices, indices[middle])
    pixels = _pixels_around(shapes)
    radius, blur = 0.33, 0.1
    for _ in range(6):
        discs = _Discs(grey, centres[middle], shapes, pixels, radius, blur)
        by_blur = discs.steep * (discs.rho - radius) / blur
        D = np.concatenate([discs.slopes, discs.steep[..., None], by_blur[..., None]], axis=-1)
        step = np.median(_solve(D, discs.residual, discs.weight)[:, 8:], axis=0)
        radius, blur = float(np.clip(radius + step[0], 0.2, 0.48)), float(np.clip(blur + step[1], 0.03, 0.3))
    return radius, blur


def _measured(
    grey: np.ndarray, centres: np.ndarray, shapes: np.ndarray, radius: float, blur: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centres (n, 2) of blurred discs fitted from starts, which are partial (n,), and which are seen well (n,)."""
    pitch = np.sqrt(np.abs(np.linalg.det(shapes)))
    fitted = centres.copy()
    share, likeness = np.zeros((2, len(centres)))
    pixels = _pixels_around(shapes)
    for start in range(0, len(centres), 64):  # so many stay in a processor's cache
        part = slice(start, start + 64)
        for _ in range(3):
            discs = _Discs(grey, fitted[part], shapes[part], pixels, radius, blur)
            step = _solve(discs.slopes, discs.residual, discs.weight)[:, 6:]
            fitted[part] += np.clip(step, -0.1 * pitch[part, None], 0.1 * pitch[part, None])
        share[part], likeness[part] = discs.share(), discs.likeness()
    near = np.linalg.norm(fitted - centres, axis=1) < 0.25 * pitch
    return fitted, share < 0.98, near & (share > 0.5) & (likeness > 0.7)


def _pixels_around(shapes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Offsets right (m,) and down (m,) of the pixels that holes on lattices (n, 2, 2) are measured from."""
    reach = int(np.ceil(_REACH * np.linalg.norm(shapes, 2, axis=(1, 2)).max(initial=0.0))) + 1
    dy, dx = (grid.ravel() for grid in np.mgrid[-reach : reach + 1, -reach : reach + 1])
    near = np.hypot(dx, dy) <= reach
    return dx[near], dy[near]


class _Discs:
    """Blurred discs, which are round on the lattice and lit by a plane, with the light that fits an image best.

    Args:
        grey: (h, w).
        centres: (n, 2) px.
        shapes: (n, 2, 2) lattice to px.
        pixels: offsets right (m,) and down (m,) of those that count, px.
        radius: of the holes, in pitches.
        blur: width of their edges, in pitches.

    Attributes:
        rho: (n, m) distances from the centres, in pitches.
        steep: (n, m) slopes of the grey values by the radius.
        slopes: (n, m, 8) by the six parameters of the light and the centre's place, px.
    """

    def __init__(
        self,
        grey: np.ndarray,
        centres: np.ndarray,
        shapes: np.ndarray,
        pixels: tuple[np.ndarray, np.ndarray],
        radius: float,
        blur: float,
    ) -> None:
        self.radius, self.to_lattice = radius, np.linalg.inv(shapes)
        base = np.rint(centres).astype(int)
        x, y = base[:, :1] + pixels[0], base[:, 1:] + pixels[1]
        away = np.stack([x - centres[:, :1], y - centres[:, 1:]], axis=-1) @ self.to_lattice.transpose(0, 2, 1)
        self.rho = np.maximum(np.hypot(away[..., 0], away[..., 1]), 1e-9)
        inside = (x >= 0) & (x < grey.shape[1]) & (y >= 0) & (y < grey.shape[0])
        self.weight = (inside & (self.rho < _REACH)).astype(float)
        self.values = grey[np.clip(y, 0, grey.shape[0] - 1), np.clip(x, 0, grey.shape[1] - 1)]
        edge = np.tanh((self.rho - radius) / blur)
        self.disc = 0.5 * (1 - edge)
        self.plane = np.stack([np.ones_like(self.rho), away[..., 0], away[..., 1]], axis=-1)
        A = np.concatenate([self.plane, self.plane * self.disc[..., None]], axis=-1)
        self.light = _solve(A, self.values, self.weight)
        height = (self.plane @ self.light[:, 3:, None])[..., 0]
        self.steep = height * 0.5 * (1 - edge**2) / blur
        outward = (away / self.rho[..., None]) @ self.to_lattice  # of rho along px
        self.slopes = np.concatenate([A, self.steep[..., None] * outward], axis=-1)
        self.residual = self.values - (A @ self.light[..., None])[..., 0]

    def share(self) -> np.ndarray:
        """Of each disc that lies in the image (n,)."""
        seen = (self.disc * self.weight).sum(axis=1) * np.abs(np.linalg.det(self.to_lattice))
        return np.asarray(seen / (np.pi * self.radius**2))

    def likeness(self) -> np.ndarray:
        """How much (n,) of the variation that a lit plane leaves, the disc explains."""
        flat = self.values - (self.plane @ _solve(self.plane, self.values, self.weight)[..., None])[..., 0]
        rest = (self.weight * self.residual**2).sum(axis=1) / np.maximum((self.weight * flat**2).sum(axis=1), 1e-9)
        return np.where(self.light[:, 3] > 0, 1 - rest, 0.0)


def _solve(A: np.ndarray, b: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Weighted least squares for a stack of problems: A (n, m, k), b (n, m), weight (n, m); returns (n, k)."""
    At = (A * weight[..., None]).transpose(0, 2, 1)
    normal = At @ A
    ridge = 1e-9 * (1 + np.trace(normal, axis1=1, axis2=2))[:, None, None] * np.eye(A.shape[-1])
    return np.linalg.solve(normal + ridge, At @ b[..., None])[..., 0]
