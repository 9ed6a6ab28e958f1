"""Settings of the stage that navigates from fluoroscopic images alone."""

from __future__ import annotations

from dataclasses import field, replace
from typing import TYPE_CHECKING, Annotated

from annotated_types import Ge, Le

from pipeline.anatomies.settings import ChosenAnatomies
from pipeline.settings import kinds
from pipeline.stages.learning.settings import EnnSettings
from pipeline.stages.networks.settings import SPLINEFORMER_VARIANTS
from pipeline.stages.unseen.task import require_clutter_fits
from pipeline.store.errors import ConfigurationError
from pipeline.task import Task, task_in_random_arches

if TYPE_CHECKING:
    from cathsim.observations.c_arm_view import CArms

_Cameras = Annotated[list[Annotated[str, kinds.one_of("a", "b")]], kinds.UNIQUE, kinds.NOT_EMPTY]


@kinds.validated()
class NavigationSettings(ChosenAnatomies, kinds.JobSettings):
    """Settings of autonomous navigation with SplineFormer."""

    name: str = "navigation"
    splineformer: Annotated[str, kinds.one_of(*SPLINEFORMER_VARIANTS)] = "ordered"  # the stage splineformer's variant
    cameras: _Cameras = field(default_factory=lambda: ["a", "b"])  # of the data set's pair
    image_size_px: Annotated[int, Ge(64), Le(4_096)] = 512
    guided: bool = True  # by a contrast run before the procedure; false: by the target's mark alone
    space: bool = True  # two guided cameras also measure wire and vessels in space, by their known geometry
    phantoms: kinds.FolderNames = field(default_factory=lambda: ["type_1"])  # whose experts are cloned
    # navigated in without having been learnt in
    transfer_phantoms: kinds.FolderNames = field(default_factory=lambda: ["type_2"])
    # row of the stage enn whose episodes are cloned, and which gives advice
    expert: kinds.FolderName = EnnSettings.expert
    # trials of the expert a target: a navigator each; that of 100 reaches every target
    episodes: kinds.RisingEpisodes = field(default_factory=lambda: [20, 100])
    epochs: kinds.Count = 60  # of cloning
    updates: kinds.CountOrNone = 1500  # of it, at least: after 300 of them 20 trials are not learnt yet
    dagger_rounds: kinds.CountOrNone = 2  # the second reaches every target; 0: no fine-tuning
    dagger_episodes: kinds.Count = 60  # episodes a round
    dagger_epochs: kinds.Count = 30  # of every round
    arches: kinds.CountOrNone = 100  # random ones that the navigator for unseen anatomies learns in; 0: none is trained
    arch_rounds: kinds.Count = 5
    arch_episodes: kinds.Count = 90
    arch_epochs: kinds.Count = 20
    arch_hidden: kinds.Units = 256  # units of that navigator
    test_arches: kinds.CountOrNone = 20
    # of clutter in images, 1 as in guide3d's random fluoroscopy: in every second picture of the perception network, in
    # every second arch of that navigator, and in a further set of trials of it; 0: none
    clutter: Annotated[float, Ge(0), Le(4)] = 0.0
    clutter_arches: kinds.Count = 20  # unseen arches of that set
    subtracted: bool = False  # navigators see images divided by the contrast run's image without a wire
    trials: kinds.Episodes = 20  # a target in each named phantom
    perception_arches: kinds.CountOrNone = 30  # random ones in which the SplineFormer is fine-tuned
    perception_frames: kinds.Count = 72  # in each
    perception_epochs: kinds.CountOrNone = 4  # 0: it stays as it is
    hidden: kinds.Units = 128  # units of the other navigators
    action_repeat: Annotated[int, Ge(1), Le(100)] = 3  # steps of 0.1 s that they hold an action: an image a decision
    task: Task = field(default_factory=Task)  # in named phantoms: that of the stage enn
    arch_task: Task = field(default_factory=task_in_random_arches)  # that of the stage unseen
    pixel_cloning: bool = True  # the rival that clones from pixels
    film: bool = True

    @property
    def arms(self) -> CArms:
        from cathsim.observations.c_arm_view import CArms

        return CArms(tuple(self.cameras), self.image_size_px, subtracted=self.subtracted)

    def arms_for(self, task: Task) -> CArms:
        """The C-arms with the wire of a task to be drawn."""
        return replace(self.arms, wire=task.wire)

    @property
    def in_space(self) -> bool:
        """Whether wire and vessels are measured in space: it takes two cameras and their contrast runs."""
        return self.space and self.guided and len(self.cameras) == 2

    def __post_init__(self) -> None:
        """Takes the choices over; refuses a phantom both learnt in and kept for the transfer, and too large clutter."""
        chosen = self.phantom is not None
        super().__post_init__()
        if self.clutter:
            require_clutter_fits(self.image_size_px, "stage.image_size_px")
        if self.file is not None:
            self.transfer_phantoms = []
        if chosen:
            self.transfer_phantoms = [name for name in self.transfer_phantoms if name not in self.phantoms]
        both = set(self.phantoms) & set(self.transfer_phantoms)
        if both:
            raise ConfigurationError(f"stage.transfer_phantoms names {', '.join(sorted(both))}, which is learnt in")
