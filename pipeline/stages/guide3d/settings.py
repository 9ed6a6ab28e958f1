"""Settings of the stage guide3d: a data set of one's own, or how one is generated; and how wires are reconstructed."""

from __future__ import annotations

from dataclasses import field
from pathlib import Path
from typing import Annotated

from annotated_types import Ge, Le

from pipeline.anatomies.settings import TARGETS
from pipeline.settings import kinds
from pipeline.store.errors import ConfigurationError
from pipeline.store.provenance import hash_file, hash_value

FEWEST_IMAGES = 8  # a pair of each wire, with and without fluid
FILLINGS = ("fluid", "contrast")
_ANNOTATIONS = tuple(f"{folder}{name}" for folder in ("", "*/", "*/*/") for name in ("raw.json", "*.xml"))
# What is read of a data set, beside its images.
_READ = (".json", ".xml", ".txt", ".yaml", ".yml", ".npz", ".jpg")


@kinds.validated()
class Guide3dSettings:
    """Settings of the guide3d stage."""

    name: str = "guide3d"
    images: Annotated[int, Ge(FEWEST_IMAGES), Le(1_000_000)] = 7200  # to be generated, both cameras together
    pairs: kinds.Count = 3  # of an acquisition, at most
    phantoms: kinds.SomeFolderNames = field(default_factory=lambda: ["type_1"])
    targets: kinds.SomeFolderNames = field(default_factory=lambda: list(TARGETS))
    steps: kinds.Count = 4  # of 0.1 s from one pair to the next
    image_size_px: Annotated[int, Ge(64), Le(4_096)] = 1024
    distorted: bool = False  # images and annotations as the detectors show them
    annotation_noise_px: kinds.NoisePixels = 0.0  # of a click; 0: exact annotations
    filling: Annotated[str, kinds.one_of(*FILLINGS)] = "fluid"  # what the lumen holds where it is filled, or contrast
    validation_noise_px: kinds.NoisePixels = 1.0  # of the clicks in the second part of the simulated validation
    compared: kinds.Count = 300  # pairs that are also reconstructed in the thesis's way, and from clicks
    # processes beside each other; 0: one a core
    workers: kinds.Processes = field(default=0, metadata=kinds.NO_EFFECT_ON_RESULTS)
    # its content counts, not its place
    root: kinds.PathText | None = field(default=None, metadata=kinds.NO_EFFECT_ON_RESULTS)
    image_root: kinds.PathText | None = field(default=None, metadata=kinds.NO_EFFECT_ON_RESULTS)
    calibration: kinds.PathText | None = field(default=None, metadata=kinds.NO_EFFECT_ON_RESULTS)
    undistorted: bool | None = None
    root_sha256: str | None = None  # filled in

    def __post_init__(self) -> None:
        """Checks that the data set of one's own is there, and that images make pairs."""
        self.root_sha256 = None
        if self.root is not None:
            for key in ("root", "images", "calibration"):
                path = self.image_root if key == "images" else getattr(self, key)
                if path is not None and not Path(path).exists():
                    raise ConfigurationError(f"guide3d.{key}={path} is missing: give the folder of a data set")
            _require_annotation(Path(self.root))
            self.root_sha256 = _content(self.root, self.image_root, self.calibration)
        elif self.image_root is not None or self.calibration is not None or self.undistorted is not None:
            raise ConfigurationError(
                "guide3d.images, guide3d.calibration and guide3d.undistorted belong to a data set of your own: give "
                "guide3d.root=PATH too"
            )
        if self.images % 2:
            raise ConfigurationError(f"stage.images must be even, got {self.images}")


def _require_annotation(root: Path) -> None:
    """Refuses a folder that is no data set before all that lies below it is read, which may be a whole disk."""
    if root.is_dir() and not any(next(root.glob(pattern), None) for pattern in _ANNOTATIONS):
        raise ConfigurationError(
            f"guide3d.root={root} holds no annotation: give the folder with raw.json or with an export of CVAT (*.xml)"
        )


def _content(*places: str | None) -> str:
    """Hash over annotations and calibration; images count by their names and sizes."""
    folders = [Path(place) for place in places if place is not None]
    files = sorted({file for folder in folders for file in ([folder] if folder.is_file() else folder.rglob("*"))})
    read = [hash_file(file) for file in files if file.is_file() and file.suffix.lower() in _READ]
    pictures = [file for file in files if file.suffix.lower() == ".png"]
    images = sorted((file.name, file.stat().st_size if file.is_file() else 0) for file in pictures)
    return hash_value({"read": read, "images": images})
