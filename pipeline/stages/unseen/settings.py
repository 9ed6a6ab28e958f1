"""Settings of the stage unseen: policies for anatomies that they were not trained on."""

from __future__ import annotations

from dataclasses import field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from annotated_types import Ge, Le

from pipeline.anatomies.settings import GENERATED_TARGETS, TARGETS, ChosenAnatomies
from pipeline.settings import kinds
from pipeline.stages.learning.settings import StartingPolicySettings
from pipeline.stages.unseen.task import TEST_PHANTOM, TRAINING_KINDS, VARIETY, require_clutter_fits
from pipeline.store.errors import ConfigurationError
from pipeline.store.provenance import hash_file
from pipeline.task import DESCENDING, NO_WIRE, Task, task_in_random_arches

if TYPE_CHECKING:
    from cathsim.anatomy import Phantom

ONE_VIEW = ("frontal",)
GENERALIST, NAVIGATOR = "generalist", "navigator"  # policies that come with enn; of their cards:
NAVIGATOR_VIEWS, NAVIGATOR_FIELD_MM = ("frontal", "lao_45"), 200.0
LEARNT_IN = 150  # arches, by the generalist
LEAST_FIELD_MM = 160.0  # whose upper 4/9 hold `TARGETS` of random arches, up to 63 mm above the arch
LEAST_WIDE_FIELD_MM = 200.0  # with RSA and RCCA, up to 88 mm beside the arch's middle and 75 mm above it


def shipped_policy(name: str) -> Path:
    from enn.shipped import weight_files

    return next(file for file in weight_files() if file.stem == name)


_Noises = Annotated[list[Annotated[float, Ge(0), Le(20)]], kinds.UNIQUE]


