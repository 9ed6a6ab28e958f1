"""A data set of one's own: its cameras, its detectors' distortion, and whether its annotation is undistorted."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
from PIL import Image

from guide3d.calibration.folder import cameras_in, distortions_in
from guide3d.calibration.perforated_sheet import find_holes
from guide3d.dataset.annotation_files import DETECTOR
from guide3d.dataset.dataset import Dataset
from guide3d.dataset.true_curves import VIEWS
from guide3d.geometry.camera import write_opencv_yaml
from guide3d.geometry.distortion import Distortion
from guide3d.reconstruction.view_checks import swapped_cameras, undistorted_or_raw
from pipeline.stages.guide3d.folder import Source
from pipeline.stages.guide3d.settings import Guide3dSettings
from pipeline.store.errors import StageError

CALIBRATION = "calibration"
_SHEETS = (".jpg", ".jpeg", ".png", ".tif", ".tiff")
_PAIRS_ASKED = 60  # pairs whose epipolar residuals say whether the annotation is undistorted

_LOGGER = logging.getLogger(__name__)


def own_source(settings: Guide3dSettings, folder: Path) -> Source:
    """Readies a data set of one's own for the stages: nothing is written into it.

    The stage's folder gets the cameras, and the maps of the distortion: those that lie with the cameras, or new ones of
    the X-ray images of perforated sheets there (``*undistort*16710*.jpg``). Where nobody says whether the annotation is
    undistorted, and there are maps, the epipolar residuals decide.

    Args:
        settings: of the stage.
        folder: of the stage.

    Returns:
        Where everything lies.

    Raises:
        StageError: the data set or its calibration cannot be used.
    """
    assert settings.root is not None
    root = Path(settings.root).resolve()
    images = None if settings.image_root is None else str(Path(settings.image_root).resolve())
    beside = Path(settings.calibration) if settings.calibration else (root if root.is_dir() else root.parent)
    try:
        cameras, maps = cameras_in(beside), distortions_in(beside) or _from_sheets(beside)
        if cameras is not None:
            for camera, view in zip(cameras, VIEWS, strict=True):
                write_opencv_yaml(camera, folder / CALIBRATION / f"camera_{DETECTOR[view]}.yaml")
            for distortion, view in zip(maps or (), VIEWS, strict=False):
                distortion.save(folder / CALIBRATION / f"distortion_{DETECTOR[view]}.npz")
        calibration = CALIBRATION if cameras is not None else None
        data = Dataset.open(
            root, images=images, calibration=folder / CALIBRATION if calibration else None,
            undistorted=settings.undistorted,
        )  # fmt: skip
    except (OSError, ValueError) as error:
        raise StageError(str(error)) from error
    undistorted = data.undistorted
    if undistorted is None and cameras is not None and maps is not None:
        undistorted = _ask_residuals(data)
    if cameras is not None:
        _refuse_swapped(data, undistorted)
    return Source(str(root), images, calibration, undistorted)


def _from_sheets(beside: Path) -> tuple[Distortion, Distortion] | None:
    files: dict[str, Path] = {}
    for view, detector in DETECTOR.items():
        for place in (beside / CALIBRATION, beside):
            found = [f for f in sorted(place.glob(f"*ndistort*{detector}*")) if f.suffix.lower() in _SHEETS]
            files.setdefault(view, found[0]) if found else None
    if len(files) < len(DETECTOR):
        return None
    # cameras in text files come from XMALab, whose undistorted frame hangs on the box around the holes
    texts = [file for place in (beside / CALIBRATION, beside) for file in place.glob(f"*{DETECTOR['a']}*.txt")]
    frame = "bounding box" if texts else "least squares"
    a, b = (
        Distortion.from_holes(find_holes(np.asarray(Image.open(files[view]).convert("L"))), frame=frame)
        for view in VIEWS
    )
    return a, b


def _ask_residuals(data: Dataset) -> bool:
    """Whether the annotation is undistorted; says how it is told."""
    assert data.camera_a is not None
    assert data.camera_b is not None
    assert data.distortions is not None
    a, b = data.distortions
    verdict = undistorted_or_raw(data.camera_a, data.camera_b, _pairs(data), a.undistort_points, b.undistort_points)
    _LOGGER.log(logging.INFO if verdict.sure else logging.WARNING, "%s", verdict.sentence)
    return verdict.answer == "undistorted"


def _refuse_swapped(data: Dataset, undistorted: bool | None) -> None:
    assert data.camera_a is not None
    assert data.camera_b is not None
    pairs = _pairs(data)
    if undistorted is False and data.distortions is not None:
        a, b = data.distortions
        pairs = [(a.undistort_points(one), b.undistort_points(other)) for one, other in pairs]
    verdict = swapped_cameras(data.camera_a, data.camera_b, pairs)
    if verdict.answer == "swapped" and verdict.sure:
        raise StageError(
            f"{verdict.sentence}: camera A (detector {DETECTOR['a']}) belongs to folders ending in -2, B to those in -1"
        )


def _pairs(data: Dataset) -> list[tuple[np.ndarray, np.ndarray]]:
    """Annotations spread over the data set."""
    chosen = np.unique(np.linspace(0, len(data) - 1, _PAIRS_ASKED).astype(int))
    return [(data.frames[i].polyline("a"), data.frames[i].polyline("b")) for i in chosen]
