"""Reads all evaluations of a run: many logs in parallel, damaged ones left out, metrics of known ones from a cache."""

from __future__ import annotations

import logging
import os
import signal
from collections.abc import Iterator, Sequence
from concurrent.futures import BrokenExecutor, ProcessPoolExecutor
from dataclasses import asdict, dataclass, field
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from pipeline.evaluations.logs import COMPARED, DEMONSTRATION, Evaluation, UnusableLogError, read_evaluation
from pipeline.store.file_cache import FileCache
from pipeline.store.interruption import stop_if_interrupted

CACHE = Path(".cache", "learning.json")  # below the run: a stage's own folder is emptied when it runs again
METRICS_VERSION = "2"  # raised by hand where the same log gives other metrics
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
        cache: file that keeps metrics between calls, as long as the logs and `METRICS_VERSION` stay.
        processes: that read in parallel when there is much to read; by default one a core.

    Returns:
        The evaluations. Of logs of the same episode of the same policy the latest counts.
    """
    from pipeline.episodes import EpisodeReadError

    found = EvaluationSet()
    if not folders:
        return found
    run_path = folders[0].parent
    kept = FileCache(cache, run_path, version=METRICS_VERSION)
    paths = [path for folder in folders for path in sorted(folder.rglob("*.mcap"))]
    known = {path: kept.recall(path) for path in paths}
    new = [path for path in paths if known[path] is None]
    for path, result in zip(new, _read_all(new, run_path, processes), strict=True):
        if isinstance(result, Evaluation):
            known[path] = kept.compute(path, partial(_values, result))
            continue
        found.left_out[path.relative_to(run_path).as_posix()] = str(result)
        words = str(result) if isinstance(result, EpisodeReadError) else f"{path}: {result}"
        _LOGGER.warning("left out: %s", words)
    kept.save()
    found.evaluations = _latest([_evaluation(values) for values in known.values() if values], found.left_out)
    return found


def _values(evaluation: Evaluation, path: Path) -> dict[str, Any]:
    return asdict(evaluation)


def _evaluation(values: dict[str, Any]) -> Evaluation:
    from cathsim.metrics import EpisodeMetrics

    return Evaluation(**{**values, "metrics": EpisodeMetrics(**values["metrics"])})


def _read_one(path: Path, run_path: Path) -> Evaluation | ValueError:
    from pipeline.episodes import EpisodeReadError

    try:
        return read_evaluation(path, run_path)
    except (EpisodeReadError, UnusableLogError) as error:
        return error
    except (AttributeError, IndexError, KeyError, OverflowError, TypeError, ValueError) as error:
        # checksums are right, so another program wrote what no version of this one would
        return UnusableLogError(f"what it says cannot be used ({type(error).__name__}: {error})")


def _read_all(paths: list[Path], run_path: Path, processes: int | None) -> Iterator[Evaluation | ValueError]:
    count = min(processes or len(os.sched_getaffinity(0)), 1 + len(paths) // PARALLEL_FROM)
    done = 0
    if count > 1:
        pool = ProcessPoolExecutor(count, mp_context=get_context("spawn"), initializer=_ignore_ctrl_c)
        try:
            for result in pool.map(partial(_read_one, run_path=run_path), paths, chunksize=16):
                yield result
                done += 1
        except BrokenExecutor:
            _LOGGER.warning("a process that read logs died: the rest is read without it")
        finally:
            pool.shutdown(wait=True, cancel_futures=True)
    for path in paths[done:]:
        yield _read_one(path, run_path)
        stop_if_interrupted()


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