@kinds.validated()
class UnseenSettings(ChosenAnatomies, StartingPolicySettings, kinds.JobSettings):
    """Settings of the policies for anatomies that were never seen; `policy` starts the main one by a roadmap."""

    needs_anatomy: ClassVar[bool] = False
    shows_ct: ClassVar[str | None] = "xray"

    name: str = "unseen"
    # takes enn's `generalist` and `navigator` as they are in place of the trainings by roadmap and by X-ray images
    shipped: bool = False
    navigator_sha256: str | None = None  # filled in
    own_entry: kinds.PathText = DESCENDING  # filled in: access site in `phantoms`
    # that policies are trained and tested in: random_steep and random_trunk have more arches of a rare shape, among
    # others; arch_variety has six branching types, and targets are points of its own
    arches: Annotated[str, kinds.one_of(*TRAINING_KINDS)] = TEST_PHANTOM
    points: Annotated[int, Ge(1), Le(20)] = 3  # that each arch of arch_variety has as targets
    targets: kinds.FolderNames = field(default_factory=lambda: list(TARGETS))  # of every policy in random arches
    # Targets of the tests in `phantoms`; an empty list takes those of the policies.
    own_targets: kinds.TargetNames = field(default_factory=list)
    accuracy: kinds.Accuracy = "fast"  # of the physics that policies are trained in; tests are accurate
    anatomies: kinds.Count = 160  # random arches that the roadmap policy is trained on
    # of the steepest target of every arch that is trained in or chosen by, `cathsim.anatomy.vessel_tree`;
    # 0: any arch
    least_set_back_mm: Annotated[float, Ge(0), Le(100)] = 0.0
    # further numbers of arches, a policy each
    curve: Annotated[list[kinds.Count], kinds.UNIQUE] = field(default_factory=list)
    demonstrations: kinds.CountOrNone = 0  # that the sampling expert tries, in as many arches
    # of the roadmap policy's training, whose success rose until 48,000; 0: that of `policy` is taken as it is
    decisions: kinds.CountOrNone = 48_000
    # Decisions of each of the curve's policies, which include the one on `anatomies` arches.
    curve_decisions: kinds.Decisions = 12_000
    hidden: kinds.Units = 256  # units of each of their two layers
    training: kinds.Hyperparameters = None  # their hyper-parameters: fields of enn's SacSettings or PpoSettings
    validation_anatomies: kinds.Count = 16  # random arches, neither trained on nor tested, to keep the best policy by
    validation_episodes: kinds.Episodes = 48  # in them
    # also the policy that observes images without noise and the wire's true mask: what noise and segmentation cost
    image: bool = False
    xray: bool = True  # also the one that sees noisy X-ray images and a contrast run, and finds the wire itself
    # Views of the noisy X-ray, one image each a decision; two views are a bi-planar fluoroscope's.
    views: kinds.SomeFolderNames = field(default_factory=lambda: list(ONE_VIEW))
    # side of the square that they show, about the arch, mm in the plane of the isocentre; 0: all of the anatomy
    field_mm: Annotated[float, Ge(0), Le(400)] = 0.0
    # of clutter in X-ray images, 1 as in guide3d's random fluoroscopy: in those that the wire's network learns from, in
    # every second one of the lumen's, in every second environment of the rounds, in a further set of tests; 0: none
    clutter: Annotated[float, Ge(0), Le(4)] = 1.0
    clutter_anatomies: kinds.Count = 20  # unseen arches of that set
    image_anatomies: kinds.Count = 128  # arches that each is trained on
    segmenter_epochs: kinds.Count = 30
    wire_epochs: kinds.Count = 6  # of the network that finds the wire
    rounds: kinds.Count = 6  # of advised episodes
    advised_episodes: kinds.Count = 120  # a round
    epochs: kinds.Count = 20  # over all episodes so far, a round
    test_anatomies: Annotated[int, Ge(1), Le(500)] = 20  # unseen random arches
    phantoms: kinds.FolderNames = field(  # to test in, none of them trained on
        default_factory=lambda: ["type_1", "type_2", "type_3", "bovine", "type_1_aneurysm"]
    )
    named_episodes: kinds.Episodes = 5  # on each, for each target
    mesh_episodes: Annotated[int, Ge(1), Le(500)] = 10  # in a file's anatomy
    # further wires: presets, "softer", "stiffer"
    wires: kinds.FolderNames = field(default_factory=lambda: ["thesis", "softer", "stiffer"])
    wire_anatomies: kinds.Count = 10  # unseen arches that each is tried on
    # errors of the roadmap's registration that its policy is tried with, mm an axis; 0 is the test without any
    registration_noise_mm: _Noises = field(default_factory=lambda: [0.0, 2.0, 4.0])
    task: Task = field(default_factory=task_in_random_arches)

    def __post_init__(self) -> None:
        """Takes the choices of the command line over."""
        ChosenAnatomies.__post_init__(self)
        self.navigator_sha256 = None
        if self.shipped:
            self._take_shipped()
        StartingPolicySettings.__post_init__(self)
        if not self.targets:
            raise ConfigurationError("stage.targets is empty: name at least one")
        if not self.decisions and self.policy is None:
            raise ConfigurationError(
                "stage.decisions=0 takes a policy by a roadmap as it is: name its file by stage.policy, or train one"
            )
        if self.task.wire == NO_WIRE:
            raise ConfigurationError(f"stage unseen steers a wire, got task.wire={NO_WIRE}: name a wire")
        least = LEAST_FIELD_MM if set(self.targets) <= set(TARGETS) else LEAST_WIDE_FIELD_MM
        if 0 < self.field_mm < least:
            raise ConfigurationError(
                f"stage.field_mm={self.field_mm:g} would leave targets out of the X-ray images: give "
                f"{least:g} or more, or 0 for all of the anatomy"
            )
        if self.clutter and self.xray:
            require_clutter_fits(self.task.image_size_px, "task.image_size_px")
        if self.task.catheter is not None and self.image:
            raise ConfigurationError(
                "with a catheter stage unseen trains no policy by images and the true mask: give stage.image=false"
            )
        if self.arches == VARIETY and self.phantoms:
            raise ConfigurationError(
                f"with stage.arches={VARIETY} policies are trained and tested in any such arches and in no others: "
                "give stage.phantoms=[]"
            )

    def _take_shipped(self) -> None:
        generalist = str(shipped_policy(GENERALIST))
        deviations = {
            "arches": self.arches != TEST_PHANTOM,
            "task.image_size_px": self.xray and self.task.image_size_px != task_in_random_arches().image_size_px,
            "task.catheter": self.task.catheter is not None,
            "curve": bool(self.curve),
            "least_set_back_mm": self.least_set_back_mm > 0,
            "training": self.training is not None,
            "policy": self.policy not in (None, generalist),
            "views": tuple(self.views) not in (ONE_VIEW, NAVIGATOR_VIEWS),
            "field_mm": self.field_mm not in (0.0, NAVIGATOR_FIELD_MM),
        }
        if any(deviations.values()):
            raise ConfigurationError(
                "stage.shipped=true takes policies of a wire alone in any random arches as they are, and no "
                f"{', '.join(f'stage.{name}' for name, own in deviations.items() if own)}: train your own with "
                "pretrained=false, of make PRETRAINED=0"
            )
        self.policy, self.decisions = generalist, 0
        self.navigator_sha256 = hash_file(shipped_policy(NAVIGATOR))
        self.anatomies = LEARNT_IN
        self.views, self.field_mm = list(NAVIGATOR_VIEWS), NAVIGATOR_FIELD_MM

    def field(self) -> float | None:
        """As of `cathsim.observations.framing.framed`, m."""
        return 1e-3 * self.field_mm or None

    def learnt_targets(self) -> tuple[str, ...]:
        if self.arches != VARIETY:
            return tuple(self.targets)
        from cathsim.anatomy.point_target import drawn_point_name

        return tuple(drawn_point_name(number) for number in range(1, self.points + 1))

    def take_targets(self, names: list[str]) -> None:
        """Policies learn the targets of random arches alone; others are tried in `phantoms`."""
        if set(names) <= set(GENERATED_TARGETS):
            self.targets = names
        else:
            self.own_targets = names

    def tested_targets(self) -> list[str]:
        """The targets in the anatomies of `phantoms`."""
        return self.own_targets or self.targets

    def tested_entry(self) -> str:
        """The entry in the anatomies of `phantoms`."""
        return self.own_entry

    def take_entry(self, entry: str) -> None:
        """Wires of the policies come from the groin; others are tried in `phantoms`."""
        self.own_entry = entry

    def fit(self, phantom: Phantom) -> None:
        """Leaves the wire of the random arches; in a file's anatomy it is as long as its way asks for."""
