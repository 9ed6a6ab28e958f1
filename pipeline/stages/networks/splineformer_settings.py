"""Settings of the stage that reads wires off images as B-splines, and compares that with segmentation."""

from __future__ import annotations

from dataclasses import field
from typing import Annotated

from annotated_types import Ge, Le

from pipeline.settings.checks import NO_EFFECT_ON_RESULTS, validated
from pipeline.settings.kinds import NOT_EMPTY, UNIQUE, CountOrNone, Device, Processes, Seed, one_of
from pipeline.store.errors import ConfigurationError

SPLINEFORMER_VARIANTS = ("published", "ordered")
SPLINEFORMER_SIZES = ("thesis", "thesis_large", "desk", "smoke")
DISTURBANCES = ("none", "noise", "low_contrast", "occlusion")
RIVALS = ("unet", "transunet", "swinunet")

_Variants = Annotated[list[Annotated[str, one_of(*SPLINEFORMER_VARIANTS)]], UNIQUE, NOT_EMPTY]
_Disturbances = Annotated[list[Annotated[str, one_of(*DISTURBANCES)]], UNIQUE, NOT_EMPTY]


@validated()
class SplineformerSettings:
    """Settings of SplineFormer."""

    name: str = "splineformer"
    variants: _Variants = field(default_factory=list)  # to train, see splineformer.build
    size: Annotated[str, one_of(*SPLINEFORMER_SIZES)] = (
        "desk"  # of networks and training: see splineformer.learning.recipes
    )
    epochs: CountOrNone = 0  # 0: the recipe's own number
    rival: Annotated[str, one_of(*RIVALS)] = "unet"  # network of the stage segmentation whose masks are traced
    disturbances: _Disturbances = field(default_factory=lambda: ["none"])  # under which images are read
    test_images: CountOrNone = 0  # of the test acquisitions, evenly chosen; 0: all
    disturbed_images: CountOrNone = 0  # of those, under each disturbance; 0: all
    split_seed: Seed = 0  # of the split by acquisition: that of the segmentation
    processes: Annotated[int, Ge(1), Le(64)] = 1  # that train one network together, by torchrun: one a GPU
    device: Device = field(default="auto", metadata=NO_EFFECT_ON_RESULTS)  # of the networks: see pipeline.jobs.gpus
    tensorboard: bool = field(default=False, metadata=NO_EFFECT_ON_RESULTS)
    workers: Processes = field(default=0, metadata=NO_EFFECT_ON_RESULTS)  # trainings beside each other; 0: one a core

    def __post_init__(self) -> None:
        """Checks that there is something to compare with, and that the variant has the size."""
        if "none" not in self.disturbances:
            raise ConfigurationError("stage.disturbances must hold none: it is what the others are compared with")
        if self.size == "thesis_large" and self.variants != ["published"]:
            raise ConfigurationError("stage.size=thesis_large is a size of the variant published alone")
