"""Beads of a calibration cube in a raw X-ray image: found at any size, and measured below a pixel.

Steel beads are dark discs. Their centres come from fitting blurred ellipses to the transmitted share of the light: the
detector blurs light, so an edge is symmetric in it, and what overlaps multiplies. Beads that touch are fitted together;
wire marks beside a bead count as outliers.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.optimize import least_squares
from scipy.spatial import cKDTree

from guide3d.image_filters import blurred, closed, laplacian, largest_around
from guide3d.opencv import cv2

logger = logging.getLogger(__name__)

_RADII_PX = (3.5, 22.0)  # of beads looked for
_FAINTEST = 0.12  # share of the light that a bead takes away at least
_MOST_CANDIDATES = 400
_LEAST_SHARE = 0.35  # of a bead, inside image and field, that its centre can be measured from


@dataclass(frozen=True, eq=False)
class Attenuation:
    """What darkens an image over its slowly varying background.

    dark: (h, w) natural logarithm of background over image, zero outside the field
    field: (h, w) bool, where the detector is lit
    """

    dark: np.ndarray
    field: np.ndarray


@dataclass(frozen=True, eq=False)
class Beads:
    """Dark discs of one image.

    centres_px: (n, 2) raw px
    radii_px: (n, 2) half axes of the fitted ellipses, the longer first
    contrast: (n,) share of the light that they take away
    misfit: (n,) RMS residual of the fit over the contrast
    share: (n,) of the disc inside the image and the lit field
    """

    centres_px: np.ndarray
    radii_px: np.ndarray
    contrast: np.ndarray
    misfit: np.ndarray
    share: np.ndarray

    def __len__(self) -> int:
        return len(self.centres_px)

    def __getitem__(self, index: np.ndarray) -> Beads:
        return Beads(*(value[index] for value in vars(self).values()))

    def joined(self, more: Beads) -> Beads:
        """These beads, then more."""
        return Beads(*map(np.concatenate, zip(vars(self).values(), vars(more).values(), strict=True)))


def find_beads(image: np.ndarray | Attenuation) -> Beads:
    """Find the beads of a cube image; a few letters or knots of wire may come along.

    Args:
        image: (h, w), grey, raw, beads darker than their surroundings; or its attenuation, to spare making it again.

    Returns:
        The beads, from left to right.

    Raises:
        ValueError: The image is not a grey image.
    """
    light = image if isinstance(image, Attenuation) else attenuation(image)
    starts, radii = _candidates(light, np.geomspace(*_RADII_PX, 9))
    beads = measure_beads(light, starts, radii)
    likely = _likely(beads)
    if likely.sum() < 4:
        return beads[np.zeros(len(beads), bool)]
    # a pair of beads in line looks like one large disc: now that their size is known, look for its halves
    radius = float(np.median(beads.radii_px[likely].mean(axis=1)))
    chosen = beads[np.flatnonzero(likely & _alike(beads, beads[likely]))]
    starts, radii = _candidates(light, np.array([0.6, 0.75]) * radius)
    fresh = cKDTree(chosen.centres_px).query(starts)[0] > 0.8 * radius
    beads = measure_beads(light, starts[fresh], np.full(int(fresh.sum()), radius))
    more = beads[np.flatnonzero(_likely(beads) & _alike(beads, chosen))]
    together = _joined(chosen, more)
    logger.debug("%d beads of %.1f px, %d of them close to others", len(together), radius, len(more))
    return together[np.argsort(together.centres_px[:, 0], kind="stable")]


def _likely(beads: Beads) -> np.ndarray:
    """Which (n,) are dark discs of their own."""
    round_ = beads.radii_px[:, 0] < 1.7 * beads.radii_px[:, 1]
    return (beads.misfit < 0.16) & round_ & (beads.share > 0.6) & (beads.contrast > _FAINTEST)


def _alike(beads: Beads, sure: Beads) -> np.ndarray:
    """Which (n,) are like those of a cube: of one contrast, and of one size up to their distance from the source."""
    contrast = np.median(sure.contrast)
    size = beads.radii_px.mean(axis=1) / np.median(sure.radii_px.mean(axis=1))
    return (beads.contrast > 0.45 * contrast) & (size > 0.62) & (size < 1.7)


def _joined(first: Beads, more: Beads) -> Beads:
    """Both, the second without those that the first, or they themselves, hold twice."""
    joined = []
    centres = list(first.centres_px)
    for k in np.argsort(more.misfit):
        reach = 0.7 * more.radii_px[k].mean()
        if min((np.hypot(*(c - more.centres_px[k])) for c in centres), default=np.inf) > reach:
            joined.append(int(k))
            centres.append(more.centres_px[k])
    return first.joined(more[np.array(joined, int)])


def attenuation(image: np.ndarray) -> Attenuation:
    """What darkens a grey, raw image (h, w) over its slowly varying background, and where the field is lit.

    Raises:
        ValueError: The image is not a grey image.
    """
    image = np.asarray(image)
    if image.ndim != 2 or min(image.shape) < 64:
        raise ValueError(f"expected a grey image (h, w) of at least 64 x 64 pixels, found shape {image.shape}")
    grey = blurred(image.astype(float), 0.7)
    full = np.percentile(grey, 99)
    filled = closed(np.ascontiguousarray(grey[::2, ::2]), 25)  # beads filled up
    lit = _opened(filled > 0.15 * full)
    field = np.kron(lit, np.ones((2, 2), bool))[: image.shape[0], : image.shape[1]]
    logarithm = np.log(np.maximum(grey, 0.0) + 0.02 * max(full, 1.0))
    # beads of up to 20 px radius vanish in it; OpenCV has wide medians of whole numbers only
    coarse = ndimage.median_filter(logarithm[::4, ::4], 15)
    scale, way = np.array([[0.25, 0.0, 0.0], [0.0, 0.25, 0.0]]), cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    size = image.shape[1], image.shape[0]
    background = cv2.warpAffine(coarse, scale, size, flags=way, borderMode=cv2.BORDER_REPLICATE)
    return Attenuation(np.where(field, background - logarithm, 0.0), field)


def _opened(lit: np.ndarray) -> np.ndarray:
    """The parts (h, w) of a lit field that are wider than 6 px; what lies outside the image is dark."""
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    worn = cv2.erode(lit.astype(np.uint8), cross, iterations=3, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    return np.asarray(cv2.dilate(worn, cross, iterations=3), dtype=bool)


def _candidates(light: Attenuation, radii: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places (n, 2) and radii (n,) of dark discs: maxima over place and scale of the Laplacian's response."""
    dark, field = light.dark, light.field
    # a Laplacian of Gaussian answers a disc most strongly where its width is the radius over the square root of two
    # (at half the resolution, which is plenty for a start)
    h, w = (side // 2 for side in dark.shape)
    half = dark[: 2 * h, : 2 * w].reshape(h, 2, w, 2).mean(axis=(1, 3))
    half = half.astype(np.float32)
    stack = np.stack([-(r**2) / 8 * laplacian(half, r / np.sqrt(8)) for r in radii])
    best = stack.max(axis=0)
    peak = (best == largest_around(best, 5)) & field[: 2 * h : 2, : 2 * w : 2]
    strong = np.sort(best[peak])[::-1]
    if not len(strong):
        return np.empty((0, 2)), np.empty(0)
    peak &= best > max(0.25 * np.median(strong[:16]), _FAINTEST / 2)
    rows, columns = np.nonzero(peak)
    order = np.argsort(best[rows, columns])[::-1][:_MOST_CANDIDATES]
    rows, columns = rows[order], columns[order]
    scale = radii[stack[:, rows, columns].argmax(axis=0)]
    places = 2.0 * np.column_stack([columns, rows]) + 0.5
    numbers: list[int] = []  # of two within one disc, the stronger
    for number in range(len(places)):
        near = [k for k in numbers if np.hypot(*(places[k] - places[number])) < 0.8 * max(scale[k], scale[number])]
        if not near:
            numbers.append(number)
    return places[numbers], scale[numbers]


def measure_beads(
    image: np.ndarray | Attenuation, starts: np.ndarray, radii: np.ndarray, shapes: np.ndarray | None = None
) -> Beads:
    """Fit blurred ellipses to beads whose places are roughly known.

    Args:
        image: (h, w), grey, raw; or its attenuation.
        starts: (n, 2) px, within about half a radius.
        radii: (n,) px, rough.
        shapes: (n, 2, 2) what the detector makes of a small circle: holds each bead to the ellipse `radii` times that,
            for beads half hidden by a letter or a border; None fits the ellipse, too.

    Returns:
        One bead a start, in their order; what cannot be measured has an infinite misfit.
    """
    light = image if isinstance(image, Attenuation) else attenuation(image)
    starts, radii = np.asarray(starts, float).reshape(-1, 2), np.asarray(radii, float)
    centres, axes = starts.copy(), np.column_stack([radii, radii])
    contrast, misfit, share = np.zeros(len(starts)), np.full(len(starts), np.inf), np.zeros(len(starts))
    if len(starts):
        for group in _touching(starts, radii):
            held = None if shapes is None else np.linalg.inv(np.asarray(shapes, float)[group])
            fitted = _fit(light, starts[group], radii[group], held)
            centres[group], axes[group], contrast[group], misfit[group], share[group] = fitted
    return Beads(centres, axes, contrast, misfit, share)


def _touching(starts: np.ndarray, radii: np.ndarray) -> list[list[int]]:
    """Groups of beads whose rims come within a few pixels of each other."""
    group = np.arange(len(starts))
    for i, j in cKDTree(starts).query_pairs(2 * radii.max() + 6):
        if np.hypot(*(starts[i] - starts[j])) < radii[i] + radii[j] + 6:
            group[group == group[j]] = group[i]
    groups = [np.flatnonzero(group == number).tolist() for number in np.unique(group)]
    # a fit of more than four together is a letter, not beads: each of those on its own
    return [part for g in groups for part in ([g] if len(g) <= 4 else [[k] for k in g])]


def _fit(
    light: Attenuation, starts: np.ndarray, radii: np.ndarray, held: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Blurred ellipses on a plane: a centre, a 2 x 2 shape, a contrast and a blur each."""
    dark, field, k = light.dark, light.field, len(starts)
    reach = 1.9 * radii.max() + 3
    low = np.maximum(np.floor(starts.min(axis=0) - reach).astype(int), 0)
    high = np.minimum(np.ceil(starts.max(axis=0) + reach).astype(int) + 1, dark.shape[::-1])
    failed = starts, np.column_stack([radii, radii]), np.zeros(k), np.full(k, np.inf), np.zeros(k)
    if (high - low < 6).any():
        return failed
    y, x = np.mgrid[low[1] : high[1], low[0] : high[0]]
    near = np.hypot(x[..., None] - starts[:, 0], y[..., None] - starts[:, 1]).min(axis=2) < reach
    near &= field[low[1] : high[1], low[0] : high[0]]
    if near.sum() < 40:
        return failed
    x, y = x[near].astype(float), y[near].astype(float)
    values = 1 - np.exp(-dark[low[1] : high[1], low[0] : high[0]][near])
    height = max(float(np.percentile(values, 90)), 1e-3)
    middle = starts.mean(axis=0)

    fixed = None if held is None else _symmetric(held) / radii[:, None]

    def beads_of(parameters: np.ndarray) -> np.ndarray:
        own = parameters[3:].reshape(k, 7).copy()
        if fixed is not None:
            own[:, 2:5] = fixed
        return own

    ramp = np.stack([np.ones_like(x), (x - middle[0]) / radii.max(), (y - middle[1]) / radii.max()])

    def residual(parameters: np.ndarray) -> np.ndarray:
        through = np.prod([1 - p[6] * _disc(p, x, y)[0] for p in beads_of(parameters)], axis=0)
        return (values - 1 + (1 - parameters[:3] @ ramp) * through) / height

    def jacobian(parameters: np.ndarray) -> np.ndarray:
        own = beads_of(parameters)
        discs = [_disc(p, x, y) for p in own]
        light = 1 - parameters[:3] @ ramp
        through = np.array([1 - p[6] * disc for p, (disc, _) in zip(own, discs, strict=True)])
        rows = [*(-ramp * through.prod(axis=0))]
        for number, (p, (disc, slopes)) in enumerate(zip(own, discs, strict=True)):
            rest = -light * np.delete(through, number, axis=0).prod(axis=0)
            rows += [*(rest * p[6] * slopes), rest * disc]
            if fixed is not None:
                for column in (-5, -4, -3):
                    rows[column] = np.zeros_like(x)
        return np.array(rows).T / height

    first = np.concatenate(
        [np.zeros(3), *([*c, 1 / r, 0.0, 1 / r, 0.25, height] for c, r in zip(starts, radii, strict=True))]
    )
    # order of a bead's seven: x, y, shape 11, 12, 22, blur, contrast
    typical_sizes = [[1.0, 1.0, 0.1 / r, 0.1 / r, 0.1 / r, 0.1, height] for r in radii]  # so that steps are fair
    scales = np.concatenate([np.full(3, 0.1 * height), np.array(typical_sizes).ravel()])
    solver = {"f_scale": 0.05, "max_nfev": 60, "x_scale": scales}
    try:
        fit = least_squares(residual, first, jac=jacobian, loss="soft_l1" if held is None else "cauchy", **solver)
    except (np.linalg.LinAlgError, ValueError):
        return failed
    own, off = beads_of(fit.x), residual(fit.x)
    centres, axes, contrast = own[:, :2], np.empty((k, 2)), own[:, 6]
    misfit, share = np.empty(k), np.empty(k)
    for number, p in enumerate(own):
        shape = np.array([[p[2], p[3]], [p[3], p[4]]])
        axes[number] = np.sort(1 / np.maximum(np.abs(np.linalg.eigvalsh(shape)), 1e-3))[::-1]
        rho = np.hypot(*(shape @ (np.array([x, y]) - p[:2, None])))
        inner = rho < 1.15
        # the median forgives a wire that crosses the bead, a mean would not
        typical = 1.48 * np.median(np.abs(off[inner])) if inner.sum() > 9 else np.inf
        misfit[number] = typical * height / max(contrast[number], 1e-6)
        share[number] = min((rho < 1).sum() / (np.pi * axes[number].prod()), 1.0)
    far = np.linalg.norm(centres - starts, axis=1) > np.maximum(0.8 * radii, 3)
    lost = far | (contrast <= 0) | (share < _LEAST_SHARE)
    return centres, axes, contrast, np.where(lost, np.inf, misfit), share


def _symmetric(shapes: np.ndarray) -> np.ndarray:
    """Entries 11, 12, 22 (n, 3) of the symmetric matrices that measure lengths as shapes (n, 2, 2) do."""
    values, axes = np.linalg.eigh(shapes.transpose(0, 2, 1) @ shapes)
    root = (axes * np.sqrt(values)[:, None]) @ axes.transpose(0, 2, 1)
    return np.column_stack([root[:, 0, 0], root[:, 0, 1], root[:, 1, 1]])


def _disc(p: np.ndarray, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A blurred ellipse (n,) at pixels, and its slopes (6, n) by x, y, shape 11, 12, 22 and blur."""
    dx, dy = x - p[0], y - p[1]
    u, v = p[2] * dx + p[3] * dy, p[3] * dx + p[4] * dy
    rho = np.maximum(np.hypot(u, v), 1e-9)
    blur = max(abs(p[5]), 0.02)
    edge = np.tanh((rho - 1) / blur)
    steep = -0.5 * (1 - edge**2) / blur
    u, v = u / rho, v / rho
    along = np.array([-u * p[2] - v * p[3], -u * p[3] - v * p[4], u * dx, u * dy + v * dx, v * dy, -(rho - 1) / blur])
    return 0.5 * (1 - edge), steep * along
