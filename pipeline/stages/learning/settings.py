"""Settings of the learning stages, of the policy that a training starts from, and of its hyper-parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from annotated_types import Ge, Gt, Le

from pipeline.anatomies.settings import ChosenAnatomies
from pipeline.settings import kinds
from pipeline.store.errors import ConfigurationError
from pipeline.store.provenance import hash_file
from pipeline.task import Task

if TYPE_CHECKING:
    from enn.reinforcement.training.settings import TrainingSettings


# What forces are predicted from: the image alone, the same without the loss on features, and more.
FORCE_INPUTS = ("V", "V_plain", "V+M", "I+V", "I")
BASELINE_OBSERVATIONS = ("internal", "image", "sequential")

_Variant = Annotated[str, kinds.one_of("desk", "thesis")]
_Algorithms = Annotated[list[Annotated[str, kinds.one_of("ppo", "sac")]], kinds.UNIQUE, kinds.NOT_EMPTY]
_BaselineObservations = Annotated[
    list[Annotated[str, kinds.one_of(*BASELINE_OBSERVATIONS)]], kinds.UNIQUE, kinds.NOT_EMPTY
]
_StudentObservations = Annotated[list[Annotated[str, kinds.one_of("image", "mask")]], kinds.UNIQUE, kinds.NOT_EMPTY]
_ForceInputs = Annotated[list[Annotated[str, kinds.one_of(*FORCE_INPUTS)]], kinds.UNIQUE, kinds.NOT_EMPTY]
_Reward = Annotated[str, kinds.one_of("geodesic", "distance")]
_Samples = Annotated[list[kinds.Decisions], kinds.UNIQUE, kinds.RISING, kinds.NOT_EMPTY]
_SafeWeights = Annotated[list[Annotated[float, Gt(0), Le(1e6)]], kinds.UNIQUE]


@kinds.validated()
class PolicySettings(ChosenAnatomies, kinds.JobSettings):
    """What the stages that make policies have in common: the task, networks, and how policies are tested."""

    name: str = ""  # of the stage
    variant: _Variant = "desk"  # networks and hyper-parameters: those that learn fast, or the thesis's
    evaluation_episodes: kinds.Episodes = 30  # of a policy, by its best action
    drawn_episodes: kinds.EpisodesOrNone = 5  # by drawn actions, on the first of the same seeds


@kinds.validated()
class LearningSettings(PolicySettings):
    """What the stages that train policies by reinforcement learning have in common: the trainings' sizes."""

    seeds: kinds.Trainings = 1  # trainings a row and task; run seed k trains with seeds k * seeds, k * seeds + 1, ...
    decisions: kinds.Decisions = 4_000  # budget of a training
    demonstrations: bool = True  # desk: states along the sampling expert's episodes are starts of training episodes
    encoder_samples: kinds.Count = 15_000  # desk: images that the encoder is fitted to
    encoder_epochs: kinds.CountOrNone = 0  # 0: the encoder's own choice
    reward: _Reward = "geodesic"  # of training; "distance" is the thesis's, which every table shows
    path_penalty: kinds.Weight = 40.0  # of the reward of training, a metre of the tip's way
    accuracy: kinds.Accuracy = "fast"  # of SAC's training; the best policy is chosen, and tested, in accurate physics
    # PPO trains in accurate physics: fast physics shows it too little of branches that it enters by mistake.
    ppo_accuracy: kinds.Accuracy = "accurate"
    training: kinds.Hyperparameters = None  # hyper-parameters: fields of enn's SacSettings or PpoSettings


@kinds.validated()
class BaselinesSettings(LearningSettings):
    """Settings of the reinforcement learning baselines."""

    name: str = "baselines"
    algorithms: _Algorithms = field(default_factory=lambda: ["ppo", "sac"])
    observations: _BaselineObservations = field(default_factory=lambda: list(BASELINE_OBSERVATIONS))
    # PPO's budget; `decisions` is SAC's. With 40,000 the tasks of Type II arrive no more often.
    ppo_decisions: kinds.Decisions = 20_000
    path_follower: bool = True  # also the thesis's attempt to follow the planned path


