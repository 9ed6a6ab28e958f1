"""Settings of the learning stages: baselines, Expert Navigation Network, imitation, force, unseen anatomies."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from pipeline.errors import ConfigurationError
from pipeline.setting_checks import NO_EFFECT_ON_RESULTS, require_choice, require_positive, require_unique

# What forces are predicted from: the image alone, the same without the loss on features, three images, and more.
FORCE_INPUTS = ("V", "V_plain", "V3", "V+M", "I+V", "I+V_action", "I")


@dataclass
class LearningSettings:
    """What the stages that train policies have in common: the task, the trainings' sizes, and how they are run."""

    phantoms: list[str] = field(default_factory=list)
    targets: list[str] = field(default_factory=list)
    seeds: int = 1  # trainings a row and task; run seed k trains with seeds k * seeds, k * seeds + 1, ...
    variant: str = "desk"  # networks and hyper-parameters: those that learn fast, or the thesis's
    decisions: int = 6_000  # budget of a training
    evaluation_episodes: int = 30  # deterministic ones, and as many stochastic ones
    demonstrations: bool = True  # desk: states along the sampling expert's episodes are starts of training episodes
    encoder_samples: int = 15_000  # desk: images that the encoder is fitted to
    encoder_epochs: int = 0  # 0: the encoder's own choice
    wire: str = "default"
    actions: str = "feeder"  # or tip_motors, the thesis's 21 actions
    image_size_px: int = 80
    max_steps: int = 300
    success_radius_mm: float = 8.0
    start_jitter_mm: float = 1.0
    start_rotation_deg: float = 180.0  # the wire starts turned by up to this much either way
    reward: str = "geodesic"  # of training; "distance" is the thesis's, which every table shows
    path_penalty: float = 0.0  # of the reward of training, a metre of the tip's way
    workers: int = field(default=0, metadata=NO_EFFECT_ON_RESULTS)  # trainings beside each other; 0: one a core
    tensorboard: bool = field(default=True, metadata=NO_EFFECT_ON_RESULTS)  # event files beside each training
    device: str = "cpu"  # of the networks, or cuda
    target: Any = None  # filled in by target=… and phantom.name=…: the only one
    phantom: Any = None

    def __post_init__(self) -> None:
        """Takes the sweep's keys over and checks counts, sizes and choices."""
        self.targets = [str(self.target)] if self.target is not None else self.targets
        self.phantoms = [str(self.phantom)] if self.phantom is not None else self.phantoms
        self.target = self.phantom = None  # so that a choice and the same list count as the same settings
        require_unique("stage.phantoms", self.phantoms)
        require_unique("stage.targets", self.targets)
        for key in ("seeds", "decisions", "evaluation_episodes", "image_size_px", "max_steps", "success_radius_mm",
                    "encoder_samples"):  # fmt: skip
            require_positive(f"stage.{key}", getattr(self, key))
        for key in ("workers", "start_jitter_mm", "start_rotation_deg", "encoder_epochs", "path_penalty"):
            if getattr(self, key) < 0:
                raise ConfigurationError(f"stage.{key} must be zero or more, got {getattr(self, key)}")
        require_choice("stage.variant", self.variant, ("desk", "thesis"))
        require_choice("stage.actions", self.actions, ("feeder", "tip_motors"))
        require_choice("stage.device", self.device, ("cpu", "cuda"))
        require_choice("stage.reward", self.reward, ("geodesic", "distance"))


@dataclass
class BaselinesSettings(LearningSettings):
    """Settings of the reinforcement learning baselines."""

    name: str = "baselines"
    algorithms: list[str] = field(default_factory=lambda: ["ppo", "sac"])
    observations: list[str] = field(default_factory=lambda: ["internal", "image", "sequential"])
    ppo_decisions: int = 60_000  # PPO's budget; `decisions` is SAC's
    path_follower: bool = True  # also the thesis's attempt to follow the planned path

    def __post_init__(self) -> None:
        """Checks the cells of the table."""
        super().__post_init__()
        require_unique("stage.algorithms", self.algorithms)
        require_unique("stage.observations", self.observations)
        for algorithm in self.algorithms:
            require_choice("stage.algorithms", algorithm, ("ppo", "sac"))
        for observation in self.observations:
            require_choice("stage.observations", observation, ("internal", "image", "sequential"))
        require_positive("stage.ppo_decisions", self.ppo_decisions)


