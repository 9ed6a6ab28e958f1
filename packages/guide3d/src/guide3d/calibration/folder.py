"""A folder of calibration: both cameras' files, and the maps of their distortion or the X-rays of perforated sheets."""

from __future__ import annotations

from pathlib import Path

from guide3d.calibration.perforated_sheet import find_holes
from guide3d.dataset.annotation_files import DETECTOR
from guide3d.geometry.camera import Camera, read_camera, read_opencv_yaml
from guide3d.geometry.distortion import Distortion
from guide3d.image_file import eight_bits, read_grey_levels

_CAMERA_ENDINGS = ("txt", "yaml", "yml")
_SHEET_ENDINGS = (".jpg", ".jpeg", ".png", ".tif", ".tiff")


def cameras_in(folder: Path) -> tuple[Camera, Camera] | None:
    """Cameras A (detector 16710) and B (16709) of a folder, or of its sub-folder "calibration".

    Args:
        folder: with *16710*.txt and *16709*.txt (world unit cm), or .yaml; or with camera_a.* and camera_b.* of
            another rig, as `python -m guide3d.dicom` writes them.

    Returns:
        Both; None where there is neither.

    Raises:
        FileNotFoundError: only one of them is there, or no such folder.
        ValueError: several files of one detector, or one that cannot be understood.
    """
    if not folder.is_dir():
        raise FileNotFoundError(f"{folder} is missing: expected a folder with camera files")
    for place in (folder / "calibration", folder):
        files = {
            view: _only(place, detector, _CAMERA_ENDINGS) or _only(place, f"camera_{view}", _CAMERA_ENDINGS)
            for view, detector in DETECTOR.items()
        }
        found = {view: file for view, file in files.items() if file is not None}
        if len(found) == 1:
            ((view, file),) = found.items()
            missing = "b" if view == "a" else "a"
            wanted = f"*{DETECTOR[missing]}*" if DETECTOR[view] in file.name else f"camera_{missing}"
            raise FileNotFoundError(
                f"{place} holds {file.name} only: the file of camera {missing.upper()}, {wanted}.txt or .yaml, "
                "is missing"
            )
        if found:
            a, b = (
                read_camera(file) if file.suffix == ".txt" else read_opencv_yaml(file)
                for file in (found["a"], found["b"])
            )
            return a, b
    return None


def distortions_in(folder: Path) -> tuple[Distortion, Distortion] | None:
    """Maps of both detectors' distortion in a folder, or in its sub-folder "calibration"; None unless both are there.

    Raises:
        ValueError: several files *16710*.npz or *16709*.npz, or one that `Distortion.save` did not write.
    """
    for place in (folder / "calibration", folder):
        files = [_only(place, DETECTOR[view], ("npz",)) for view in ("a", "b")]
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
        images = (file for place in places for file in sorted(place.glob(f"*ndistort*{detector}*")))
        sheets += [file for file in images if file.suffix.lower() in _SHEET_ENDINGS][:1]
    if len(sheets) < len(DETECTOR):
        return None
    # cameras in text files come from XMALab, whose undistorted frame hangs on the box around the holes
    texts = [file for place in places for file in place.glob(f"*{DETECTOR['a']}*.txt")]
    frame = "bounding box" if texts else "least squares"
    a, b = (Distortion.from_holes(find_holes(eight_bits(read_grey_levels(file))), frame=frame) for file in sheets)
    return a, b


def _only(folder: Path, name: str, endings: tuple[str, ...]) -> Path | None:
    files = [file for ending in endings for file in sorted(folder.glob(f"*{name}*.{ending}"))]
    if len(files) > 1:
        names = ", ".join(file.name for file in files)
        what = f"detector {name}" if name in DETECTOR.values() else name
        raise ValueError(f"{folder} holds several files of {what} ({names}): keep the one that is meant")
    return files[0] if files else None
