"""Settings of the stage guide3d: a data set of one's own, or how one is generated; and how wires are reconstructed."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pipeline.errors import ConfigurationError
from pipeline.provenance import hash_file, hash_value
from pipeline.setting_checks import NO_EFFECT_ON_RESULTS, require_choice, require_positive, require_unique

FEWEST_IMAGES = 8  # a pair of each wire, with and without fluid
FILLINGS = ("fluid", "contrast")
# What is read of a data set, beside its images.
_READ = (".json", ".xml", ".txt", ".yaml", ".yml", ".npz", ".jpg")


@dataclass
class Guide3dSource:
    """A data set of one's own: the top-level keys ``guide3d.root=PATH`` and its like."""

    root: str | None = None  # folder in the public layout, or its raw.json
    images: str | None = None  # folder of the images, where they lie elsewhere
    calibration: str | None = None  # folder of the camera files (and perforated sheets), where they lie elsewhere
    undistorted: bool | None = None  # whether annotations are undistorted; found out by epipolar residuals if left out


@dataclass
class Guide3dSettings:
    """Settings of the guide3d stage."""

    name: str = "guide3d"
    images: int = 2400  # to be generated, both cameras together
    pairs: int = 13  # of an acquisition, at most
    phantoms: list[str] = field(default_factory=lambda: ["type_1"])
    targets: list[str] = field(default_factory=lambda: ["bca", "lcca", "lsa"])
    steps: int = 4  # of 0.1 s from one pair to the next
    image_size_px: int = 1024
    distorted: bool = False  # images and annotations as the detectors show them
    annotation_noise_px: float = 0.0  # of a click; 0: exact annotations
    filling: str = "fluid"  # what the lumen holds where it is filled, or contrast
    validation_noise_px: float = 1.0  # of the clicks in the second part of the simulated validation
    compared: int = 300  # pairs that are also reconstructed in the thesis's way, and from clicks
    workers: int = field(default=0, metadata=NO_EFFECT_ON_RESULTS)  # processes beside each other; 0: one a core
    root: str | None = field(default=None, metadata=NO_EFFECT_ON_RESULTS)  # its content counts, not its place
    image_root: str | None = field(default=None, metadata=NO_EFFECT_ON_RESULTS)
    calibration: str | None = field(default=None, metadata=NO_EFFECT_ON_RESULTS)
    undistorted: Any = None
    root_sha256: str | None = None  # filled in

    def __post_init__(self) -> None:
        """Checks sizes, and that the data set of one's own is there."""
        self.root_sha256 = None
        if self.root is not None:
            for key in ("root", "images", "calibration"):
                path = self.image_root if key == "images" else getattr(self, key)
                if path is not None and not Path(path).exists():
                    raise ConfigurationError(f"guide3d.{key}={path} is missing: give the folder of a data set")
            self.root_sha256 = _content(Path(self.root), self.calibration)
        elif self.image_root is not None or self.calibration is not None or self.undistorted is not None:
            raise ConfigurationError(
                "guide3d.images, guide3d.calibration and guide3d.undistorted belong to a data set of your own: give "
                "guide3d.root=PATH too"
            )
        if self.undistorted not in (None, True, False):
            raise ConfigurationError(f"guide3d.undistorted must be true or false, got {self.undistorted}")
        require_unique("stage.phantoms", self.phantoms)
        require_unique("stage.targets", self.targets)
        for key in ("images", "pairs", "steps", "image_size_px", "compared"):
            require_positive(f"stage.{key}", getattr(self, key))
        if self.images < FEWEST_IMAGES or self.images % 2:
            raise ConfigurationError(f"stage.images must be even and at least {FEWEST_IMAGES}, got {self.images}")
        for key in ("annotation_noise_px", "validation_noise_px", "workers"):
            if getattr(self, key) < 0:
                raise ConfigurationError(f"stage.{key} must be zero or more, got {getattr(self, key)}")
        require_choice("stage.filling", self.filling, FILLINGS)


def _content(root: Path, calibration: str | None) -> str:
    """Hash over annotations and calibration; images count by their number."""
    folders = [root] if calibration is None else [root, Path(calibration)]
    files = sorted({file for folder in folders for file in ([folder] if folder.is_file() else folder.rglob("*"))})
    read = [hash_file(file) for file in files if file.is_file() and file.suffix.lower() in _READ]
    images = sum(1 for file in files if file.suffix.lower() == ".png")
    return hash_value({"read": read, "images": images})
