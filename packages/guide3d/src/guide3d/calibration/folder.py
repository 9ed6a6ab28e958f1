"""A folder of calibration: both cameras' files, and the maps of their distortion or the X-rays of perforated sheets."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from guide3d.calibration.cube_files import read_grey
from guide3d.calibration.perforated_sheet import find_holes
from guide3d.dataset.annotation_files import DETECTOR
from guide3d.files import files_in
from guide3d.geometry.camera import Camera, read_camera, read_opencv_yaml
from guide3d.geometry.distortion import Distortion
from guide3d.geometry.triangulation import require_millimetres
from guide3d.image_file import PICTURES

_CAMERA_ENDINGS = ("txt", "yaml", "yml")


@dataclass(frozen=True, eq=False)
class Rig:
    """Two cameras that were calibrated together.

    name: that of their files, with a star for the detector
    cameras: A (detector 16710) and B (16709)
    """

    name: str
    cameras: tuple[Camera, Camera]


def cameras_in(folder: Path) -> tuple[Camera, Camera] | None:
    """Cameras A (detector 16710) and B (16709) of a folder that has one set of them, as `rigs_in` finds it.

    Returns:
        Both; None where there is neither.

    Raises:
        FileNotFoundError: only one of them is there, or no such folder.
        ValueError: several sets of cameras, or a file that cannot be understood.
    """
    files = _camera_files(folder)
    if len(files) > 1:
        names = ", ".join(name for name, _ in files)
        raise ValueError(f"{folder} holds several sets of cameras ({names}): keep the one that is meant")
    return _rig(*files[0]).cameras if files else None


def rigs_in(folder: Path) -> list[Rig]:
    """All sets of cameras of a folder, or of its sub-folder "calibration", by name.

    Args:
        folder: with *16710*.txt and *16709*.txt (world unit cm), or .yaml, several of the same name otherwise; or with
            camera_a.* and camera_b.* of another rig, as `python -m guide3d.dicom` writes them.

    Returns:
        At least one.

    Raises:
        FileNotFoundError: no such folder, no cameras in it, or only one of a set.
        ValueError: files that do not make sets, or one that cannot be understood.
    """
    files = _camera_files(folder)
    if not files:
        patterns = " and ".join(f"*{detector}*.txt" for detector in DETECTOR.values())
        raise FileNotFoundError(f"{folder} holds no cameras: expected {patterns}, or .yaml")
    return [_rig(*one) for one in files]


def distortions_in(folder: Path) -> tuple[Distortion, Distortion] | None:
    """Maps of both detectors' distortion in a folder, or in its sub-folder "calibration"; None unless both are there.

    Raises:
        ValueError: several files *16710*.npz or *16709*.npz, or one that `Distortion.save` did not write.
    """
    for place in (folder / "calibration", folder):
        files = [_only(place, detector) for detector in DETECTOR.values()]
        if files[0] is not None and files[1] is not None:
            return Distortion.load(files[0]), Distortion.load(files[1])
    return None


def distortions_of_sheets(folder: Path) -> tuple[Distortion, Distortion] | None:
    """Measures both detectors' distortion by the X-rays of perforated sheets in a folder, or in its "calibration".

    Args:
        folder: with *ndistort*16710* and *ndistort*16709* images.

    Returns:
        Those of cameras A and B; None unless both sheets are there.

    Raises:
        ValueError: an image shows no perforated sheet.
    """
    places = (folder / "calibration", folder)
    sheets: list[Path] = []
    for detector in DETECTOR.values():
        patterns = [f"*ndistort*{detector}*{ending}" for ending in PICTURES]
        sheets += [file for place in places for file in files_in(place, *patterns)][:1]
    if len(sheets) < len(DETECTOR):
        return None
    # cameras in text files come from XMALab, whose undistorted frame hangs on the box around the holes
    texts = [file for place in places for file in files_in(place, f"*{DETECTOR['a']}*.txt")]
    frame = "bounding box" if texts else "least squares"
    a, b = (Distortion.from_holes(find_holes(read_grey(file)), frame=frame) for file in sheets)
    return a, b


def distortions_of(folder: Path) -> tuple[Distortion, Distortion] | None:
    """Both detectors' distortion maps of a folder, or those measured by its X-rays of perforated sheets.

    Returns:
        Those of cameras A and B; None where there is neither.

    Raises:
        ValueError: a map or a sheet that cannot be read.
    """
    return distortions_in(folder) or distortions_of_sheets(folder)


def _rig(name: str, files: dict[str, Path]) -> Rig:
    a, b = (
        (read_camera if files[view].suffix.lower() == ".txt" else read_opencv_yaml)(files[view]) for view in DETECTOR
    )
    _check_distance(a, b, [files[view] for view in DETECTOR])
    return Rig(name, (a, b))


def _check_distance(a: Camera, b: Camera, files: list[Path]) -> None:
    """Refuses cameras of another unit than millimetres, with what their files say of it."""
    try:
        require_millimetres(a, b)
    except ValueError as error:
        unit = "a .txt file is read in cm" if files[0].suffix.lower() == ".txt" else "without world_unit it is mm"
        raise ValueError(
            f"{files[0]} and {files[1].name}: {error} ({unit}); write the cameras as .yaml with world_unit: mm, cm or m"
        ) from None


def _camera_files(folder: Path) -> list[tuple[str, dict[str, Path]]]:
    """Name and both files of each set of cameras, by name; none where there are no cameras."""
    if not folder.is_dir():
        raise FileNotFoundError(f"{folder} is missing: expected a folder with camera files")
    for place in (folder / "calibration", folder):
        for tag in ("{detector}", "camera_{view}"):
            sets: dict[str, dict[str, Path]] = {}
            for view, detector in DETECTOR.items():
                part = tag.format(detector=detector, view=view)
                for file in files_in(place, *(f"*{part}*.{ending}" for ending in _CAMERA_ENDINGS)):
                    sets.setdefault(re.sub(part, "*", file.name, flags=re.IGNORECASE), {})[view] = file
            whole = {name: files for name, files in sorted(sets.items()) if len(files) == len(DETECTOR)}
            if whole:
                return list(whole.items())
            if sets:
                return [_set_of(place, list(sets.values()), tag)]
    return []


def _set_of(place: Path, sets: list[dict[str, Path]], tag: str) -> tuple[str, dict[str, Path]]:
    """The only file of either view, whatever they are called."""
    by_view = {view: [files[view] for files in sets if view in files] for view in DETECTOR}
    for view, files in by_view.items():
        part = tag.format(detector=DETECTOR[view], view=view)
        if not files:
            other = next(file for them in by_view.values() for file in them)
            name = f"*{part}*" if part.isdigit() else part
            raise FileNotFoundError(
                f"{place} holds {other.name} only: the file of camera {view.upper()}, {name}.txt or .yaml, is missing"
            )
        if len(files) > 1:
            names = ", ".join(file.name for file in files)
            raise ValueError(f"{place} holds several files of *{part}* ({names}): keep the one that is meant")
    a, b = (files[0] for files in by_view.values())
    return f"{a.name}, {b.name}", {"a": a, "b": b}


def _only(folder: Path, detector: str) -> Path | None:
    files = files_in(folder, f"*{detector}*.npz")
    if len(files) > 1:
        names = ", ".join(file.name for file in files)
        raise ValueError(f"{folder} holds several files of detector {detector} ({names}): keep the one that is meant")
    return files[0] if files else None
