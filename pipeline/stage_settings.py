"""Settings of the stages that learn nothing: the anatomies, the sampling expert, people, the validation, the report."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pipeline.errors import ConfigurationError
from pipeline.provenance import hash_file
from pipeline.setting_checks import NO_EFFECT_ON_RESULTS, require_positive, require_unique

COARSEST_RESOLUTION_MM = 2.5


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
