"""Settings of the learning stages: baselines, Expert Navigation Network, imitation, force, unseen anatomies."""

from __future__ import annotations

from dataclasses import field
from typing import Annotated

from annotated_types import Ge, Gt, Le

from pipeline.anatomies.settings import ChosenAnatomies
from pipeline.settings.checks import validated
from pipeline.settings.kinds import (
    NOT_EMPTY,
    RISING,
    UNIQUE,
    Accuracy,
    Count,
    CountOrNone,
    Decisions,
    Episodes,
    EpisodesOrNone,
    FolderName,
    FolderNames,
    Hyperparameters,
    JobSettings,
    RisingEpisodes,
    SomeFolderNames,
    Trainings,
    Weight,
    one_of,
)
from pipeline.store.errors import ConfigurationError
from pipeline.task import DeviceSettings

# What forces are predicted from: the image alone, the same without the loss on features, three images, and more.
FORCE_INPUTS = ("V", "V_plain", "V3", "V+M", "I+V", "I+V_action", "I")
BASELINE_OBSERVATIONS = ("internal", "image", "sequential")

_Variant = Annotated[str, one_of("desk", "thesis")]
_Algorithms = Annotated[list[Annotated[str, one_of("ppo", "sac")]], UNIQUE, NOT_EMPTY]
_BaselineObservations = Annotated[list[Annotated[str, one_of(*BASELINE_OBSERVATIONS)]], UNIQUE, NOT_EMPTY]
_StudentObservations = Annotated[list[Annotated[str, one_of("image", "mask")]], UNIQUE, NOT_EMPTY]
_ForceInputs = Annotated[list[Annotated[str, one_of(*FORCE_INPUTS)]], UNIQUE, NOT_EMPTY]
_Reward = Annotated[str, one_of("geodesic", "distance")]
_Samples = Annotated[list[Decisions], UNIQUE, RISING, NOT_EMPTY]
_SafeWeights = Annotated[list[Annotated[float, Gt(0), Le(1e6)]], UNIQUE]


@validated()
class PolicySettings(DeviceSettings, ChosenAnatomies, JobSettings):
    """What the stages that make policies have in common: the task, networks, and how policies are tested."""

    name: str = ""  # of the stage
    variant: _Variant = "desk"  # networks and hyper-parameters: those that learn fast, or the thesis's
    evaluation_episodes: Episodes = 30  # of a policy, by its best action
    drawn_episodes: EpisodesOrNone = 5  # by drawn actions, on the first of the same seeds


@validated()
class LearningSettings(PolicySettings):
    """What the stages that train policies by reinforcement learning have in common: the trainings' sizes."""

    seeds: Trainings = 1  # trainings a row and task; run seed k trains with seeds k * seeds, k * seeds + 1, ...
    decisions: Decisions = 4_000  # budget of a training
    demonstrations: bool = True  # desk: states along the sampling expert's episodes are starts of training episodes
    encoder_samples: Count = 30_000  # desk: images that the encoder is fitted to
    encoder_epochs: CountOrNone = 0  # 0: the encoder's own choice
    reward: _Reward = "geodesic"  # of training; "distance" is the thesis's, which every table shows
    path_penalty: Weight = 40.0  # of the reward of training, a metre of the tip's way
    accuracy: Accuracy = "fast"  # of SAC's training; the best policy is chosen, and tested, in accurate physics
    # of PPO's training: from fast physics it knows too little of the branches that it enters by mistake
    ppo_accuracy: Accuracy = "accurate"
    training: Hyperparameters = None  # hyper-parameters: fields of enn's SacSettings or PpoSettings


@validated()
class BaselinesSettings(LearningSettings):
    """Settings of the reinforcement learning baselines."""

    name: str = "baselines"
    algorithms: _Algorithms = field(default_factory=lambda: ["ppo", "sac"])
    observations: _BaselineObservations = field(default_factory=lambda: list(BASELINE_OBSERVATIONS))
    # PPO's budget; `decisions` is SAC's. After 20,000 some are not at their end, most end before.
    ppo_decisions: Decisions = 40_000
    path_follower: bool = True  # also the thesis's attempt to follow the planned path


@validated()
class EnnSettings(LearningSettings):
    """Settings of the Expert Navigation Network and its ablation."""

    name: str = "enn"
    algorithm: Annotated[str, one_of("sac", "ppo")] = "sac"
    expert: FolderName = "I+V+M"  # modality set of the row that later stages learn from
    seeds: Trainings = 3
    modalities: FolderNames = field(default_factory=lambda: ["I", "V", "V+M", "I+V"])  # the ablation's other rows
    ablation_phantoms: FolderNames = field(default_factory=lambda: ["type_1"])  # where those are trained
    ablation_seeds: Trainings = 1
    # of the force in the reward, 1/N: a row each, there too
    safe_weights: _SafeWeights = field(default_factory=lambda: [1.0, 5.0])
    safe_decisions: Decisions = 6_000  # of their trainings, which a price on force makes slower
    expert_episodes: EpisodesOrNone = 100  # with images, for imitation, of each task's first training of the expert row
    modality: FolderName | None = None  # filled in by modality=…: the only row, on every phantom

    def __post_init__(self) -> None:
        """Takes the sweep's key over and checks the rows."""
        super().__post_init__()
        if self.modality is not None:
            self.modalities, self.safe_weights = [self.modality], []
            self.ablation_phantoms, self.ablation_seeds = list(self.phantoms), self.seeds
        if self.file_name is not None and self.ablation_phantoms:
            self.ablation_phantoms = list(self.phantoms)
        if (self.modalities or self.safe_weights) and not self.ablation_phantoms:
            raise ConfigurationError("stage.ablation_phantoms is empty: name at least one")


@validated()
class ImitationSettings(PolicySettings):
    """Settings of imitation: the expert's episodes of the stage enn, learnt from with the image alone."""

    name: str = "imitation"
    expert: FolderName = EnnSettings.expert  # row of the stage enn whose episodes are learnt from
    observations: _StudentObservations = field(default_factory=lambda: ["image"])  # that the student sees
    episodes: RisingEpisodes = field(default_factory=lambda: [10, 100])  # expert's; the last is the table's
    disturbed_episodes: EpisodesOrNone = 60  # further ones, with the expert's actions disturbed: a row of its own
    dagger_rounds: CountOrNone = 3  # 0: no DAgger
    dagger_episodes: Episodes = 10  # a round
    feature_matching: Weight = 0.1  # weight of the distance to the expert's features
    epochs: CountOrNone = 0  # 0: the variant's own number


@validated()
class ForceSettings(DeviceSettings, JobSettings):
    """Settings of force prediction: disturbed episodes of the expert, and networks of several amounts of samples."""

    name: str = "force"
    phantom: FolderName = "type_1"
    targets: SomeFolderNames = field(default_factory=lambda: ["bca", "lcca"])
    expert: FolderName = EnnSettings.expert  # row of the stage enn whose policy steers
    variant: _Variant = "desk"
    # to learn from; inputs beside the image are tried with the last
    samples: _Samples = field(default_factory=lambda: [1_000, 10_000])
    test_samples: Decisions = 4_000  # of episodes that are not learnt from
    noise: Annotated[float, Ge(0), Le(10)] = 0.3  # standard deviation added to the expert's actions
    spell_chance: Annotated[float, Ge(0), Le(1)] = 0.1  # that some steps of random, forward pushing begin
    epochs: CountOrNone = 0  # 0: the variant's own number
    # V: the image alone, as the thesis; see the stage
    inputs: _ForceInputs = field(default_factory=lambda: ["V", "V_plain", "I+V"])