@kinds.validated()
class EnnSettings(LearningSettings):
    """Settings of the Expert Navigation Network and its ablation."""

    name: str = "enn"
    algorithm: Annotated[str, kinds.one_of("sac", "ppo")] = "sac"
    expert: kinds.FolderName = "I+V+M"  # modality set of the row that later stages learn from
    modalities: kinds.FolderNames = field(default_factory=lambda: ["I", "V", "V+M", "I+V"])  # the ablation's other rows
    ablation_phantoms: kinds.FolderNames = field(default_factory=lambda: ["type_1"])  # where those are trained
    ablation_seeds: kinds.Trainings = 1
    # Weights of the force in the reward, 1/N; each one has a row, on every phantom, too.
    safe_weights: _SafeWeights = field(default_factory=lambda: [1.0, 5.0])
    safe_decisions: kinds.Decisions = 6_000  # of their trainings, which a price on force makes slower
    # Episodes with images, for imitation, which each task's first training of the expert row plays.
    expert_episodes: kinds.EpisodesOrNone = 100
    modality: kinds.FolderName | None = None  # filled in by modality=…: the only row, on every phantom

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


@kinds.validated()
class ImitationSettings(PolicySettings):
    """Settings of imitation: the expert's episodes of the stage enn, learnt from with the image alone."""

    name: str = "imitation"
    expert: kinds.FolderName = EnnSettings.expert  # row of the stage enn whose episodes are learnt from
    observations: _StudentObservations = field(default_factory=lambda: ["image"])  # that the student sees
    episodes: kinds.RisingEpisodes = field(default_factory=lambda: [10, 100])  # expert's; the last is the table's
    # further ones, with disturbed actions, that the default student learns from; 0: the plain one alone
    disturbed_episodes: kinds.EpisodesOrNone = 60
    dagger_rounds: kinds.CountOrNone = 3  # 0: no DAgger
    dagger_episodes: kinds.Episodes = 10  # a round
    feature_matching: kinds.Weight = 0.1  # weight of the distance to the expert's features
    epochs: kinds.CountOrNone = 0  # 0: the variant's own number


@kinds.validated()
class ForceSettings(kinds.JobSettings):
    """Settings of force prediction: disturbed episodes of the expert, and networks of several amounts of samples."""

    name: str = "force"
    phantom: kinds.FolderName = "type_1"
    targets: kinds.SomeFolderNames = field(default_factory=lambda: ["bca", "lcca"])
    expert: kinds.FolderName = EnnSettings.expert  # row of the stage enn whose policy steers
    variant: _Variant = "desk"
    # Numbers of samples to learn from; inputs beside the image are tried with the last number.
    samples: _Samples = field(default_factory=lambda: [1_000, 10_000])
    test_samples: kinds.Decisions = 4_000  # of episodes that are not learnt from
    noise: Annotated[float, Ge(0), Le(10)] = 0.3  # standard deviation added to the expert's actions
    spell_chance: Annotated[float, Ge(0), Le(1)] = 0.1  # that some steps of random, forward pushing begin
    epochs: kinds.CountOrNone = 0  # 0: the variant's own number
    # V: the image alone, as the thesis; see the stage
    inputs: _ForceInputs = field(default_factory=lambda: ["V", "V_plain", "I+V"])
    task: Task = field(default_factory=Task)


@kinds.validated()
class StartingPolicySettings:
    """A file with a policy and its critics; results depend on what is in it."""

    policy: kinds.PathText | None = None
    policy_sha256: str | None = None  # filled in

    def __post_init__(self) -> None:
        self.policy_sha256 = None
        if self.policy is not None:
            if not Path(self.policy).is_file():
                raise ConfigurationError(
                    f"stage.policy={self.policy} is no file: give a policy.pt that was saved with critics"
                )
            self.policy_sha256 = hash_file(Path(self.policy))


# Have settings of their own, or follow from the task.
_ELSEWHERE = (
    "algorithm",
    "keys",
    "decisions",
    "device",
    "logger",
    "start_state_buffer_cases",
)


def with_hyperparameters(training: TrainingSettings, changes: Mapping[str, Any] | None) -> TrainingSettings:
    """A training with fields of `SacSettings` or `PpoSettings` changed, lists as tuples; None changes nothing."""
    if not changes:
        return training
    known = [field.name for field in fields(training) if field.name not in _ELSEWHERE]
    unknown = [name for name in changes if name not in known]
    if unknown:
        raise ConfigurationError(f"stage.training has no {unknown[0]!r}: choose from {', '.join(known)}")
    values: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value for name, value in changes.items()
    }
    try:
        return replace(training, **values)
    except ValueError as error:
        raise ConfigurationError(f"stage.training: {error}") from error
