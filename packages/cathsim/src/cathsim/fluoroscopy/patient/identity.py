"""Whether a CT is that of the patient whose vessels were imported: they lie within it, hold blood, and stand out."""

from __future__ import annotations

import itertools
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from cathsim.anatomy.mesh.report import MeshRefusedError

_INSIDE = 0.9  # of the lumen must lie within the CT
_DEEP = 1e-3  # m from the wall: there a voxel is blood
_LEAST, _MOST = -30.0, 900.0  # Hounsfield units of blood, with contrast or without
_BLOOD_SHARE = 0.85  # of the lumen must lie between
_CONTRAST = 150.0  # Hounsfield units: more is contrast agent
_NATIVE_SPREAD = 200.0  # Hounsfield units between the tenths of a lumen without contrast
_SHELL = (-5e-3, -2e-3)  # m from the wall, outside
_STANDS_OUT = 25.0  # Hounsfield units by which blood exceeds what lies around the vessels, on average
_SAMPLES = 20_000  # places in the lumen, and around it, that are looked at
_STEPS = (8e-3, 4e-3, 2e-3, 1e-3)  # m, of the search for where the vessels stand out most
_STILL_INSIDE = 0.8  # of the lumen must lie within the CT where it is moved to
_MOST_SHIFT = 0.03  # m of that search: beyond, somebody else's vessels may be met
_DISPLACED = 7e-3  # m from there: labels' voxels, breath and pulse account for less
_NOTED = 3e-3  # m from there that is noted
_GAIN = 1.15  # by which the vessels must stand out more there

Array = NDArray[np.float64]


def check_patient(values: NDArray[np.int16], to_index: Array, grid: Any, file: str) -> tuple[float, str]:
    """Refuses the CT of somebody else, and one that lies beside the vessels.

    Args:
        values: (nx, ny, nz) Hounsfield units.
        to_index: (4, 4) from the world, m, to indices.

    Returns:
        Hounsfield units by which the lumen exceeds what lies around it, and a note where it lies a little aside.

    Raises:
        MeshRefusedError: in one sentence.
    """
    generator = np.random.default_rng(0)
    lumen = np.asarray(grid.coordinates(grid.inside()))
    lumen = lumen[generator.integers(len(lumen), size=_SAMPLES)]
    at = _indices(lumen, to_index)
    held = float(np.mean(((at >= -0.5) & (at <= np.array(values.shape) - 0.5)).all(axis=1)))
    if held < _INSIDE:
        raise MeshRefusedError(
            f"{file} is another patient's CT, or lies in another frame: {100 * held:.0f} % of the vessels lie within "
            f"it, expected {100 * _INSIDE:.0f}; give the CT that the labels were drawn on."
        )
    beside = lumen + generator.normal(0.0, -_SHELL[0], lumen.shape)
    distance = grid.sample(beside)
    places = lumen[grid.sample(lumen) > _DEEP], beside[(distance > _SHELL[0]) & (distance < _SHELL[1])]
    stands_out = _standing_out(values, places, to_index, np.zeros(3))
    shift, most = _best_shift(values, places, to_index, stands_out)
    far = float(np.linalg.norm(shift))
    moved = bool(np.isfinite(stands_out)) and far > _DISPLACED and most > _GAIN * stands_out
    within = [[_sampled(values, _indices(part + by, to_index)) for part in places] for by in (np.zeros(3), shift)]
    fault = _fault_of_blood(*within[0])
    if moved and far <= _MOST_SHIFT and _fault_of_blood(*within[1]) is None:
        fault = (
            f"lies beside the vessels: they would stand out from it by {most:.0f} instead of {stands_out:.0f} "
            f"Hounsfield units {_in_words(shift)} where they are; give the CT that the labels were drawn on, in its "
            "own frame."
        )
    elif moved and fault is None:
        fault = (
            f"is another patient's CT: the vessels would stand out from it more {1e3 * far:.0f} mm from where they "
            "are; give the CT that the labels were drawn on."
        )
    if fault is not None:
        raise MeshRefusedError(f"{file} {fault}")
    if far < _NOTED or most <= _GAIN * stands_out:
        return stands_out, ""
    return stands_out, (
        f"{file} and the vessels lie {1e3 * far:.0f} mm apart: they would stand out from it by {most:.0f} instead of "
        f"{stands_out:.0f} Hounsfield units {_in_words(shift)} where they are; they stay there"
    )