@dataclass
class EnnSettings(LearningSettings):
    """Settings of the Expert Navigation Network and its ablation."""

    name: str = "enn"
    expert: str = "I+V+M"  # modality set of the row that later stages learn from
    modalities: list[str] = field(default_factory=list)  # the ablation's other rows
    ablation_phantoms: list[str] = field(default_factory=list)  # where those are trained
    ablation_seeds: int = 1
    safe_weights: list[float] = field(default_factory=list)  # of the force in the reward, 1/N: a row each, there too
    expert_episodes: int = 100  # with images, for imitation, of each task's first training of the expert row
    modality: Any = None  # filled in by modality=…: the only row, on every phantom

    def __post_init__(self) -> None:
        """Takes the sweep's key over and checks the rows."""
        super().__post_init__()
        if self.modality is not None:
            self.modalities, self.safe_weights = [str(self.modality)], []
            self.ablation_phantoms, self.ablation_seeds = list(self.phantoms), self.seeds
        require_unique("stage.modalities", [self.expert, *(m for m in self.modalities if m != self.expert)])
        if self.safe_weights:
            require_unique("stage.safe_weights", self.safe_weights)
        for weight in self.safe_weights:
            require_positive("stage.safe_weights", weight)
        if self.modalities or self.safe_weights:
            require_unique("stage.ablation_phantoms", self.ablation_phantoms)
        require_positive("stage.ablation_seeds", self.ablation_seeds)
        if self.expert_episodes < 0:
            raise ConfigurationError(f"stage.expert_episodes must be zero or more, got {self.expert_episodes}")


@dataclass
class ImitationSettings:
    """Settings of imitation: the expert's episodes of the stage enn, learnt from with the image alone."""

    name: str = "imitation"
    phantoms: list[str] = field(default_factory=list)
    targets: list[str] = field(default_factory=list)
    expert: str = "I+V+M"  # row of the stage enn whose episodes are learnt from
    variant: str = "desk"  # network and hyper-parameters: those that learn fast, or the thesis's
    observations: list[str] = field(default_factory=lambda: ["image"])  # that the student sees
    episodes: list[int] = field(default_factory=list)  # counts of expert episodes; the last is the table's
    disturbed_episodes: int = 0  # further ones, in which the expert's actions are disturbed: a row of its own
    dagger_rounds: int = 0  # 0: no DAgger
    dagger_episodes: int = 10  # a round
    feature_matching: float = 0.1  # weight of the distance to the expert's features
    epochs: int = 0  # 0: the variant's own number
    evaluation_episodes: int = 30
    workers: int = field(default=0, metadata=NO_EFFECT_ON_RESULTS)  # fits beside each other; 0: one a core

    def __post_init__(self) -> None:
        """Checks counts and choices."""
        require_unique("stage.phantoms", self.phantoms)
        require_unique("stage.targets", self.targets)
        require_unique("stage.episodes", self.episodes)
        require_unique("stage.observations", self.observations)
        for name in self.observations:
            require_choice("stage.observations", name, ("image", "mask"))
        require_choice("stage.variant", self.variant, ("desk", "thesis"))
        for count in self.episodes:
            require_positive("stage.episodes", count)
        if self.episodes != sorted(self.episodes):
            raise ConfigurationError(f"stage.episodes must rise, got {', '.join(map(str, self.episodes))}")
        for key in ("dagger_episodes", "evaluation_episodes"):
            require_positive(f"stage.{key}", getattr(self, key))
        for key in ("disturbed_episodes", "dagger_rounds", "epochs", "feature_matching", "workers"):
            if getattr(self, key) < 0:
                raise ConfigurationError(f"stage.{key} must be zero or more, got {getattr(self, key)}")


