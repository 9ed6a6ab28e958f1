"""A rehearsal of seconds."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from enn.shipped import weight_files
from pipeline.jobs.worker import Report
from pipeline.recording.trials import Origin
from pipeline.stages.rehearsal.copies import RehearsalJob
from pipeline.stages.rehearsal.settings import RehearsalSettings
from pipeline.stages.rehearsal.training import PARTS, nothing_to_record, record_demonstrations
from pipeline.task import Task

GENERALIST = next(file for file in weight_files() if file.stem == "generalist")
SIZES = {"copies": 1, "validation_copies": 1, "test_copies": 2, "scan_episodes": 1, "environments": 4, "hidden": 16}
TRAINING = {"decisions": 48, "further_trainings": 0, "accuracy": "fast", "fit_steps": False, "expert": "never"}
TINY: dict[str, Any] = SIZES | TRAINING | {"task": Task(start_rotation_deg=180.0, max_steps=12)}


def job_of(folder: Path, **changed: Any) -> RehearsalJob:
    """The job of such a rehearsal."""
    settings = RehearsalSettings(**TINY | changed)
    return RehearsalJob(folder, Origin("rehearsal", "after", 0, "smoke"), settings, settings.task, "bca")


def all_demonstrations(job: RehearsalJob) -> dict[str, list[int]]:
    """Every turn of a rehearsal's demonstrations: by policy, episodes played and arrived."""
    told: dict[str, list[int]] = {}
    for turn in range(job.rules.most_turns(len(job.demonstrators))):
        given = [replace(job, turn=turn, part=part) for part in range(PARTS)]
        if any(nothing_to_record(one) is not None for one in given):
            break
        for outcome in [record_demonstrations(one, Report()) for one in given]:
            for name, counts in outcome.items():
                told[name] = [a + b for a, b in zip(told.get(name, [0, 0]), counts, strict=True)]
    return told
