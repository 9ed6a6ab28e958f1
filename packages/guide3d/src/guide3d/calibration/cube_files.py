"""The files of a calibration: images, bead coordinates and marked beads, with errors that name the file."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from guide3d.files import cells_of, files_in, numbers_in, read_text
from guide3d.geometry.camera import UNITS_MM
from guide3d.image_file import PICTURES, ImageError, read_grey_levels

_SHEET = "undistort"
_AXES = "xyz"
_FARTHEST_MM = 10_000.0  # of a bead from the frame's origin


@dataclass(frozen=True)
class CubeFiles:
    """What a folder holds.

    sheets: by detector, the image of the perforated sheet
    cubes: by (pose, detector), the image of the cube
    """

    sheets: dict[str, Path]
    cubes: dict[tuple[str, str], Path]
    beads: Path
    references: Path | None


def find_files(folder: str | Path) -> CubeFiles:
    """Sort the files of a folder by their names; capitals in "undistort", "framespec" and endings do not matter.

    Args:
        folder: With undistort_<detector>.*, <pose>_<detector>.*, framespec_cm.csv (or _mm) and, if marked, a .ref file.

    Raises:
        FileNotFoundError: The folder, the bead file, a sheet or all cubes are missing.
        ValueError: Two files are the same sheet, the same view of a cube, or both a bead or reference file.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise FileNotFoundError(f"folder {folder} is missing: expected one with sheet and cube images and a bead file")
    named: dict[tuple[str, str], list[Path]] = {}
    for path in files_in(folder, *(f"*_*{ending}" for ending in PICTURES)):
        name, detector = path.stem.rsplit("_", 1)
        named.setdefault((_SHEET if name.lower() == _SHEET else name, detector), []).append(path)
    images = {key: _only(paths) for key, paths in named.items()}
    sheets = {detector: path for (name, detector), path in images.items() if name == _SHEET}
    if not sheets:
        raise FileNotFoundError(
            f"{folder}: expected an image of a perforated sheet, undistort_<detector>.png, found none"
        )
    beads = files_in(folder, "framespec_*.csv")
    if not beads:
        raise FileNotFoundError(
            f"{folder}: expected a bead file, framespec_cm.csv (x, y, z with a header row), found none"
        )
    cubes = {(name, detector): path for (name, detector), path in images.items() if name != _SHEET}
    for (_, detector), path in cubes.items():
        if detector not in sheets:
            raise FileNotFoundError(
                f"{path}: expected a sheet image undistort_{detector}.png beside it, found sheets of detectors "
                f"{', '.join(sorted(sheets))}"
            )
    if not cubes:
        raise FileNotFoundError(f"{folder}: expected images of the bead cube, <pose>_<detector>.png, found none")
    references = files_in(folder, "*.ref")
    return CubeFiles(sheets, cubes, _only(beads), _only(references) if references else None)


def read_grey(path: str | Path) -> np.ndarray:
    """Read a PNG, JPEG, TIFF or BMP of 8 or 16 bits, grey or colour, as grey values (h, w), float.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The file is damaged or no image.
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"image {path} is missing")
    try:
        values = read_grey_levels(path).astype(float)
    except ImageError as error:
        raise ValueError(f"{path}: expected a readable image, found a damaged or foreign file ({error})") from None
    if np.ptp(values) == 0:
        raise ValueError(f"{path}: expected a grey X-ray image, found one value everywhere")
    return values


def read_beads(path: str | Path) -> np.ndarray:
    """Read bead coordinates (n, 3) mm.

    Args:
        path: x, y, z in a row, in any layout that `guide3d.files` reads, with or without a header row; the unit
            stands at the end of the name (framespec_cm.csv).

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: Malformed rows, a bead that is there twice, or a unit that is not known or not that of the header.
    """
    path = Path(path)
    unit = path.stem.rsplit("_", 1)[-1].lower()
    if unit not in UNITS_MM:
        raise ValueError(f"{path}: expected a name that ends in its unit, _mm, _cm or _m, found {path.name}")
    rows: list[list[float]] = []
    order = list(_AXES)
    for number, line in enumerate(read_text(path, "bead file").splitlines(), 1):
        cells = cells_of(line)
        if not cells:
            continue
        if not rows and not any(map(numbers_in, cells)):
            order = [cell.lower()[:1] for cell in cells]  # a header: "x", "X (cm)"
            named = {
                match[1].lower() for cell in cells if (match := re.fullmatch(r"[^(\[_]*[(\[_ ](\w+)[)\]]?\s*", cell))
            }
            if named & UNITS_MM.keys() and named != {unit}:
                raise ValueError(
                    f"{path}, line {number}: the header is in {', '.join(sorted(named))}, the file's name says {unit}: "
                    "make both the same"
                )
            continue
        row = numbers_in(line) or []
        if len(row) != 3 or not np.isfinite(row).all():
            raise ValueError(f"{path}, line {number}: expected three numbers x,y,z, found {line.strip()!r}")
        if np.abs(row).max() * UNITS_MM[unit] > _FARTHEST_MM:
            raise ValueError(
                f"{path}, line {number}: expected at most {_FARTHEST_MM:g} mm, found {line.strip()!r} {unit}"
            )
        if row in rows:
            raise ValueError(f"{path}, line {number}: the bead at {line.strip()!r} is there twice: leave one out")
        rows.append(row)
    if len(rows) < 8:
        raise ValueError(f"{path}: expected the coordinates of 8 beads or more, found {len(rows)}")
    if set(order) == set(_AXES):
        rows = [[row[order.index(axis)] for axis in _AXES] for row in rows]
    return np.array(rows) * UNITS_MM[unit]


def read_references(path: str | Path, beads: int) -> dict[str, int]:
    """Read which beads are marked: bead number counted from 0, by mark.

    Args:
        path: Lines "<bead counted from 1> <mark>", as XMALab writes them.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: A malformed line, a bead that does not exist, or a bead or a mark that is there twice.
    """
    path = Path(path)
    marked: dict[str, int] = {}
    for number, line in enumerate(read_text(path, "reference file").splitlines(), 1):
        cells = cells_of(line)
        if not cells:
            continue
        if len(cells) != 2 or not re.fullmatch(r"[0-9]{1,9}", cells[0]) or not 1 <= int(cells[0]) <= beads:
            raise ValueError(
                f"{path}, line {number}: expected a bead from 1 to {beads} and its mark, found {line.strip()!r}"
            )
        mark, bead = cells[1].lower(), int(cells[0]) - 1
        if mark in marked or bead in marked.values():
            raise ValueError(f"{path}, line {number}: expected one bead for each mark, found {line.strip()!r} again")
        marked[mark] = bead
    return marked


def _only(paths: list[Path]) -> Path:
    if len(paths) > 1:
        names = ", ".join(path.name for path in paths)
        raise ValueError(f"{paths[0].parent} holds several files of one kind ({names}): keep the one that is meant")
    return paths[0]
