"""Settings of the stages that train networks on the images of a data set: shape, segmentation and splineformer."""

from __future__ import annotations

from dataclasses import field
from importlib.resources import as_file, files
from pathlib import Path
from typing import Annotated

from pipeline.settings import kinds
from pipeline.store.errors import ConfigurationError
from pipeline.store.provenance import hash_file

# What predicts a shape: the shape network as the thesis's table has it, with the thesis's loss alone, and 3D-FGRN.
SHAPE_ROWS = ("spherical", "cartesian", "spherical_angles", "fgrn")
SEGMENTATION_ROWS = ("unet", "transunet", "swinunet")
NETWORK_SIZES = ("thesis", "desk", "smoke")
SPLINEFORMER_VARIANTS = ("published", "ordered")
SPLINEFORMER_SIZES = ("thesis", "thesis_large", "desk", "smoke")
DISTURBANCES = ("none", "noise", "low_contrast", "occlusion")

_ShapeRows = Annotated[list[Annotated[str, kinds.one_of(*SHAPE_ROWS)]], kinds.UNIQUE, kinds.NOT_EMPTY]
_SegmentationRows = Annotated[list[Annotated[str, kinds.one_of(*SEGMENTATION_ROWS)]], kinds.UNIQUE, kinds.NOT_EMPTY]

_Variants = Annotated[list[Annotated[str, kinds.one_of(*SPLINEFORMER_VARIANTS)]], kinds.UNIQUE, kinds.NOT_EMPTY]
_Disturbances = Annotated[list[Annotated[str, kinds.one_of(*DISTURBANCES)]], kinds.UNIQUE, kinds.NOT_EMPTY]


@kinds.validated()
class TrainingSettings(kinds.JobSettings):
    """What the stages have in common."""

    size: Annotated[str, kinds.one_of(*NETWORK_SIZES)] = "desk"  # of networks and training: see the package's recipes
    epochs: kinds.CountOrNone = 0  # 0: the recipe's own number
    split_seed: kinds.Seed = 0  # of the split by acquisition
    # The networks train on this device: see pipeline.jobs.machine.
    device: kinds.Device = field(default="auto", metadata=kinds.NO_EFFECT_ON_RESULTS)


# Stage to the package, row and name of the network that its training by default leaves.
SHIPPED = {"shape": ("guide3d", "spherical", "shape"), "splineformer": ("splineformer", "ordered", "ordered_simulated")}


@kinds.validated()
class ShippedSettings(TrainingSettings):
    """Settings of a stage of which one network comes with a package."""

    name: str = ""  # of the stage
    # takes that network, where the data set is the one that it was trained on
    shipped: bool = False
    shipped_sha256: str | None = None  # of that, filled in

    def __post_init__(self) -> None:
        self.shipped_sha256 = None
        if self.shipped:
            package, _, network = SHIPPED[self.name]
            with as_file(files(f"{package}.weights") / f"{network}.pt") as path:
                self.shipped_sha256 = hash_file(path)


@kinds.validated()
class ShapeSettings(ShippedSettings):
    """Settings of shape prediction."""

    name: str = "shape"
    rows: _ShapeRows = field(default_factory=lambda: ["spherical", "cartesian", "fgrn"])  # networks to train
    pretrained: kinds.PathText | None = None  # weights of the vision transformer, under timm's or torchvision's names
    pretrained_sha256: str | None = None  # of that, filled in

    def __post_init__(self) -> None:
        """Trains where the user gives weights to start from: the shipped network did not."""
        self.shipped = self.shipped and self.pretrained is None
        file = Path(self.pretrained or "")
        self.pretrained_sha256 = hash_file(file) if file.is_file() else None
        super().__post_init__()


@kinds.validated()
class SegmentationSettings(TrainingSettings):
    """Settings of segmentation."""

    name: str = "segmentation"
    rows: _SegmentationRows = field(default_factory=lambda: list(SEGMENTATION_ROWS))  # networks to train
    test_images: kinds.CountOrNone = 120  # of the test acquisitions, evenly chosen; 0: all


@kinds.validated()
class SplineformerSettings(ShippedSettings):
    """Settings of SplineFormer."""

    name: str = "splineformer"
    variants: _Variants = field(default_factory=lambda: list(SPLINEFORMER_VARIANTS))  # to train, see splineformer.build
    size: Annotated[str, kinds.one_of(*SPLINEFORMER_SIZES)] = "desk"
    # network of the stage segmentation whose masks are traced
    rival: Annotated[str, kinds.one_of(*SEGMENTATION_ROWS)] = "unet"
    # under which images are read
    disturbances: _Disturbances = field(default_factory=lambda: list(DISTURBANCES))
    test_images: kinds.CountOrNone = 360  # of the test acquisitions, evenly chosen; 0: all
    disturbed_images: kinds.CountOrNone = 40  # of those, under each disturbance; 0: all

    def __post_init__(self) -> None:
        """Checks that there is something to compare with, and that the variant has the size."""
        super().__post_init__()
        if "none" not in self.disturbances:
            raise ConfigurationError("stage.disturbances must hold none: it is what the others are compared with")
        if self.size == "thesis_large" and self.variants != ["published"]:
            raise ConfigurationError("stage.size=thesis_large is a size of the variant published alone")
