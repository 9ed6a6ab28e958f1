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
    "report": ReportSettings,
}


@dataclass
class OwnPhantom:
    """An anatomy of one's own: ``phantom.mesh=PATH`` on the command line."""

    mesh: str | None = None  # STL, OBJ or PLY
    unit: str | None = None  # m, cm, mm or inch; detected when left out
    names: Any = None


@dataclass
class RunConfig:
    """One run of one stage."""

    stage: Any = MISSING  # one of the settings above
    phantom: OwnPhantom = field(default_factory=OwnPhantom)
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
