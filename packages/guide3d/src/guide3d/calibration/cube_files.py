"""The files of a calibration: images, bead coordinates and marked beads, with errors that name the file."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from guide3d.geometry.camera import UNITS_MM
from guide3d.image_file import ImageError, read_grey_levels

_IMAGES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")
_SHEET = "undistort"


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
    """Sort the files of a folder by their names.

    Args:
        folder: With undistort_<detector>.*, <pose>_<detector>.*, framespec_cm.csv (or _mm) and, if marked, a .ref file.

    Raises:
        FileNotFoundError: The folder, the bead file, a sheet or all cubes are missing.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise FileNotFoundError(f"folder {folder} is missing: expected one with sheet and cube images and a bead file")
    images = sorted(path for path in folder.iterdir() if path.suffix.lower() in _IMAGES and "_" in path.stem)
    named = {tuple(path.stem.rsplit("_", 1)): path for path in images}
    sheets = {detector: path for (name, detector), path in named.items() if name == _SHEET}
    if not sheets:
        raise FileNotFoundError(
            f"{folder}: expected an image of a perforated sheet, undistort_<detector>.png, found none"
        )
    beads = sorted(path for path in folder.glob("framespec_*.csv"))
    if not beads:
        raise FileNotFoundError(
            f"{folder}: expected a bead file, framespec_cm.csv (x, y, z with a header row), found none"
        )
    cubes = {(name, detector): path for (name, detector), path in named.items() if name != _SHEET}
    for (_, detector), path in cubes.items():
        if detector not in sheets:
            raise FileNotFoundError(
                f"{path}: expected a sheet image undistort_{detector}.png beside it, found sheets of detectors "
                f"{', '.join(sorted(sheets))}"
            )
    if not cubes:
        raise FileNotFoundError(f"{folder}: expected images of the bead cube, <pose>_<detector>.png, found none")
    references = sorted(folder.glob("*.ref"))
    return CubeFiles(sheets, cubes, beads[0], references[0] if references else None)


def read_grey(path: str | Path) -> np.ndarray:
    """Read a PNG, JPEG, TIFF or BMP of 8 or 16 bits, grey or colour, as grey values (h, w), float.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The file is damaged or no image.
    """
    path = Path(path)
    if not path.is_file():
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
        path: Comma-separated x, y, z with a header row; the unit stands at the end of the name (framespec_cm.csv).

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: Malformed rows or a unit that is not known.
    """
    path = Path(path)
    unit = path.stem.rsplit("_", 1)[-1]
    if unit not in UNITS_MM:
        raise ValueError(f"{path}: expected a name that ends in its unit, _mm, _cm or _m, found {path.name}")
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except FileNotFoundError:
        raise FileNotFoundError(f"bead file {path} is missing") from None
    except UnicodeDecodeError:
        raise ValueError(f"{path}: expected a text file of bead coordinates, found binary data") from None
    rows = []
    for number, line in enumerate(lines[1:], 2):  # the first row is the header
        if not line.strip():
            continue
        try:
            row = [float(cell) for cell in line.split(",")]
        except ValueError:
            row = []
        if len(row) != 3 or not np.isfinite(row).all():
            raise ValueError(f"{path}, line {number}: expected three numbers x,y,z, found {line.strip()!r}")
        rows.append(row)
    if len(rows) < 8:
        raise ValueError(f"{path}: expected the coordinates of 8 beads or more below the header, found {len(rows)}")
    return np.array(rows) * UNITS_MM[unit]


def read_references(path: str | Path, beads: int) -> dict[str, int]:
    """Read which beads are marked: bead number counted from 0, by mark.

    Args:
        path: Lines "<bead counted from 1> <mark>", as XMALab writes them.

    Raises:
        ValueError: A malformed line, or a bead that does not exist.
    """
    path = Path(path)
    marked = {}
    for number, line in enumerate(path.read_text(encoding="utf-8", errors="replace").splitlines(), 1):
        if not line.strip():
            continue
        found = re.fullmatch(r"\s*(\d+)\s+(\S+)\s*", line)
        if found is None or not 1 <= int(found[1]) <= beads:
            raise ValueError(
                f"{path}, line {number}: expected a bead from 1 to {beads} and its mark, found {line.strip()!r}"
            )
        marked[found[2]] = int(found[1]) - 1
    return marked
