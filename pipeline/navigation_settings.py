"""Settings of the stage that navigates from fluoroscopic images alone."""

from __future__ import annotations

from dataclasses import dataclass, field

from pipeline.errors import ConfigurationError
from pipeline.setting_checks import NO_EFFECT_ON_RESULTS, require_choice, require_positive, require_unique
from pipeline.splineformer_settings import SPLINEFORMER_VARIANTS


@dataclass
class NavigationSettings:
    """Settings of autonomous navigation with SplineFormer."""

    name: str = "navigation"
    splineformer: str = "ordered"  # variant of the stage splineformer that sees
    cameras: list[str] = field(default_factory=lambda: ["a"])  # of the data set's pair
    image_size_px: int = 1024
    guided: bool = True  # by a contrast run before the procedure; false: by the target's mark alone
    space: bool = True  # two guided cameras also measure wire and vessels in space, by their known geometry
    phantoms: list[str] = field(default_factory=list)  # whose experts are cloned
    transfer_phantoms: list[str] = field(default_factory=list)  # navigated in without having been learnt in
    targets: list[str] = field(default_factory=lambda: ["bca", "lcca"])
    expert: str = "I+V+M"  # row of the stage enn whose episodes are cloned, and which gives advice
    episodes: list[int] = field(
        default_factory=list
    )  # expert trials a target, a navigator each; the first as the thesis
    epochs: int = 60  # of cloning
    updates: int = 1500  # of it, at least: after 300 of them 20 trials are not learnt yet
    dagger_rounds: int = 3  # 0: no fine-tuning
    dagger_lessons: int = 60  # episodes a round
    dagger_epochs: int = 30  # of every round
    arches: int = 64  # random ones that the navigator for unseen anatomies learns in; 0: none is trained
    arch_rounds: int = 5
    arch_lessons: int = 96
    arch_epochs: int = 20
    arch_hidden: int = 256  # units of that navigator
    test_arches: int = 20
    trials: int = 30  # a target in each named phantom
    reader_arches: int = 30  # random ones under whose cameras the SplineFormer is trained further
    reader_frames: int = 40  # in each
    reader_epochs: int = 3  # 0: it stays as it is
    hidden: int = 128  # units of the other navigators
    action_repeat: int = 3  # steps of 0.1 s for which they hold an action: an image a decision
    wire_length_mm: float = 312.0  # in random arches
    pixel_cloning: bool = True  # the rival that clones from pixels
    film: bool = True
    workers: int = field(default=0, metadata=NO_EFFECT_ON_RESULTS)  # jobs beside each other; 0: one a core

    @property
    def in_space(self) -> bool:
        """Whether wire and vessels are measured in space: it takes two cameras and their contrast runs."""
        return self.space and self.guided and len(self.cameras) == 2

    def __post_init__(self) -> None:
        """Checks counts and choices."""
        require_choice("stage.splineformer", self.splineformer, SPLINEFORMER_VARIANTS)
        for key in ("cameras", "phantoms", "targets", "episodes"):
            require_unique(f"stage.{key}", getattr(self, key))
        for name in self.cameras:
            require_choice("stage.cameras", name, ("a", "b"))
        both = set(self.phantoms) & set(self.transfer_phantoms)
        if both:
            raise ConfigurationError(f"stage.transfer_phantoms names {', '.join(sorted(both))}, which is learnt in")
        for count in self.episodes:
            require_positive("stage.episodes", count)
        if self.episodes != sorted(self.episodes):
            raise ConfigurationError(f"stage.episodes must rise, got {', '.join(map(str, self.episodes))}")
        for key in ("image_size_px", "epochs", "trials", "reader_frames", "hidden", "action_repeat", "dagger_lessons",
                    "dagger_epochs", "arch_lessons", "arch_epochs", "arch_rounds", "arch_hidden"):  # fmt: skip
            require_positive(f"stage.{key}", getattr(self, key))
        for key in ("updates", "dagger_rounds", "arches", "test_arches", "reader_arches", "reader_epochs", "workers",
                    "wire_length_mm"):  # fmt: skip
            if getattr(self, key) < 0:
                raise ConfigurationError(f"stage.{key} must be zero or more, got {getattr(self, key)}")
