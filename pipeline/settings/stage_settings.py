"""Settings of the stages that learn nothing: the anatomies, the sampling expert, people, the validation, the report."""

from __future__ import annotations

from dataclasses import field
from pathlib import Path
from typing import Annotated

from annotated_types import Ge, Gt, Le

from pipeline.settings.checks import NO_EFFECT_ON_RESULTS, validated
from pipeline.settings.kinds import (
    UNIQUE,
    BranchNames,
    Count,
    CountOrNone,
    Episodes,
    FolderName,
    FolderNames,
    PathText,
    Processes,
    Seed,
    SomeFolderNames,
    SuccessRadius,
)
from pipeline.store.errors import ConfigurationError
from pipeline.store.provenance import hash_file
from pipeline.task import Task

COARSEST_RESOLUTION_MM = 2.5  # above it a carotid artery is no longer resolved


@validated()
class PhantomsSettings:
    """Settings of the phantoms stage."""

    name: str = "phantoms"
    phantoms: FolderNames = field(default_factory=list)  # named anatomies
    random_seeds: Annotated[list[Seed], UNIQUE] = field(default_factory=list)  # one random anatomy a seed
    resolution_mm: Annotated[float, Ge(0.1), Le(COARSEST_RESOLUTION_MM)] = 1.0  # spacing of the signed distance grid
    wall_thickness_mm: Annotated[float, Ge(0.1), Le(10)] = 1.5
    picture: bool = True
    mesh: PathText | None = None  # surface file of an anatomy of one's own, which is then the only one
    unit: str | None = None  # of that file
    names: BranchNames = None  # of its branches: a mapping from automatic names, or a list from the heart on
    mesh_sha256: str | None = None  # filled in: the results depend on the file, not on its path

    def __post_init__(self) -> None:
        """Checks that there is something to build, and reads the mesh."""
        self.mesh_sha256 = None
        if self.mesh is not None:
            if not Path(self.mesh).is_file():
                raise ConfigurationError(
                    f"phantom.mesh={self.mesh} is no file: give the path of an STL, OBJ or PLY file"
                )
            self.mesh_sha256 = hash_file(Path(self.mesh))
        elif self.unit is not None or self.names is not None:
            raise ConfigurationError("phantom.unit and phantom.names belong to a mesh: give phantom.mesh=PATH too")
        elif not self.phantoms and not self.random_seeds:
            raise ConfigurationError("stage.phantoms is empty: name at least one")


@validated()
class ExpertSettings:
    """Settings of the sampling expert's episodes."""

    name: str = "expert"
    phantoms: SomeFolderNames = field(default_factory=list)
    targets: SomeFolderNames = field(default_factory=list)
    episodes: Episodes = 1  # demonstrations a phantom and target, from starts that are not turned
    evaluation_episodes: Episodes = 1  # for the tables, from the starts and seeds of the policies compared with
    threads: Processes = field(default=0, metadata=NO_EFFECT_ON_RESULTS)  # of the search; 0: one a core
    task: Task = field(default_factory=Task)  # of the evaluation
    film: bool = True
    film_episodes: CountOrNone = 1  # films a phantom and target


@validated()
class UserStudySettings:
    """Settings of the sum of what people recorded at the console."""

    name: str = "user_study"
    max_steps: Count = 300  # procedures with another limit are not counted
    success_radius_mm: SuccessRadius = 8.0  # likewise


@validated()
class ValidateSettings:
    """Settings of the validation against real forces and theory."""

    name: str = "validate"
    phantom: FolderName = "type_1"  # that of the real experiments; its episodes are compared, and its speed is measured
    real_mean_n: Annotated[float, Gt(0), Le(100)] = 0.40  # normal distribution of the real forces
    real_sd_n: Annotated[float, Gt(0), Le(100)] = 0.19
    speed_steps: Count = 600  # an observation and round
    speed_rounds: Annotated[int, Ge(1), Le(100)] = 3
    physics: bool = True  # the wire against the theory of rods, most of a minute


@validated()
class ReportSettings:
    """Settings of the report."""

    name: str = "report"
    embed_limit_mb: Annotated[float, Ge(0), Le(1_000)] = 4.0  # larger pictures and films lie beside the page
