"""Reads all evaluations of a run: many logs in parallel, damaged ones left out, metrics of known ones from a cache."""

from __future__ import annotations

import logging
import os
import signal
from collections.abc import Iterator, Sequence
from concurrent.futures import BrokenExecutor, ProcessPoolExecutor
from dataclasses import asdict, dataclass, field
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from pipeline.report.learning.logs import COMPARED, DEMONSTRATION, Evaluation, UnusableLogError, read_evaluation
from pipeline.store.atomic_files import read_json, write_json
from pipeline.store.interruption import stop_if_asked
from pipeline.store.source_closure import SourceClosure

CACHE = Path(".cache", "learning.json")  # below the run: a stage's own folder is emptied when it runs again
PARALLEL_FROM = 200  # logs; fewer are read sooner than processes start

_LOGGER = logging.getLogger(__name__)


@dataclass
class EvaluationSet:
    """The evaluations of a run.

    Attributes:
        evaluations: one for each log that counts, in the order of their paths.
        left_out: log -> why it does not count.
    """

    evaluations: list[Evaluation] = field(default_factory=list)
    left_out: dict[str, str] = field(default_factory=dict)


def read_logs(folders: Sequence[Path], *, cache: Path | None = None, processes: int | None = None) -> EvaluationSet:
    """Reads every log below stage folders of one run; one that cannot be used is left out with a warning.

    Args:
        folders: stage folders, children of the run's folder.
        cache: file that keeps metrics between calls; a log counts as known while its size and time stay.
        processes: that read in parallel when there is much to read; by default one a core.

    Returns:
        The evaluations. Of logs of the same episode of the same policy the latest counts.
    """
    from pipeline.episodes import EpisodeReadError

    runs = {path: folder.parent for folder in folders for path in sorted(folder.rglob("*.mcap"))}
    kept = _MetricsCache(cache)
    known = {path: kept.recall(path, run) for path, run in runs.items()}
    new = [path for path in runs if known[path] is None]
    found = EvaluationSet()
    for path, result in zip(new, _read_all([(path, runs[path]) for path in new], processes), strict=True):
        if isinstance(result, Evaluation):
            known[path] = result
            kept.keep(path, result)
            continue
        name = path.relative_to(runs[path]).as_posix()
        found.left_out[name] = str(result)
        words = str(result) if isinstance(result, EpisodeReadError) else f"{path}: {result}"
        _LOGGER.warning("left out: %s", words)
    kept.save()
    found.evaluations = _latest([one for path in runs if (one := known[path]) is not None], found.left_out)
    return found


def _read_one(job: tuple[Path, Path]) -> Evaluation | ValueError:
    from pipeline.episodes import EpisodeReadError

    try:
        return read_evaluation(*job)
    except (EpisodeReadError, UnusableLogError) as error:
        return error
    except (AttributeError, IndexError, KeyError, OverflowError, TypeError, ValueError) as error:
        # checksums are right, so another program wrote what no version of this one would
        return UnusableLogError(f"what it says cannot be used ({type(error).__name__}: {error})")


def _read_all(jobs: list[tuple[Path, Path]], processes: int | None) -> Iterator[Evaluation | ValueError]:
    count = min(processes or len(os.sched_getaffinity(0)), 1 + len(jobs) // PARALLEL_FROM)
    done = 0
    if count > 1:
        pool = ProcessPoolExecutor(count, mp_context=get_context("spawn"), initializer=_ignore_ctrl_c)
        try:
            for result in pool.map(_read_one, jobs, chunksize=16):
                yield result
                done += 1
        except BrokenExecutor:
            _LOGGER.warning("a process that read logs died: the rest is read without it")
        finally:
            pool.shutdown(wait=True, cancel_futures=True)
    for job in jobs[done:]:
        yield _read_one(job)
        stop_if_asked()


def _ignore_ctrl_c() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent stops its processes itself


def _latest(evaluations: list[Evaluation], left_out: dict[str, str]) -> list[Evaluation]:
    """Leaves out earlier logs of the same episode, which would count it twice."""
    latest: dict[tuple[object, ...], Evaluation] = {}
    for one in evaluations:
        if one.mode == DEMONSTRATION or one.stage in COMPARED:
            key: tuple[object, ...] = (one.log,)
        else:
            key = (one.stage, one.row, one.variant, one.mode, one.training_seed, one.seed, one.task, one.test_set,
                   one.force_weight, one.wire, one.max_steps)  # fmt: skip
        other = latest.get(key)
        if other is not None:
            earlier, later = sorted((one, other), key=lambda found: (found.started_ns, found.log))
            left_out[earlier.log] = f"the same episode was recorded again in {later.log}"
            one = later
        latest[key] = one
    return sorted(latest.values(), key=lambda found: found.log)


class _MetricsCache:
    """Metrics of logs that were read before, by path, size and time; forgotten when the code behind them changes."""

    def __init__(self, file: Path | None) -> None:
        self._file = file
        sources = SourceClosure(file and file.with_name("sources.json"))
        self._code = sources.hash("pipeline.report.learning.logs", "cathsim.metrics")
        self._entries = self._load()
        self._new: dict[str, Any] = {}

    def _load(self) -> dict[str, Any]:
        try:
            content = read_json(self._file) if self._file else {}
            return dict(content["logs"]) if content.get("code") == self._code else {}
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            return {}  # a cache that cannot be read is an empty one

    def recall(self, path: Path, run_path: Path) -> Evaluation | None:
        from cathsim.metrics import EpisodeMetrics

        entry = self._entries.get(path.relative_to(run_path).as_posix())
        if entry is None or entry["stamp"] != _stamp(path):
            return None
        values = entry["evaluation"]
        return Evaluation(**{**values, "metrics": EpisodeMetrics(**values["metrics"])})

    def keep(self, path: Path, evaluation: Evaluation) -> None:
        self._new[evaluation.log] = {"stamp": _stamp(path), "evaluation": asdict(evaluation)}

    def save(self) -> None:
        if self._file is not None and self._new:
            entries = self._load() | self._new  # another job of the run may have added its own meanwhile
            write_json(self._file, {"code": self._code, "logs": entries})


def _stamp(path: Path) -> list[int]:
    status = path.stat()
    return [status.st_size, status.st_mtime_ns]
