"""The engine that was chosen for a run, and how one is made for the jobs of a stage."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from contextvars import ContextVar
from pathlib import Path

from pipeline.jobs.engines.cluster import Cluster
from pipeline.jobs.engines.interface import Engine
from pipeline.jobs.engines.local import LocalEngine, available_workers
from pipeline.jobs.engines.settings import EngineSettings, RaySettings, SlurmSettings
from pipeline.jobs.engines.shared_files import JOBS
from pipeline.jobs.engines.shared_machine import SharedMachine
from pipeline.jobs.gpus import CPU, Gpu, GpuShare, gpus_of
from pipeline.store.run_folder import RunFolder

_GB = 1e9
_CHOSEN: ContextVar[EngineSettings | None] = ContextVar("engine", default=None)


@contextlib.contextmanager
def chosen_engine(settings: EngineSettings | None) -> Iterator[None]:
    """Has the jobs of a stage run by an engine while the body runs."""
    token = _CHOSEN.set(settings)
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
    available: Callable[[], int],
) -> Engine:
    """The chosen engine, the local one where none was chosen.

    Args:
        folder: of the stage.

    See `pipeline.jobs.pool.run_jobs` for the others.
    """
    settings = _CHOSEN.get()
    if isinstance(settings, RaySettings | SlurmSettings):
        return _remote(folder.path, settings, device, workers)
    machine = SharedMachine.of_environment()
    found = [] if device == CPU else find() if machine is None else machine.gpus(find)
    share = GpuShare(gpus_of(device, found))
    return LocalEngine(workers or available_workers(), preload, share, available() / _GB, machine)


def _remote(stage: Path, settings: RaySettings | SlurmSettings, device: str, workers: int) -> Engine:
    from pipeline.jobs.engines.remote import RemoteEngine

    place = stage.absolute() / JOBS
    place.mkdir(parents=True, exist_ok=True)
    if isinstance(settings, SlurmSettings):
        from pipeline.jobs.engines.slurm import SlurmCluster

        cluster: Cluster = SlurmCluster(settings, place)
        workers = min(workers or settings.jobs, settings.jobs or workers)
    else:
        from pipeline.jobs.engines.ray_cluster import RayCluster

        cluster = RayCluster(settings, place)
    try:
        return RemoteEngine(stage, cluster, settings, device=device, at_once=workers)
    except BaseException:
        cluster.close()
        raise
