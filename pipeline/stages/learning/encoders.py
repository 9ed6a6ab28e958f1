"""Encoder jobs: those of a phantom are fitted to the same roll-outs, one for each set of observations.

Each is kept as ``encoders/<phantom>/<observations>.pt``, with its report beside it as JSON.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from enn.curves import Curves
from pipeline.jobs.worker import Report
from pipeline.stages.learning.expert_episodes import repeat
from pipeline.stages.learning.task import LearningTask
from pipeline.store.atomic_files import read_json, write_json

if TYPE_CHECKING:
    from enn.encoder import EncoderSettings, Samples

ENCODERS = "encoders"
_SAMPLES_SHARE = 0.4  # of the time that the first encoder takes
_NOWHERE_MM = 1e-3  # a radius that no tip comes into
_ACCURACY_OF_SAMPLES = "fast"  # an encoder learns shapes, and these it sees twice as fast
_NEVER = 100_000  # steps that no roll-out takes


@dataclass(frozen=True)
class EncodersJob:
    """The encoders of an anatomy to fit."""

    folder: Path  # where they go
    task: LearningTask  # whose anatomy they are to see; the target does not matter
    sets: tuple[tuple[str, ...], ...]  # observations of each
    settings: EncoderSettings  # of the fits; their seed is that of the roll-outs, too
    samples: int
    demonstrations: tuple[Path, ...]  # logs of an expert's episodes, along which some of the roll-outs start


def encoder_file(folder: Path, keys: tuple[str, ...]) -> Path:
    """File of the encoder of a set of observations, in the folder of its anatomy."""
    return folder / f"{'+'.join(keys)}.pt"


def fit_encoders(job: EncodersJob, report: Report) -> dict[str, dict[str, Any]]:
    """Fits the encoders of an anatomy that lack; file's stem to report, with ``wall_s``, roll-outs included."""
    from enn.encoder import fit_encoder

    files = {keys: encoder_file(job.folder, keys) for keys in job.sets}
    missing = [keys for keys, file in files.items() if not (file.is_file() and file.with_suffix(".json").is_file())]
    if missing:
        began = time.monotonic()
        share = _SAMPLES_SHARE / (_SAMPLES_SHARE + (1.0 - _SAMPLES_SHARE) * len(missing))
        samples = _samples(job, missing, report.part(0.0, share, "samples"))
        sampled_s = time.monotonic() - began
        for number, keys in enumerate(missing):
            began, file = time.monotonic(), files[keys]
            ends = [share + (1.0 - share) * (number + k) / len(missing) for k in range(2)]
            part = report.part(ends[0], ends[1], f"fit of {file.stem}")
            with Curves(job.folder / file.stem) as curves:
                progress = _progress(part, curves)
                encoder, fitted = fit_encoder(samples, keys, job.settings, progress, device=report.device)
            encoder.save(file)
            write_json(file.with_suffix(".json"), {**fitted, "wall_s": sampled_s + time.monotonic() - began})
    return {file.stem: read_json(file.with_suffix(".json")) for file in files.values()}


def _progress(part: Callable[[float, str], None], curves: Curves) -> Callable[[float, dict[str, float]], None]:
    epochs = itertools.count(1)

    def tell(done: float, errors: dict[str, float]) -> None:
        curves.add(next(epochs), **errors)
        part(done, "")

    return tell


def _samples(job: EncodersJob, sets: list[tuple[str, ...]], report: Callable[[float, str], None]) -> Samples:
    """Roll-outs with all observations that the sets name; they are the same whatever is observed."""
    from enn.encoder import scripted_samples
    from enn.exploration import TRUTH

    # No roll-out is to end at a target, nor at a limit: one encoder serves them all.
    endless = replace(job.task.task, success_radius_mm=_NOWHERE_MM, max_steps=_NEVER)
    task = replace(job.task, task=endless, accuracy=_ACCURACY_OF_SAMPLES)
    states = [trajectory.simulation_states for trajectory in repeat(job.demonstrations, job.task)]
    seen = tuple(dict.fromkeys(key for keys in sets for key in keys))
    return scripted_samples(
        task.factory(tuple(dict.fromkeys((*seen, *TRUTH)))),
        job.samples,
        job.settings.seed,
        starts=np.concatenate([one for one in states if one is not None]) if states else None,
        seen=seen,
        progress=lambda done, count: report(done / count, ""),
    )
