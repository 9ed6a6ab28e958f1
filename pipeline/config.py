"""The configuration of a run: dataclasses that own its names, types, defaults and cross-checks.

They live in an importable module, not in ``__main__``, because the sweep launchers pickle them. YAML under ``conf/``
only chooses values. OmegaConf knows no Literal and turns tuples into lists: choices are checked in ``__post_init__``.
"""

from __future__ import annotations

import dataclasses
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hydra.core.config_store import ConfigStore
from omegaconf import MISSING, DictConfig, OmegaConf

from pipeline.errors import ConfigurationError
from pipeline.provenance import hash_file

CONFIG_DIRECTORY = Path(__file__).resolve().parent.parent / "conf"
COARSEST_RESOLUTION_MM = 2.5
BUDGETS = ("smoke", "desk", "thesis")
# What forces are predicted from: the image alone, the same without the loss on features, three images, and more.
FORCE_INPUTS = ("V", "V_plain", "V3", "V+M", "I+V", "I+V_action", "I")

# Metadata of a setting that changes how fast results come, never what they are: it stays out of the hash.
NO_EFFECT_ON_RESULTS = {"affects_results": False}

_RUN_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._+-]*")


def require_positive(name: str, value: float) -> None:
    """Refuses a setting that is not above zero.

    Args:
        name: the setting as the user writes it, e.g. ``stage.episodes``.
        value: what was given.

    Raises:
        ConfigurationError: when ``value`` is not a positive finite number.
    """
    if not 0 < value < float("inf"):
        raise ConfigurationError(f"{name} must be above zero, got {value}")


def require_unique(name: str, values: list[Any]) -> None:
    """Refuses an empty list or one that names something twice.

    Args:
        name: the setting as the user writes it.
        values: what was given.

    Raises:
        ConfigurationError: when the list is empty or holds a repeated entry.
    """
    if not values:
        raise ConfigurationError(f"{name} is empty: name at least one")
    if len(set(values)) != len(values):
        raise ConfigurationError(f"{name} names something twice: {', '.join(map(str, values))}")


def require_choice(name: str, value: str, choices: tuple[str, ...]) -> None:
    """Refuses a setting that is none of the choices.

    Args:
        name: the setting as the user writes it.
        value: what was given.
        choices: what may be given.

    Raises:
        ConfigurationError: listing the choices.
    """
    if value not in choices:
        raise ConfigurationError(f"{name} has no {value!r}: choose from {', '.join(choices)}")


@dataclass
class PhantomsSettings:
    """Settings of the phantoms stage."""

    name: str = "phantoms"
    phantoms: list[str] = field(default_factory=list)  # named anatomies
    random_seeds: list[int] = field(default_factory=list)  # one random anatomy a seed
    resolution_mm: float = 1.0  # spacing of the signed distance grid
    wall_thickness_mm: float = 1.5
    picture: bool = True
    mesh: str | None = None  # surface file of an anatomy of one's own, which is then the only one
    unit: str | None = None  # of that file
    names: Any = None  # of its branches: a mapping from automatic names, or a list from the heart on
    mesh_sha256: str | None = None  # filled in: the results depend on the file, not on its path

    def __post_init__(self) -> None:
        """Checks the sizes and that there is something to build."""
        self.mesh_sha256 = None
        if self.mesh is not None:
            if not Path(self.mesh).is_file():
                raise ConfigurationError(
                    f"phantom.mesh={self.mesh} is no file: give the path of an STL, OBJ or PLY file"
                )
            self.mesh_sha256 = hash_file(Path(self.mesh))
        elif self.unit is not None or self.names is not None:
            raise ConfigurationError("phantom.unit and phantom.names belong to a mesh: give phantom.mesh=PATH too")
        elif not self.random_seeds:
            require_unique("stage.phantoms", self.phantoms)
        require_positive("stage.resolution_mm", self.resolution_mm)
        if self.resolution_mm > COARSEST_RESOLUTION_MM:
            raise ConfigurationError(
                f"stage.resolution_mm is {self.resolution_mm}: above {COARSEST_RESOLUTION_MM} mm a carotid artery is "
                "no longer resolved"
            )
        require_positive("stage.wall_thickness_mm", self.wall_thickness_mm)


