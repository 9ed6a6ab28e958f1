"""Settings of the stage that reads wires off images as B-splines, and compares that with segmentation."""

from __future__ import annotations

from dataclasses import dataclass, field

from pipeline.errors import ConfigurationError
from pipeline.setting_checks import NO_EFFECT_ON_RESULTS, require_choice, require_positive, require_unique

SPLINEFORMER_VARIANTS = ("published", "ordered")
SPLINEFORMER_SIZES = ("thesis", "thesis_large", "desk", "smoke")
DISTURBANCES = ("none", "noise", "low_contrast", "occlusion")
RIVALS = ("unet", "transunet", "swinunet")


@dataclass
class SplineformerSettings:
    """Settings of SplineFormer."""

    name: str = "splineformer"
    variants: list[str] = field(default_factory=list)  # to train, see splineformer.build
    size: str = "desk"  # of networks and training: see splineformer.recipes
    epochs: int = 0  # 0: the recipe's own number
    rival: str = "unet"  # network of the stage segmentation whose masks are traced
    disturbances: list[str] = field(default_factory=lambda: ["none"])  # under which images are read
    test_images: int = 0  # of the test acquisitions, evenly chosen; 0: all
    disturbed_images: int = 0  # of those, under each disturbance; 0: all
    split_seed: int = 0  # of the split by acquisition: that of the segmentation
    processes: int = 1  # that train one network together, by torchrun: one a GPU
    device: str = "auto"  # a GPU where there is one; or cpu, cuda
    tensorboard: bool = field(default=False, metadata=NO_EFFECT_ON_RESULTS)
    workers: int = field(default=0, metadata=NO_EFFECT_ON_RESULTS)  # trainings beside each other; 0: one a core

    def __post_init__(self) -> None:
        """Checks counts and choices."""
        require_unique("stage.variants", self.variants)
        for variant in self.variants:
            require_choice("stage.variants", variant, SPLINEFORMER_VARIANTS)
        require_unique("stage.disturbances", self.disturbances)
        for kind in self.disturbances:
            require_choice("stage.disturbances", kind, DISTURBANCES)
        if "none" not in self.disturbances:
            raise ConfigurationError("stage.disturbances must hold none: it is what the others are compared with")
        require_choice("stage.size", self.size, SPLINEFORMER_SIZES)
        if self.size == "thesis_large" and self.variants != ["published"]:
            raise ConfigurationError("stage.size=thesis_large is a size of the variant published alone")
        require_choice("stage.rival", self.rival, RIVALS)
        require_choice("stage.device", self.device, ("auto", "cpu", "cuda"))
        require_positive("stage.processes", self.processes)
        for key in ("epochs", "workers", "split_seed", "test_images", "disturbed_images"):
            if getattr(self, key) < 0:
                raise ConfigurationError(f"stage.{key} must be zero or more, got {getattr(self, key)}")
