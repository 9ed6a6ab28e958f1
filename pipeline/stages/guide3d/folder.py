"""The folder of the stage guide3d: where the data set lies, generated or one's own, as later stages read it."""

from __future__ import annotations

import logging
from dataclasses import asdict, dataclass
from pathlib import Path

from guide3d.calibration.folder import cameras_in, distortions_of
from guide3d.dataset.annotation_files import DETECTOR
from guide3d.dataset.dataset import Dataset
from guide3d.dataset.true_curves import VIEWS
from guide3d.geometry.camera import write_opencv_yaml
from guide3d.reconstruction.view_checks import swapped_in, undistorted_or_raw_in
from pipeline.stages.guide3d.settings import Guide3dSettings
from pipeline.store.atomic_files import read_json, write_json
from pipeline.store.errors import StageError

SOURCE, RECONSTRUCTIONS = "source.json", "sphere.json"


@dataclass(frozen=True)
class Source:
    """Where a data set lies; paths are relative to the stage's folder, or absolute."""

    root: str
    images: str | None = None  # folder of its images, where they lie elsewhere
    calibration: str | None = None  # folder of its cameras, where they lie elsewhere
    # whether its annotations are undistorted, where somebody said so or the residuals did
    undistorted: bool | None = None

    def write(self, folder: Path) -> None:
        write_json(folder / SOURCE, asdict(self))

    def place(self, folder: Path, name: str) -> Path | None:
        """Where "images", "calibration" or "curves" in space lie, if not with the data set."""
        if name == "curves":
            return folder / RECONSTRUCTIONS if (folder / RECONSTRUCTIONS).exists() else None
        path = getattr(self, name)
        return None if path is None else folder / path

    def open(self, folder: Path) -> Dataset:
        try:
            return Dataset.open(
                folder / self.root,
                images=self.place(folder, "images"),
                calibration=self.place(folder, "calibration"),
                curves=self.place(folder, "curves"),
                undistorted=self.undistorted,
            )
        except (OSError, ValueError) as error:
            raise StageError(str(error)) from error


def open_dataset(folder: Path) -> Dataset:
    """The data set in the stage guide3d's folder, generated or one's own, with `reconstruction_mm` of its frames."""
    return read_source(folder).open(folder)


def read_source(folder: Path) -> Source:
    """Where the data set of a finished stage guide3d lies, from its folder ``runs/<name>/guide3d``."""
    path = folder / SOURCE
    if not path.is_file():
        raise StageError(f"{folder} holds no data set: run stage=guide3d again")
    return Source(**read_json(path))


CALIBRATION = "calibration"

_LOGGER = logging.getLogger(__name__)


def own_source(settings: Guide3dSettings, folder: Path) -> Source:
    """Readies a data set of one's own for the stages: nothing is written into it.

    The stage's folder gets the cameras, and the maps of the distortion: those that lie with the cameras, or new ones of
    the X-ray images of perforated sheets there (``*undistort*16710*.jpg``). Where nobody says whether the annotation is
    undistorted, and there are maps, the epipolar residuals decide.
    """
    assert settings.root is not None
    root = Path(settings.root).resolve()
    images = None if settings.image_root is None else str(Path(settings.image_root).resolve())
    beside = Path(settings.calibration) if settings.calibration else (root if root.is_dir() else root.parent)
    try:
        cameras, maps = cameras_in(beside), distortions_of(beside)
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
    if undistorted is None and (verdict := undistorted_or_raw_in(data)) is not None:
        _LOGGER.log(logging.INFO if verdict.sure else logging.WARNING, "%s", verdict.sentence)
        undistorted = verdict.answer == "undistorted"
    verdict = swapped_in(data, undistorted)
    if verdict is not None and verdict.answer == "swapped" and verdict.sure:
        raise StageError(
            f"{verdict.sentence}: camera A (detector {DETECTOR['a']}) belongs to folders ending in -2, B to those in -1"
        )
    return Source(str(root), images, calibration, undistorted)