def _fault_of_blood(inside: Array, around: Array) -> str | None:
    """What is said of a CT in which the vessels are not filled with blood, as where they belong to somebody else."""
    if len(inside) == 0 or len(around) == 0:
        return "is too coarse for the vessels: none of its voxels lies within; give a finer CT."
    share = float(np.mean((inside > _LEAST) & (inside < _MOST)))
    lowest, middle, highest = np.percentile(inside, (10, 50, 90))
    uneven = middle < _CONTRAST and highest - lowest > _NATIVE_SPREAD
    stands_out = float(inside.mean() - around.mean())
    if share >= _BLOOD_SHARE and not uneven and stands_out >= _STANDS_OUT:
        return None
    return (
        f"is another patient's CT: the vessels would hold {lowest:.0f} to {highest:.0f} Hounsfield units (the middle "
        f"80 % of their voxels), {stands_out:.0f} more than what lies around them; give the CT that the labels were "
        "drawn on."
    )


def _indices(places: Array, to_index: Array) -> Array:
    return np.asarray(places @ to_index[:3, :3].T + to_index[:3, 3])


def _sampled(values: NDArray[np.int16], at: Array) -> Array:
    """The values nearest to indices (n, 3), those outside the CT left out."""
    nearest = np.rint(at).astype(int)
    nearest = nearest[((nearest >= 0) & (nearest < values.shape)).all(axis=1)]
    return values[tuple(nearest.T)].astype(np.float64)


def _standing_out(values: NDArray[np.int16], places: tuple[Array, Array], to_index: Array, shift: Array) -> float:
    """Hounsfield units by which a lumen that is moved exceeds what lies around it; -inf where too much is outside."""
    means = []
    for part, least in zip(places, (_STILL_INSIDE, 0.0), strict=True):
        at = _indices(part + shift, to_index)
        within = np.logical_and.reduce([(x >= 0) & (x <= n - 1) for x, n in zip(at.T, values.shape, strict=True)])
        if not within.any() or within.mean() < least:
            return -np.inf
        means.append(float(map_coordinates(values, at[within].T, order=1, output=np.float64).mean()))
    return means[0] - means[1]


def _best_shift(
    values: NDArray[np.int16], places: tuple[Array, Array], to_index: Array, excess: float
) -> tuple[Array, float]:
    """Where the lumen stands out most, (3,) m, by a search over ever smaller steps, and by how much."""

    @cache
    def outcome(*by: float) -> float:
        return _standing_out(values, places, to_index, np.array(by))

    shift, most = np.zeros(3), excess
    for step in _STEPS:
        better = True
        while better and np.linalg.norm(shift) < _MOST_SHIFT:
            candidates = [shift + step * np.array(way) for way in itertools.product((-1, 0, 1), repeat=3) if any(way)]
            outcomes = [outcome(*one.tolist()) for one in candidates]
            better = max(outcomes) > most
            if better:
                shift, most = candidates[int(np.argmax(outcomes))], max(outcomes)
    return shift, most


def _in_words(shift: Array) -> str:
    """A displacement (3,) m in the patient's axes as text, the greatest part first."""
    sides = (("right of", "left of"), ("in front of", "behind"), ("below", "above"))
    parts = [(abs(value), sides[axis][int(value > 0)]) for axis, value in enumerate(shift) if abs(value) >= 1e-3]
    return " and ".join(f"{1e3 * size:.0f} mm {side}" for size, side in sorted(parts, reverse=True))
