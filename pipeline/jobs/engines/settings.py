"""Settings of the engines, `engine=local|ray|slurm` and `engine.KEY=VALUE`; none changes a result."""

from __future__ import annotations

from typing import Annotated

from annotated_types import Ge, Gt, Le

from pipeline.settings.kinds import PathText, Processes, one_of, validated

LOCAL, RAY, SLURM = "local", "ray", "slurm"
JOBS = ".jobs"  # folder of a stage where a cluster's jobs are

Retries = Annotated[int, Ge(0), Le(100)]
Gigabytes = Annotated[float, Gt(0), Le(10_000)]
Hours = Annotated[float, Gt(0), Le(10_000)]


@validated("engine.")
class LocalSettings:
    """Processes of this machine."""

    name: Annotated[str, one_of(LOCAL)] = LOCAL


@validated("engine.")
class ClusterSettings:
    """What the engines of a cluster share."""

    retries: Retries = 2  # how often a job is done again whose machine was lost
    memory_gb: Gigabytes = 2.0  # that is named for each job at the least; more where a job says that it needs more


@validated("engine.")
class RaySettings(ClusterSettings):
    """Tasks of a Ray cluster."""

    name: Annotated[str, one_of(RAY)] = RAY
    # HOST:PORT of the cluster; null: RAY_ADDRESS, or the cluster that `ray start` has started on this machine.
    address: PathText | None = None


@validated("engine.")
class SlurmSettings(ClusterSettings):
    """Jobs of Slurm, by submitit."""

    name: Annotated[str, one_of(SLURM)] = SLURM
    manager: Annotated[str, one_of(SLURM, LOCAL)] = SLURM  # "local": processes of this machine, to try it without Slurm
    jobs: Processes = 64  # in the queue at the same time; 0: all of a stage
    hours: Hours = 24.0  # limit of a job; one that is cut off goes on from its checkpoint, as often as `retries` says
    partition: PathText | None = None
    account: PathText | None = None
    gpus: bool = False  # whether the partition has GPUs, for stage.device=auto


EngineSettings = LocalSettings | RaySettings | SlurmSettings
SETTINGS: dict[str, type] = {LOCAL: LocalSettings, RAY: RaySettings, SLURM: SlurmSettings}
