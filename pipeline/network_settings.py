"""Settings of the stages that train the networks of the Guide3D chapter: shape prediction and segmentation."""

from __future__ import annotations

from dataclasses import dataclass, field

from pipeline.errors import ConfigurationError
from pipeline.setting_checks import NO_EFFECT_ON_RESULTS, require_choice, require_positive, require_unique

# What predicts a shape: the shape network as the thesis's table has it, with the thesis's loss alone, and 3D-FGRN.
SHAPE_ROWS = ("spherical", "cartesian", "spherical_angles", "fgrn")
SEGMENTATION_ROWS = ("unet", "transunet", "swinunet")
NETWORK_SIZES = ("thesis", "desk", "smoke")


@dataclass
class NetworkSettings:
    """What both stages have in common."""

    rows: list[str] = field(default_factory=list)  # networks to train
    size: str = "desk"  # of networks and training: see guide3d.recipes
    epochs: int = 0  # 0: the recipe's own number
    split_seed: int = 0  # of the split by acquisition
    processes: int = 1  # that train one network together, by torchrun: one a GPU
    device: str = "auto"  # a GPU where there is one; or cpu, cuda
    workers: int = field(default=0, metadata=NO_EFFECT_ON_RESULTS)  # trainings beside each other; 0: one a core

    def __post_init__(self) -> None:
        """Checks counts and choices."""
        require_unique("stage.rows", self.rows)
        require_choice("stage.size", self.size, NETWORK_SIZES)
        require_choice("stage.device", self.device, ("auto", "cpu", "cuda"))
        require_positive("stage.processes", self.processes)
        for key in ("epochs", "workers", "split_seed"):
            if getattr(self, key) < 0:
                raise ConfigurationError(f"stage.{key} must be zero or more, got {getattr(self, key)}")


@dataclass
class ShapeSettings(NetworkSettings):
    """Settings of shape prediction."""

    name: str = "shape"
    pretrained: str | None = None  # weights of the vision transformer, under timm's or torchvision's names

    def __post_init__(self) -> None:
        """Checks the rows."""
        super().__post_init__()
        for row in self.rows:
            require_choice("stage.rows", row, SHAPE_ROWS)


@dataclass
class SegmentationSettings(NetworkSettings):
    """Settings of segmentation."""

    name: str = "segmentation"
    test_images: int = 0  # of the test acquisitions, evenly chosen; 0: all

    def __post_init__(self) -> None:
        """Checks the rows."""
        super().__post_init__()
        for row in self.rows:
            require_choice("stage.rows", row, SEGMENTATION_ROWS)
        if self.test_images < 0:
            raise ConfigurationError(f"stage.test_images must be zero or more, got {self.test_images}")
