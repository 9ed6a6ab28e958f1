"""Settings of the stages that train the networks of the Guide3D chapter: shape prediction and segmentation."""

from __future__ import annotations

from dataclasses import field
from typing import Annotated

from annotated_types import Ge, Le

from pipeline.settings.checks import NO_EFFECT_ON_RESULTS, validated
from pipeline.settings.kinds import NOT_EMPTY, UNIQUE, CountOrNone, Device, PathText, Processes, Seed, one_of

# What predicts a shape: the shape network as the thesis's table has it, with the thesis's loss alone, and 3D-FGRN.
SHAPE_ROWS = ("spherical", "cartesian", "spherical_angles", "fgrn")
SEGMENTATION_ROWS = ("unet", "transunet", "swinunet")
NETWORK_SIZES = ("thesis", "desk", "smoke")

_ShapeRows = Annotated[list[Annotated[str, one_of(*SHAPE_ROWS)]], UNIQUE, NOT_EMPTY]
_SegmentationRows = Annotated[list[Annotated[str, one_of(*SEGMENTATION_ROWS)]], UNIQUE, NOT_EMPTY]


@validated()
class NetworkSettings:
    """What both stages have in common."""

    rows: Annotated[list[str], UNIQUE, NOT_EMPTY] = field(default_factory=list)  # networks to train
    size: Annotated[str, one_of(*NETWORK_SIZES)] = "desk"  # of networks and training: see guide3d.learning.recipes
    epochs: CountOrNone = 0  # 0: the recipe's own number
    split_seed: Seed = 0  # of the split by acquisition
    processes: Annotated[int, Ge(1), Le(64)] = 1  # that train one network together, by torchrun: one a GPU
    device: Device = field(default="auto", metadata=NO_EFFECT_ON_RESULTS)  # of the networks: see pipeline.jobs.gpus
    workers: Processes = field(default=0, metadata=NO_EFFECT_ON_RESULTS)  # trainings beside each other; 0: one a core


@validated()
class ShapeSettings(NetworkSettings):
    """Settings of shape prediction."""

    name: str = "shape"
    rows: _ShapeRows = field(default_factory=list)
    pretrained: PathText | None = None  # weights of the vision transformer, under timm's or torchvision's names


@validated()
class SegmentationSettings(NetworkSettings):
    """Settings of segmentation."""

    name: str = "segmentation"
    rows: _SegmentationRows = field(default_factory=list)
    test_images: CountOrNone = 0  # of the test acquisitions, evenly chosen; 0: all