@dataclass
class ExpertSettings:
    """Settings of the sampling expert's episodes."""

    name: str = "expert"
    phantoms: list[str] = field(default_factory=list)
    targets: list[str] = field(default_factory=list)
    episodes: int = 1  # a phantom and target
    threads: int = field(default=0, metadata=NO_EFFECT_ON_RESULTS)  # of the search; 0: one a core
    max_steps: int = 300
    success_radius_mm: float = 8.0
    wire: str = "default"
    image_size_px: int = 80
    film: bool = True
    film_episodes: int = 1  # films a phantom and target

    def __post_init__(self) -> None:
        """Checks counts and sizes."""
        require_unique("stage.phantoms", self.phantoms)
        require_unique("stage.targets", self.targets)
        for key in ("episodes", "max_steps", "success_radius_mm", "image_size_px"):
            require_positive(f"stage.{key}", getattr(self, key))
        if self.threads < 0:
            raise ConfigurationError(f"stage.threads must be zero (one a core) or more, got {self.threads}")


@dataclass
class UserStudySettings:
    """Settings of the sum of what people recorded at the console."""

    name: str = "user_study"
    max_steps: int = 300  # procedures with another limit are not counted
    success_radius_mm: float = 8.0  # likewise

    def __post_init__(self) -> None:
        """Checks the limits."""
        require_positive("stage.max_steps", self.max_steps)
        require_positive("stage.success_radius_mm", self.success_radius_mm)


@dataclass
class ValidateSettings:
    """Settings of the validation against real forces and theory."""

    name: str = "validate"
    phantom: str = "type_1"  # that of the real experiments; its episodes are compared, and its speed is measured
    real_mean_n: float = 0.40  # normal distribution of the real forces
    real_sd_n: float = 0.19
    speed_steps: int = 600  # an observation and round
    speed_rounds: int = 3
    physics: bool = True  # the wire against the theory of rods, most of a minute

    def __post_init__(self) -> None:
        """Checks the distribution and the sizes."""
        for key in ("real_mean_n", "real_sd_n", "speed_steps", "speed_rounds"):
            require_positive(f"stage.{key}", getattr(self, key))


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
    workers: int = field(default=0, metadata=NO_EFFECT_ON_RESULTS)  # trainings beside each other; 0: one a core
    tensorboard: bool = field(default=True, metadata=NO_EFFECT_ON_RESULTS)  # event files beside each training
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
        for key in ("workers", "start_jitter_mm", "start_rotation_deg", "encoder_epochs"):
            if getattr(self, key) < 0:
                raise ConfigurationError(f"stage.{key} must be zero or more, got {getattr(self, key)}")
        require_choice("stage.variant", self.variant, ("desk", "thesis"))
        require_choice("stage.actions", self.actions, ("feeder", "tip_motors"))


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
    decisions: int = 16_000  # of a roadmap policy's training
    validation_episodes: int = 16  # in training anatomies, to keep the best policy
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
        for key in ("anatomies", "decisions", "validation_episodes", "image_anatomies", "segmenter_epochs", "rounds",
                    "lessons", "epochs", "test_anatomies", "named_episodes", "mesh_episodes", "wire_anatomies",
                    "wire_length_mm", "image_size_px", "max_steps", "success_radius_mm"):  # fmt: skip
            require_positive(f"stage.{key}", getattr(self, key))
        for key in ("curve", "phantoms", "wires"):
            if getattr(self, key):
                require_unique(f"stage.{key}", getattr(self, key))
        for count in self.curve:
            require_positive("stage.curve", count)
        if max(self.test_anatomies, self.mesh_episodes) > 500:
            raise ConfigurationError("stage.test_anatomies and stage.mesh_episodes must not exceed 500")
        if self.workers < 0:
            raise ConfigurationError(f"stage.workers must be zero (one a core) or more, got {self.workers}")


@dataclass
class ReportSettings:
    """Settings of the report."""

    name: str = "report"
    embed_limit_mb: float = 4.0  # larger pictures and films lie beside the page instead of inside it

    def __post_init__(self) -> None:
        """Checks the limit."""
        if self.embed_limit_mb < 0:
            raise ConfigurationError(f"stage.embed_limit_mb must not be negative, got {self.embed_limit_mb}")