@dataclass
class ForceSettings:
    """Settings of force prediction: disturbed episodes of the expert, and networks of several amounts of samples."""

    name: str = "force"
    phantom: str = "type_1"
    targets: list[str] = field(default_factory=list)
    expert: str = "I+V+M"  # row of the stage enn whose policy steers
    variant: str = "desk"
    samples: list[int] = field(default_factory=list)  # to learn from; inputs beside the image are tried with the last
    test_samples: int = 4_000  # of episodes that are not learnt from
    noise: float = 0.3  # standard deviation added to the expert's actions
    spell_chance: float = 0.1  # that some steps of random, forward pushing begin
    epochs: int = 0  # 0: the variant's own number
    inputs: list[str] = field(default_factory=lambda: ["V"])  # V: the image alone, which the thesis has; see the stage
    workers: int = field(default=0, metadata=NO_EFFECT_ON_RESULTS)

    def __post_init__(self) -> None:
        """Checks counts and choices."""
        require_unique("stage.targets", self.targets)
        require_unique("stage.samples", self.samples)
        require_unique("stage.inputs", self.inputs)
        require_choice("stage.variant", self.variant, ("desk", "thesis"))
        for name in self.inputs:
            require_choice("stage.inputs", name, FORCE_INPUTS)
        if self.samples != sorted(self.samples):
            raise ConfigurationError(f"stage.samples must rise, got {', '.join(map(str, self.samples))}")
        for value in (*self.samples, self.test_samples):
            require_positive("stage.samples", value)
        for key in ("noise", "spell_chance", "epochs", "workers"):
            if getattr(self, key) < 0:
                raise ConfigurationError(f"stage.{key} must be zero or more, got {getattr(self, key)}")


@dataclass
class UnseenSettings:
    """Settings of the policies for anatomies that were never seen."""

    name: str = "unseen"
    targets: list[str] = field(default_factory=lambda: ["bca", "lcca"])  # of every policy
    anatomies: int = 32  # random arches that the roadmap policy is trained on
    curve: list[int] = field(default_factory=list)  # further numbers of arches, a policy each
    demonstrations: int = 12  # that the sampling expert tries, in as many arches
    decisions: int = 16_000  # of the roadmap policy's training
    curve_decisions: int = 8_000  # of those trained on fewer arches
    hidden: int = 256  # units of each of their two layers
    validation_anatomies: int = 16  # random arches, neither trained on nor tested, to keep the best policy by
    validation_episodes: int = 48  # in them
    image: bool = True  # also the student that sees images alone
    image_anatomies: int = 64  # arches that it is trained on
    segmenter_epochs: int = 50
    rounds: int = 6  # of lessons
    lessons: int = 90  # episodes a round
    epochs: int = 12  # over all lessons so far, a round
    test_anatomies: int = 50  # unseen random arches
    phantoms: list[str] = field(default_factory=list)  # named anatomies, none of them trained on
    named_episodes: int = 10  # on each, for each target
    mesh: str | None = None  # scanned anatomy; left out where the file is missing
    mesh_episodes: int = 20
    wires: list[str] = field(default_factory=list)  # further wires: presets, "softer", "stiffer"
    wire_anatomies: int = 10  # unseen arches that each is tried on
    wire_length_mm: float = 312.0  # reaches the targets of large arches
    image_size_px: int = 192
    max_steps: int = 300
    success_radius_mm: float = 8.0
    workers: int = field(default=0, metadata=NO_EFFECT_ON_RESULTS)  # jobs beside each other; 0: one a core
    tensorboard: bool = field(default=True, metadata=NO_EFFECT_ON_RESULTS)

    def __post_init__(self) -> None:
        """Checks counts and sizes."""
        require_unique("stage.targets", self.targets)
        for key in ("anatomies", "decisions", "curve_decisions", "hidden", "validation_anatomies",
                    "validation_episodes", "image_anatomies", "segmenter_epochs", "rounds", "lessons", "epochs",
                    "test_anatomies", "named_episodes", "mesh_episodes", "wire_anatomies", "wire_length_mm",
                    "image_size_px", "max_steps", "success_radius_mm"):  # fmt: skip
            require_positive(f"stage.{key}", getattr(self, key))
        for key in ("curve", "phantoms", "wires"):
            if getattr(self, key):
                require_unique(f"stage.{key}", getattr(self, key))
        for count in self.curve:
            require_positive("stage.curve", count)
        if self.demonstrations < 0:
            raise ConfigurationError(f"stage.demonstrations must be zero or more, got {self.demonstrations}")
        if max(self.test_anatomies, self.mesh_episodes) > 500:
            raise ConfigurationError("stage.test_anatomies and stage.mesh_episodes must not exceed 500")
        if self.workers < 0:
            raise ConfigurationError(f"stage.workers must be zero (one a core) or more, got {self.workers}")
