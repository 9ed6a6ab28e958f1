"""The compiled part of guide3d, loaded once and checked against its sources."""

from __future__ import annotations

import ctypes
import functools
import hashlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

HOME = Path(__file__).parent


class ViewStruct(ctypes.Structure):
    """One view of a curve to be matched (struct View of matching.c)."""

    _fields_ = (
        ("count", ctypes.c_int),
        *((name, ctypes.c_void_p) for name in ("angle", "slope_squared", "rays", "source")),
    )


class WeightsStruct(ctypes.Structure):
    """Weights of a match (struct Weights of matching.c)."""

    _fields_ = tuple(
        (name, ctypes.c_double) for name in ("spacing", "match", "reach", "noise", "length", "uneven", "start")
    )


class ImageStruct(ctypes.Structure):
    """An annotated image (struct Image of fitting.c)."""

    _fields_ = (
        ("count", ctypes.c_int),
        *((name, ctypes.c_void_p) for name in ("P", "points", "along")),
        ("tip", ctypes.c_int),
        ("off", ctypes.c_void_p),
    )


class SplineStruct(ctypes.Structure):
    """A uniform cubic B-spline (struct Spline of fitting.c)."""

    _fields_ = (
        ("count", ctypes.c_int), ("pitch", ctypes.c_double), ("points", ctypes.c_void_p), ("band", ctypes.c_void_p),
    )  # fmt: skip


class PriorStruct(ctypes.Structure):
    """What is known of a wire and its annotation beforehand (struct Prior of fitting.c)."""

    _fields_ = (
        *((name, ctypes.c_double) for name in ("noise", "least_noise")),
        ("estimate", ctypes.c_int),
        *((name, ctypes.c_double) for name in ("outlier", "bending", "bend", "changing", "change", "speed")),
        ("iterations", ctypes.c_int),
        ("freedom", ctypes.c_double),
    )


def sources_digest(folder: Path) -> str | None:
    """Digest of a folder's C sources, None where there are none (installed packages); setup.py computes the same."""
    paths = sorted(folder.glob("*.c"))
    if not paths:
        return None
    digest = hashlib.sha256()
    for path in paths:
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


@functools.cache
def library() -> ctypes.CDLL:
    """Loads the native code; its calls release the interpreter's lock.

    Raises:
        ImportError: it was not built, or is older than its sources.
    """
    libraries = [*sorted(HOME.glob("_native*.so")), *sorted(HOME.glob("_native*.pyd"))]
    if not libraries:
        raise ImportError(
            "guide3d's native code is not built: install a C compiler (Debian: apt install gcc libc6-dev), "
            "then run 'pip install ./packages/guide3d'"
        )
    native = ctypes.CDLL(str(libraries[0]))
    native.guide3d_sources.restype = ctypes.c_char_p
    if sources_digest(HOME / "native") not in (None, native.guide3d_sources().decode()):
        raise ImportError("guide3d's native code is older than its sources: run 'make setup', or install guide3d again")
    return native


def address(array: NDArray[np.generic]) -> int:
    """Address of the first element of a C-contiguous array that must outlive its use."""
    assert array.flags.c_contiguous
    return array.ctypes.data
