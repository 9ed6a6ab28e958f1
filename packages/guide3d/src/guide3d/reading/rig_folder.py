"""Cameras and distortions of a folder of calibration files, which may hold several sets, one a day."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from guide3d.calibration.folder import distortions_in, distortions_of_sheets
from guide3d.dataset.annotation_files import DETECTOR
from guide3d.geometry.camera import Camera, read_camera, read_opencv_yaml
from guide3d.geometry.distortion import Distortion

_ENDINGS = (".txt", ".yaml", ".yml")


@dataclass(frozen=True, eq=False)
class Rig:
    """Two cameras that were calibrated together.

    name: that of their files, with a star for the detector
    cameras: A (detector 16710) and B (16709)
    """

    name: str
    cameras: tuple[Camera, Camera]


def rigs_in(folder: Path) -> list[Rig]:
    """Reads all pairs of cameras of a folder, or of its sub-folder "calibration".

    Args:
        folder: with *16710*.txt and *16709*.txt (world unit cm), or .yaml, of the same name otherwise; or
            camera_a.yaml and camera_b.yaml.

    Returns:
        At least one rig, by name.

    Raises:
        FileNotFoundError: no such folder, or one without a pair of cameras.
        ValueError: a file that cannot be understood.
    """
    if not folder.is_dir():
        raise FileNotFoundError(f"{folder} is missing: expected a folder with camera files")
    for place in (folder / "calibration", folder):
        plain = {view: place / f"camera_{view}.yaml" for view in DETECTOR}
        if all(file.is_file() for file in plain.values()):
            return [Rig("camera_*.yaml", (_camera(plain["a"]), _camera(plain["b"])))]
        sets: dict[str, dict[str, Path]] = {}
        for view, detector in DETECTOR.items():
            for file in sorted(place.glob(f"*{detector}*")):
                if file.suffix in _ENDINGS:
                    sets.setdefault(file.name.replace(detector, "*"), {})[view] = file
        whole = {name: files for name, files in sets.items() if len(files) == len(DETECTOR)}
        if whole:
            return [Rig(name, (_camera(files["a"]), _camera(files["b"]))) for name, files in sorted(whole.items())]
        if sets:
            name, files = next(iter(sets.items()))
            missing = next(detector for view, detector in DETECTOR.items() if view not in files)
            raise FileNotFoundError(f"{place}: {name.replace('*', missing)}, the other camera's file, is missing")
    wanted = " and ".join(f"*{detector}*.txt" for detector in DETECTOR.values())
    raise FileNotFoundError(f"{folder} holds no cameras: expected {wanted}, or .yaml")


def distortions_of(folder: Path) -> tuple[Distortion, Distortion] | None:
    """Reads both detectors' distortion maps of a folder, or measures them by its X-rays of perforated sheets.

    Returns:
        Those of cameras A and B; None where there is neither.

    Raises:
        ValueError: a map or a sheet that cannot be read.
    """
    return distortions_in(folder) or distortions_of_sheets(folder)


def _camera(file: Path) -> Camera:
    return read_camera(file) if file.suffix == ".txt" else read_opencv_yaml(file)
