"""What a file of a surface holds, and the errors of its readers."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.vessel_names import is_other, vessel_name

MOST_BYTES = 1_000_000_000  # of a file: ten million faces in text, the wordiest kind
MOST_TRIANGLES = 10_000_000  # three times those of both sides of an aorta's wall at 0.3 mm
MOST_NODES = 5_000  # of a scene: twice the organs of a whole body
_SPACE = re.compile(rb"SPACE=(LPS|RAS)\b")  # 3D Slicer's comment
_HEAD = 1_000  # bytes in which it stands
_FEW, _SHOWN = 4, 40  # names in a note, and characters of each

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class SurfaceFile:
    """Triangles as a file has them, in its unit and frame."""

    vertices: Array  # (n, 3)
    faces: Indices  # (m, 3) indices of vertices, not checked
    space: str = ""  # "LPS" (x to the patient's left, y to the back, z up) or "RAS", where the file says so
    notes: tuple[str, ...] = ()  # what of the file was not as it should be


def space_of_comment(data: bytes) -> str:
    """The space that 3D Slicer's comment at the beginning of a file names; empty where there is none."""
    match = _SPACE.search(data[:_HEAD])
    return match.group(1).decode() if match else ""


def part_names(names: Iterable[bytes]) -> tuple[list[str], str]:
    """Names of the parts that a file parts its triangles into, where they tell vessels apart; else a note on them.

    Groups such as "wall" and "inlet" are of one lumen and tell nothing.
    """
    parts = list(dict.fromkeys(name.decode(errors="replace").strip() for name in names))
    if any(vessel_name(name) or (is_other(name) and "wall" not in name.lower()) for name in parts):
        return parts, ""
    listing = ", ".join(name[:_SHOWN] or "unnamed" for name in parts[:_FEW]) + (", …" if len(parts) > _FEW else "")
    return [], f"its {len(parts)} parts are taken together, no name is an artery's: {listing}" if len(parts) > 1 else ""


def rows_beyond(promised: int, held: int) -> tuple[str, ...]:
    """A note on rows behind those that the head of a text file promises; none where there are none.

    Raises:
        ValueError: there are less, or so many more that the head is wrong.
    """
    if not promised <= held <= 1.2 * promised:
        raise ValueError(f"it promises {promised} rows and holds {held}")
    return (f"{held - promised} rows behind those that it promises are left out",) if held > promised else ()


def numbers(text: str | bytes, kind: str) -> NDArray:
    """Numbers of a text, parted by white space, of one type of numpy.

    Raises:
        ValueError: something else stands among them.
    """
    text = text.strip()
    if not text:  # of which numpy makes one number, -1
        return np.zeros(0, kind)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", DeprecationWarning)  # numpy before 2.3 stops at what is no number
            return np.fromstring(text, dtype=kind, sep=" ")
    except (DeprecationWarning, ValueError):
        raise ValueError("something else than numbers stands among its numbers") from None


def triangles_of_cells(vertices: NDArray, ends: NDArray, *, strips: bool) -> Indices:
    """Triangles (m, 3) of polygons, divided into fans, or of strips of triangles.

    Args:
        vertices: (k,) indices of points, of one cell after the other.
        ends: where each cell ends among them.

    Raises:
        ValueError: the cells do not lie one after the other within the list, or are too many.
    """
    vertices, ends = vertices.astype(np.int64), ends.astype(np.int64)
    starts = np.concatenate([[0], ends[:-1]]) if len(ends) else ends
    counts = ends - starts
    if len(ends) and (counts.min() < 0 or ends[-1] > len(vertices)):
        raise ValueError("its polygons do not lie within their list of points")
    of_cell = np.maximum(counts - 2, 0)
    total = int(of_cell.sum())
    if total > MOST_TRIANGLES:
        raise ValueError(f"it has {total} triangles, at most {MOST_TRIANGLES} are read")
    start = np.repeat(starts, of_cell)
    nth = np.arange(total) - np.repeat(np.cumsum(of_cell) - of_cell, of_cell)
    first = start + nth if strips else start
    return vertices[np.stack([first, start + nth + 1, start + nth + 2], axis=1)]
