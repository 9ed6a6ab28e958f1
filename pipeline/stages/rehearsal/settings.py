"""Settings of the stage rehearsal: the scan, what may differ from it on the day, and the training."""

from __future__ import annotations

from dataclasses import field
from pathlib import Path
from typing import Annotated

from annotated_types import Ge, Le, Len

from pipeline.settings.checks import NO_EFFECT_ON_RESULTS, validated
from pipeline.settings.kinds import (
    BranchNames,
    Count,
    Decisions,
    Device,
    Episodes,
    FolderName,
    Hyperparameters,
    PathText,
    Processes,
    Seed,
    Units,
    Weight,
    one_of,
)
from pipeline.store.errors import ConfigurationError
from pipeline.store.provenance import hash_anatomy
from pipeline.task import DeviceSettings

_Millimetres = Annotated[float, Ge(0), Le(20)]
_Percent = Annotated[float, Ge(0), Le(90)]
_Coordinates = Annotated[list[float], Len(3, 3)]


@validated()
class RehearsalSettings(DeviceSettings):
    """Settings of a rehearsal; a wire of length 0 becomes as long as the way asks for, at least the preset."""

    name: str = "rehearsal"
    file: PathText | None = None  # of the patient's scan, as cathsim imports it
    unit: str | None = None  # of that file
    names: BranchNames = None  # of its branches
    phantom: FolderName | None = None  # without a file: a named anatomy, or "random"; null: type_1
    phantom_seed: Seed | None = None  # of a random one
    target: FolderName | None = None  # any of the anatomy's; null: lcca
    point_mm: _Coordinates | None = None  # a point in the lumen instead, world frame
    policy: PathText | None = None  # saved with critics, to start from; null: the stage unseen's, where it has one
    fresh: bool = False  # starts from nothing even where there is one
    walls_mm: _Millimetres = 1.0  # largest differences of a copy from the scan
    shift_mm: _Millimetres = 3.0
    turn_deg: Annotated[float, Ge(0), Le(30)] = 3.0
    stiffness_pct: _Percent = 30.0
    friction_pct: _Percent = 30.0
    breathing_mm: _Millimetres = 5.0
    breath_s: Annotated[float, Ge(0.5), Le(60)] = 4.0
    copies: Count = 16  # that are trained in, beside the scan
    validation_copies: Count = 15  # that choose the best policy, beside the scan
    test_copies: Annotated[int, Ge(1), Le(1000)] = 30
    scan_episodes: Episodes = 10  # on the scan itself
    mode: Annotated[str, one_of("stochastic", "deterministic")] = "stochastic"  # of the tests' actions
    algorithm: Annotated[str, one_of("sac", "ppo")] = "sac"
    decisions: Decisions = 12_000
    environments: Annotated[int, Ge(1), Le(1024)] = 16  # of the training
    hidden: Units = 256  # units of both layers, where it starts from nothing
    training: Hyperparameters = None  # hyper-parameters: fields of enn's TrainingSettings
    force_penalty: Weight = 0.1  # of the training's reward, a newton and step
    path_penalty: Weight = 40.0  # a metre of the tip's way
    accuracy: Annotated[str, one_of("accurate", "fast", "reference")] = "accurate"  # tests are accurate
    threads: Processes = field(default=0, metadata=NO_EFFECT_ON_RESULTS)  # that step the environments; 0: one a core
    workers: Processes = field(default=0, metadata=NO_EFFECT_ON_RESULTS)  # jobs beside each other; 0: one a core
    device: Device = field(default="cpu", metadata=NO_EFFECT_ON_RESULTS)
    file_sha256: str | None = None  # filled in, as the next: results depend on what is in the files
    policy_sha256: str | None = None

    def __post_init__(self) -> None:
        """Reads the files, and refuses what contradicts itself."""
        super().__post_init__()
        self.file_sha256 = _digest("phantom.file", self.file, "give the path of a surface or of a label volume")
        self.policy_sha256 = _digest("stage.policy", self.policy, "give a policy.pt that was saved with critics")
        if self.file is not None and (self.phantom is not None or self.phantom_seed is not None):
            raise ConfigurationError("phantom.file brings the anatomy: leave out phantom.name and stage.phantom_seed")
        if self.file is None and (self.unit is not None or self.names is not None):
            raise ConfigurationError("phantom.unit and phantom.names belong to a file: give phantom.file=PATH too")
        if self.target is not None and self.point_mm is not None:
            raise ConfigurationError("stage.point_mm is the target: leave out target")
        if self.policy is not None and self.fresh:
            raise ConfigurationError("stage.fresh=true starts from nothing: leave out stage.policy")


def _digest(setting: str, path: str | None, advice: str) -> str | None:
    if path is None:
        return None
    if not Path(path).exists():
        raise ConfigurationError(f"{setting}={path} is no file: {advice}")
    return hash_anatomy(Path(path))
