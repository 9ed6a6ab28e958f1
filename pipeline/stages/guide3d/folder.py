"""The folder of the stage guide3d, as later stages read it: where the data set lies, and its curves in space."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

from guide3d.dataset.dataset import Dataset
from pipeline.store.atomic_files import write_json
from pipeline.store.errors import StageError

SOURCE, RECONSTRUCTIONS = "source.json", "sphere.json"


@dataclass(frozen=True)
class Source:
    """Where a data set lies; paths are relative to the stage's folder, or absolute.

    Attributes:
        images: folder of its images, where they lie elsewhere.
        calibration: folder of its cameras, where they lie elsewhere.
        undistorted: whether its annotations are undistorted, where somebody said so or the residuals did.
    """

    root: str
    images: str | None = None
    calibration: str | None = None
    undistorted: bool | None = None

    def write(self, folder: Path) -> None:
        """Writes source.json into the stage's folder."""
        write_json(folder / SOURCE, asdict(self))

    def place(self, folder: Path, name: str) -> Path | None:
        """Where "images", "calibration" or "curves" in space lie, if not with the data set."""
        if name == "curves":
            return folder / RECONSTRUCTIONS if (folder / RECONSTRUCTIONS).exists() else None
        path = getattr(self, name)
        return None if path is None else folder / path

    def open(self, folder: Path) -> Dataset:
        """Opens the data set.

        Raises:
            StageError: it is not there or cannot be used.
        """
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
    """The data set that the stage guide3d left in its folder ``runs/<name>/guide3d``, generated or the user's own.

    Returns:
        The data set; frames that were reconstructed have their `reconstruction_mm`.

    Raises:
        StageError: the stage left none, or it has gone.
    """
    return read_source(folder).open(folder)


def read_source(folder: Path) -> Source:
    """Where the data set of a finished stage guide3d lies, from its folder ``runs/<name>/guide3d``.

    Raises:
        StageError: the stage left none.
    """
    path = folder / SOURCE
    if not path.is_file():
        raise StageError(f"{folder} holds no data set: run stage=guide3d again")
    return Source(**json.loads(path.read_text(encoding="utf-8")))
