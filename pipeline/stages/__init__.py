"""The registry of stages; a stage is imported only when it is chosen.

A stage is ``conf/stage/<name>.yaml``, a module of this package that ends with ``STAGE = Stage(...)``, and a line below.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline.printing import installing
from pipeline.store.errors import ConfigurationError, StageError
from pipeline.store.run_folder import RunFolder
from pipeline.tables import Results

# The stages, each after those that it reads: module, and module and class of its settings, below this package.
_STAGES = {
    "phantoms": ("phantoms", "phantoms:PhantomsSettings"),
    "expert": ("expert", "expert:ExpertSettings"),
    "user_study": ("user_study", "user_study:UserStudySettings"),
    "validate": ("validate", "validate:ValidateSettings"),
    "baselines": ("baselines", "learning.settings:BaselinesSettings"),
    "enn": ("enn", "learning.settings:EnnSettings"),
    "imitation": ("imitation", "learning.settings:ImitationSettings"),
    "force": ("force", "learning.settings:ForceSettings"),
    "unseen": ("unseen.stage", "unseen.settings:UnseenSettings"),
    "guide3d": ("guide3d.stage", "guide3d.settings:Guide3dSettings"),
    "rehearsal": ("rehearsal.stage", "rehearsal.settings:RehearsalSettings"),
    "shape": ("shape", "networks.settings:ShapeSettings"),
    "segmentation": ("segmentation", "networks.settings:SegmentationSettings"),
    "splineformer": ("splineformer", "networks.settings:SplineformerSettings"),
    "navigation": ("navigation.stage", "navigation.settings:NavigationSettings"),
    "report": ("report", "report:ReportSettings"),
}


@dataclass(frozen=True)
class StageContext:
    """What a stage is given beside its settings."""

    folder: RunFolder  # where it writes; also lends resumable items
    run_path: Path  # runs/<name>
    inputs: dict[str, Path]  # earlier stage -> its folder
    budget: str
    seed: int

    @property
    def path(self) -> Path:
        return self.folder.path


@dataclass(frozen=True)
class Stage:
    """A step from files to files."""

    settings: type  # declared with `validated`; its field `name` is the stage's name
    run: Callable[[Any, StageContext], Results | None]  # settings, context; None: nothing to show
    version: int = 1  # raised by hand where the same settings and inputs give results of another meaning
    reads: tuple[str, ...] = ()  # stages that must have finished
    prepare: Callable[[Any], None] = lambda settings: None  # fills in what only reading files tells, before `check`
    # refuses settings with a ConfigurationError before anything is written
    check: Callable[[Any], None] = lambda settings: None
    seeded: bool = True  # whether its results depend on the run's seed: then each seed has a folder of its own
    repeated: bool = False  # whether a chain over several seeds repeats it: its figures differ from seed to seed
    # Gives hashes of whatever else the stage reads in the run's folder.
    further_inputs: Callable[[Path], dict[str, str]] = lambda run_path: {}
    uses: tuple[str, ...] = ()  # stages whose results it takes where they are there
    gathers: bool = False  # whether it reads whatever has finished: in a chain it waits for all before it

    @property
    def name(self) -> str:
        return str(self.settings.name)  # type: ignore[attr-defined]


def available_stages() -> tuple[str, ...]:
    """Names all stages, each after those that it reads."""
    return tuple(_STAGES)


def load_stage(name: str) -> Stage:
    stage: Stage = _imported(name, 0)
    return stage


def settings_of(name: str) -> type:
    """The dataclass of a stage's settings; where a module beside the stage declares it, the stage is not imported."""
    settings: type = _imported(name, 1)
    return settings


def missing_module(stage: str, error: ModuleNotFoundError) -> StageError:
    """The error to raise where a stage needs a package that is not installed."""
    return StageError(
        f"stage {stage} needs the module {error.name!r}, which is not installed: run `{installing('make setup')}`"
    )


def _imported(stage: str, place: int) -> Any:
    if stage not in _STAGES:
        raise ConfigurationError(f"unknown stage {stage!r}: choose one of {', '.join(_STAGES)}")
    module, _, name = _STAGES[stage][place].partition(":")
    try:
        return getattr(importlib.import_module(f"{__name__}.{module}"), name or "STAGE")
    except ModuleNotFoundError as error:
        raise missing_module(stage, error) from error