# Every stage's settings, by the stage's name.
STAGE_SETTINGS: dict[str, type] = {
    "phantoms": PhantomsSettings,
    "expert": ExpertSettings,
    "user_study": UserStudySettings,
    "validate": ValidateSettings,
    "baselines": BaselinesSettings,
    "enn": EnnSettings,
    "imitation": ImitationSettings,
    "force": ForceSettings,
    "unseen": UnseenSettings,
    "report": ReportSettings,
}


@dataclass
class OwnPhantom:
    """An anatomy of one's own by ``phantom.mesh=PATH``, or the only one to learn in by ``phantom.name=NAME``."""

    name: str | None = None  # of the learning stages' only anatomy
    mesh: str | None = None  # STL, OBJ or PLY
    unit: str | None = None  # m, cm, mm or inch; detected when left out
    names: Any = None


@dataclass
class RunConfig:
    """One run of one stage."""

    stage: Any = MISSING  # one of the settings above
    phantom: OwnPhantom = field(default_factory=OwnPhantom)
    target: str | None = None  # the only target of the learning stages: made for sweeps, target=bca,lcca
    modality: str | None = None  # the only modality set of the stage enn: modality=I,V,I+V+M
    budget: dict[str, Any] = field(default_factory=dict)  # conf/budget/*.yaml: sizes that the stages refer to
    name: str = "${budget.name}"  # the run folder below runs_dir
    runs_dir: str = "runs"
    seed: int = 0
    force: bool = False  # run even when the results are up to date

    def __post_init__(self) -> None:
        """Checks the name, which becomes a folder, and the seed."""
        if not _RUN_NAME.fullmatch(self.name):
            raise ConfigurationError(
                f"name={self.name!r} cannot be a folder: use letters, digits, '.', '_', '+' and '-', beginning with "
                "a letter or digit"
            )
        if self.seed < 0:
            raise ConfigurationError(f"seed must be zero or more, got {self.seed}")

    @property
    def budget_name(self) -> str:
        """The budget's name, e.g. ``desk``."""
        return str(self.budget.get("name", "unnamed"))


def settings_that_matter(settings: Any) -> dict[str, Any]:
    """Lists a stage's settings without those that cannot change its results.

    Args:
        settings: a stage's settings dataclass.

    Returns:
        Field name to value.
    """
    return {
        item.name: getattr(settings, item.name)
        for item in dataclasses.fields(settings)
        if item.metadata.get("affects_results", True)
    }


def register_schemas() -> None:
    """Makes the dataclasses known to Hydra, so that a wrong key or type is refused when the configuration is composed.

    The stages' schemas sit in a group of their own: in ``stage`` they would show up as stages a user can choose.
    """
    store = ConfigStore.instance()
    store.store(name="schema", node=RunConfig)
    for name, settings in STAGE_SETTINGS.items():
        store.store(group="schema/stage", name=name, node=settings)


def run_config(composed: DictConfig) -> RunConfig:
    """Turns Hydra's composed configuration into checked dataclasses.

    Args:
        composed: the configuration as Hydra hands it over, without its own ``hydra`` node.

    Returns:
        The run configuration; ``stage`` is the stage's settings dataclass.

    Raises:
        ConfigurationError: when a value fails a check; the message is one sentence.
    """
    config = OmegaConf.to_object(composed)
    if not isinstance(config, RunConfig):
        raise ConfigurationError(
            "the configuration was composed without its schema: keep `- schema` in conf/config.yaml"
        )
    # `+key=value` adds keys past the schema: refused here, or a misspelt setting would pass unnoticed.
    for prefix, node, owner in (("", composed, RunConfig), ("stage.", composed.stage, type(config.stage))):
        names = [item.name for item in dataclasses.fields(owner)]
        extra = [str(key) for key in node if key not in names]
        if extra:
            raise ConfigurationError(f"unknown setting {prefix + extra[0]!r}: choose one of {', '.join(names)}")
    return config
