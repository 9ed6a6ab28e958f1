"""Execution of one stage: checks, lock, up-to-date test, work, manifest."""

from __future__ import annotations

import enum
import hashlib
import logging
import re
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pipeline.artifacts import Identity, RunFolder, require_input
from pipeline.config import RunConfig
from pipeline.errors import StageError
from pipeline.provenance import hash_sources, hash_value
from pipeline.setting_checks import settings_that_matter
from pipeline.stages import Stage, StageContext, load_stage, missing_module

_LOGGER = logging.getLogger(__name__)

_LONGEST_VARIANT = 100
# Overrides that already choose the folder, or cannot change a result.
_NOT_IN_VARIANT = {"stage", "name", "runs_dir", "force"}


class Outcome(enum.Enum):
    """How a run of a stage ended."""

    DONE = "done"
    UP_TO_DATE = "up to date"


def variant_of(overrides: list[str]) -> str:
    """Names a sweep job after its overrides, so that no two jobs share a folder.

    Args:
        overrides: the job's task overrides, e.g. ``["stage=phantoms", "seed=1"]``.

    Returns:
        For example ``seed=1``; empty when no override distinguishes the job. Long ones are cut and hashed.
    """
    parts = sorted(o.lstrip("+~") for o in overrides if o.lstrip("+~").split("=", 1)[0] not in _NOT_IN_VARIANT)
    full = ",".join(parts)
    readable = re.sub(r"[^A-Za-z0-9_.=,+-]", "_", full)
    if readable == full and len(full) <= _LONGEST_VARIANT:
        return full
    # Replaced characters and cut ends could make two jobs look alike: the hash keeps them apart.
    return f"{readable[:_LONGEST_VARIANT]}-{hashlib.sha256(full.encode()).hexdigest()[:8]}"


def execute(config: RunConfig, *, variant: str = "") -> Outcome:
    """Runs one stage, or finds that its results are up to date.

    Args:
        config: the run.
        variant: name of the sweep job; empty outside a sweep.

    Returns:
        How it ended.

    Raises:
        PipelineError: when a setting, an input or the folder stands in the way; the message is one sentence.
    """
    stage = load_stage(config.stage.name)
    stage.check(config.stage)
    run_path = Path(config.runs_dir) / config.name
    inputs = {name: require_input(run_path, name, stage.name) for name in stage.reads}
    identity = _identity(
        stage, config, run_path, {name: manifest.outputs_hash for name, (_, manifest) in inputs.items()}
    )
    folder = RunFolder(run_path / (f"{stage.name}@{variant}" if variant else stage.name), identity)
    with folder.locked():
        if not config.force and folder.is_up_to_date():
            _LOGGER.info("%s: up to date in %s", stage.name, folder.path)
            return Outcome.UP_TO_DATE
        kept = folder.prepare(force=config.force)
        _LOGGER.info("%s: working in %s%s", stage.name, folder.path, f", {kept} finished items kept" if kept else "")
        started = time.monotonic()
        context = _context(config, folder, run_path, {name: path for name, (path, _) in inputs.items()})
        try:
            stage.run(config.stage, context)
        except ModuleNotFoundError as error:  # packages import their heavier dependencies where they need them
            raise missing_module(stage.name, error) from error
        except ImportError as error:  # e.g. native code that was built from other sources; it says what to do
            raise StageError(str(error)) from error
        manifest = folder.finish(
            stage=stage.name, run=config.name, budget=config.budget_name, seed=config.seed,
            config=asdict(config.stage), started=started,
        )  # fmt: skip
        _LOGGER.info("%s: done in %.1f s, %d files", stage.name, manifest.wall_time_s, len(manifest.outputs))
    return Outcome.DONE


def _identity(stage: Stage, config: RunConfig, run_path: Path, input_hashes: dict[str, str]) -> Identity:
    settings: dict[str, Any] = {
        "settings": settings_that_matter(config.stage),
        "seed": config.seed,
        "budget": config.budget_name,
    }
    return Identity(
        config_hash=hash_value(settings),
        input_hashes={**input_hashes, **stage.further_inputs(run_path)},
        code_hash=hash_sources((f"pipeline.stages.{stage.name}", *stage.code)),
    )


def _context(config: RunConfig, folder: RunFolder, run_path: Path, inputs: dict[str, Path]) -> StageContext:
    return StageContext(
        folder=folder, run_path=run_path, inputs=inputs, budget=config.budget_name, seed=config.seed
    )  # fmt: skip
