"""The registry of stages: what each reads, writes and depends on, found by name and imported only when it runs.

A stage is one module of this package with a ``STAGE``, or the module ``stage`` of a folder. Its name appears in
``STAGE_NAMES``, in the order in which the stages depend on each other; a name whose module is not there yet
is not offered.
"""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline.store.errors import ConfigurationError, StageError
from pipeline.store.run_folder import RunFolder

STAGE_NAMES = (
    "phantoms", "expert", "user_study", "validate", "baselines", "enn", "imitation", "force", "unseen", "guide3d",
    "shape", "segmentation", "splineformer", "navigation", "report",
)  # fmt: skip


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
        """The stage's own folder."""
        return self.folder.path


def no_check(settings: Any) -> None:
    """Accepts any settings: for stages whose settings dataclass says it all."""


def no_further_inputs(run_path: Path) -> dict[str, str]:
    """Depends on nothing beyond the stages it reads."""
    return {}


@dataclass(frozen=True)
class Stage:
    """A step from files to files."""

    name: str
    run: Callable[[Any, StageContext], None]  # settings, context
    reads: tuple[str, ...] = ()  # stages that must have finished
    writes: tuple[str, ...] = ()  # what lies in its folder afterwards
    check: Callable[[Any], None] = no_check  # refuses settings with a ConfigurationError before anything is written
    seeded: bool = True  # whether its results depend on the run's seed: then each seed has a folder of its own
    further_inputs: Callable[[Path], dict[str, str]] = no_further_inputs  # hashes of whatever else it reads


def available_stages() -> tuple[str, ...]:
    """Names the stages that this version has.

    Returns:
        Their names, in the order in which they depend on each other.
    """
    return tuple(name for name in STAGE_NAMES if importlib.util.find_spec(stage_module(name)) is not None)


def stage_module(name: str) -> str:
    """Import name of a stage's module: one of this package, or `stage` in the stage's own folder.

    Args:
        name: the stage's.
    """
    module = f"{__name__}.{name}"
    is_folder = (Path(__file__).parent / name).is_dir()
    return f"{module}.stage" if is_folder else module


def load_stage(name: str) -> Stage:
    """Imports one stage.

    Args:
        name: one of ``available_stages()``.

    Returns:
        The stage.

    Raises:
        ConfigurationError: for an unknown name; the message lists the valid ones.
        StageError: when the stage needs a package that is not installed.
    """
    known = available_stages()
    if name not in known:
        raise ConfigurationError(f"unknown stage {name!r}: choose one of {', '.join(known)}")
    try:
        module = importlib.import_module(stage_module(name))
    except ModuleNotFoundError as error:
        raise missing_module(name, error) from error
    stage: Stage = module.STAGE
    return stage


def missing_module(stage: str, error: ModuleNotFoundError) -> StageError:
    """Words the lack of a package.

    Args:
        stage: which stage needs it.
        error: what the import raised.

    Returns:
        The error to raise.
    """
    return StageError(f"stage {stage} needs the module {error.name!r}, which is not installed: run `make setup`")


__all__ = ["STAGE_NAMES", "Stage", "StageContext", "available_stages", "load_stage", "missing_module", "stage_module"]
