"""A rehearsal of seconds."""

from pathlib import Path
from typing import Any

from enn.shipped import weight_files
from pipeline.recording.trials import Origin
from pipeline.stages.rehearsal.copies import RehearsalJob
from pipeline.stages.rehearsal.settings import RehearsalSettings
from pipeline.task import Task

GENERALIST = next(file for file in weight_files() if file.stem == "generalist")
SIZES = {"copies": 1, "validation_copies": 1, "test_copies": 2, "scan_episodes": 1, "environments": 4, "hidden": 16}
TRAINING = {"decisions": 48, "further_trainings": 0, "accuracy": "fast", "fit_steps": False, "expert": "never"}
TINY: dict[str, Any] = SIZES | TRAINING | {"task": Task(start_rotation_deg=180.0, max_steps=12)}


def job_of(folder: Path, **changed: Any) -> RehearsalJob:
    """The job of such a rehearsal."""
    settings = RehearsalSettings(**TINY | changed)
    return RehearsalJob(folder, Origin("rehearsal", "after", 0, "smoke"), settings, settings.task, "bca")
