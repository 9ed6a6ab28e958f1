"""The engine that was chosen for a run, and how one is made for the jobs of a stage."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator, Sequence
from contextvars import ContextVar

from pipeline.jobs.engines.cluster import ClusterEngine
from pipeline.jobs.engines.local import LocalEngine, available_workers
from pipeline.jobs.engines.settings import EngineSettings, RaySettings, SlurmSettings
from pipeline.jobs.engines.shared_files import JOBS
from pipeline.jobs.gpus import Gpu
from pipeline.jobs.machine import Machine
from pipeline.store.run_folder import RunFolder

Available = Callable[[], int]
_CHOSEN: ContextVar[tuple[EngineSettings | None, Available]] = ContextVar("engine", default=(None, lambda: sys.maxsize))


@contextlib.contextmanager
def chosen_engine(settings: EngineSettings | None, available: Available = lambda: sys.maxsize) -> Iterator[None]:
    """Has the jobs of a stage run by an engine while the body runs.

    Args:
        settings: None: processes of this machine.
        available: counts the bytes of memory of this machine that may still be taken.
    """
    token = _CHOSEN.set((settings, available))
    try:
        yield
    finally:
        _CHOSEN.reset(token)


def make_engine(
    folder: RunFolder,
    *,
    workers: int,
    preload: Sequence[str],
    device: str,
    find: Callable[[], Sequence[Gpu]],
    available: Available | None,
) -> LocalEngine | ClusterEngine:
    """The chosen engine, the local one where none was chosen.

    Args:
        folder: of the stage.

    See `pipeline.jobs.pool.run_jobs` for the others.
    """
    settings, room = _CHOSEN.get()
    if not isinstance(settings, RaySettings | SlurmSettings):
        workers = workers or available_workers()
        return LocalEngine(folder, Machine.here(workers, available or room, device, find), workers, preload)
    place = folder.path.absolute() / JOBS
    place.mkdir(parents=True, exist_ok=True)
    if isinstance(settings, SlurmSettings):
        from pipeline.jobs.engines.slurm import SlurmExecutor

        workers = min(workers or settings.jobs, settings.jobs or workers)
        return ClusterEngine(folder, SlurmExecutor(settings, place), settings, device=device, at_once=workers)
    from pipeline.jobs.engines.ray_cluster import RayExecutor

    return ClusterEngine(folder, RayExecutor(settings), settings, device=device, at_once=workers)
