"""Execution of one stage: checks, lock, up-to-date test, work, manifest."""

from __future__ import annotations

import importlib.util
import logging
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from enn import curves
from enn.reinforcement.resources import available_bytes
from pipeline.config import RunConfig, anatomy_not_taken
from pipeline.jobs.engines.local import variables_set
from pipeline.jobs.engines.settings import JOBS, LOCAL
from pipeline.jobs.machine import CPU, check_device
from pipeline.jobs.pool import chosen_engine
from pipeline.recording import training_films
from pipeline.settings.kinds import settings_that_matter
from pipeline.stages import Stage, StageContext, load_stage, missing_module
from pipeline.store.costs import OWN_PROCESS, CostMeter, keep_cost
from pipeline.store.errors import ConfigurationError, StageError
from pipeline.store.manifest import Identity, read_manifest
from pipeline.store.provenance import hash_value, present_commit
from pipeline.store.run_folder import RunFolder
from pipeline.store.variants import RunRequest, effective_overrides, require_input, variant_of
from pipeline.task import Task, device_files

_LOGGER = logging.getLogger(__name__)


def execute(config: RunConfig, *, overrides: Sequence[str] = (), in_sweep: bool = False) -> None:
    """Runs one stage, or finds it up to date; a sweep's job has a folder named after its overrides."""
    stage = load_stage(config.stage.name)
    stage.prepare(config.stage)
    stage.check(config.stage)
    if unused := anatomy_not_taken(config):
        _LOGGER.warning("%s is not for the stage %s: it has anatomies of its own", ", ".join(unused), stage.name)
    if config.logger == "wandb" and importlib.util.find_spec("wandb") is None:
        raise ConfigurationError("logger=wandb needs the module wandb: pip install 'endonav[wandb]'")
    if config.engine is None or config.engine.name == LOCAL:
        check_device(getattr(config.stage, "device", CPU))  # every stage with networks has one
    run_path = Path(config.runs_dir) / config.name
    request = RunRequest(tuple(overrides), in_sweep, config.seed, config.budget_name)
    inputs = {name: require_input(run_path, name, stage.name, request) for name in stage.reads}
    identity = _identity(stage, config, run_path, {path.name: record.outputs_hash for path, record in inputs.values()})
    variant = request.variant(seeded=stage.seeded)
    folder = RunFolder(run_path / "@".join([stage.name, *([variant_of(variant)] if variant else [])]), identity)
    with folder.locked():
        if (folder.path / JOBS).is_dir():
            from pipeline.jobs.engines.cluster import end_earlier_jobs

            end_earlier_jobs(folder.path)
        if not config.force and folder.is_up_to_date():
            _LOGGER.info("%s: up to date in %s%s", stage.name, folder.path, _other_commits(folder.path))
            return
        count = folder.prepare(force=config.force)
        _LOGGER.info("%s: working in %s%s", stage.name, folder.path, f", {count} finished items kept" if count else "")
        started, meter = time.monotonic(), CostMeter()
        context = StageContext(
            folder=folder, run_path=run_path, inputs={name: path for name, (path, _) in inputs.items()},
            budget=config.budget_name, seed=config.seed,
        )  # fmt: skip
        try:
            with chosen_engine(config.engine, available_bytes), variables_set(observation_of_trainings(config)):
                results = stage.run(config.stage, context)
            if results is not None:
                results.write(folder.path)
        except ModuleNotFoundError as error:  # packages import their heavier dependencies where they need them
            raise missing_module(stage.name, error) from error
        except ImportError as error:  # e.g. native code that was built from other sources; it says what to do
            raise StageError(str(error)) from error
        keep_cost(folder.path, OWN_PROCESS, meter.read())
        manifest = folder.finish(
            stage=stage.name, run=config.name, budget=config.budget_name, seed=config.seed,
            config=asdict(config.stage), started=started, overrides=effective_overrides(overrides), variant=variant,
        )  # fmt: skip
        _LOGGER.info("%s: done in %.1f s, %d files", stage.name, manifest.wall_time_s, len(manifest.outputs))


def observation_of_trainings(config: RunConfig) -> dict[str, str]:
    """Variables that say, in this process and in jobs', how trainings are observed; no result depends on them."""
    return {curves.CHOICE: config.logger, training_films.CHOICE: str(config.films)}


def _identity(stage: Stage, config: RunConfig, run_path: Path, input_hashes: dict[str, str]) -> Identity:
    settings: dict[str, Any] = {"settings": settings_that_matter(config.stage), "budget": config.budget_name}
    if stage.seeded:
        settings["seed"] = config.seed
    task = getattr(config.stage, "task", None)
    files = device_files(task) if isinstance(task, Task) else {}
    return Identity(
        config_hash=hash_value(settings),
        input_hashes={**input_hashes, **files, **stage.further_inputs(run_path)},
        version=stage.version,
    )


def _other_commits(folder: Path) -> str:
    """What to say of results that other code made: a version that nobody raised says that they mean the same."""
    manifest, present = read_manifest(folder), present_commit()
    others = [commit for commit in (manifest.commits if manifest else ()) if commit != present]
    return (
        f", made by commit {', '.join(others)}, the code is at {present} (force=true makes it again)" if others else ""
    )
