"""Slurm by submitit: every job is a job of Slurm with its CPUs, GPUs, memory and hours named."""

from __future__ import annotations

import contextlib
import shutil
from pathlib import Path
from typing import Any

from pipeline.jobs.engines.cluster import Executor, Needs
from pipeline.jobs.engines.settings import LOCAL, SLURM, SlurmSettings
from pipeline.jobs.engines.task import Task, run_task
from pipeline.store.errors import StageError

_MINUTES_AN_HOUR = 60


class SlurmExecutor(Executor):
    """The queue of a Slurm cluster, or with `engine.manager=local` processes of this machine."""

    def __init__(self, settings: SlurmSettings, shared: Path) -> None:
        """Keeps submitit's own files in the folder of the stage's jobs."""
        import submitit

        if settings.manager == SLURM and shutil.which("sbatch") is None:
            raise StageError(
                "engine=slurm needs Slurm's commands, and there is no sbatch on this machine: run it on a login node, "
                "or take engine=local or engine=ray"
            )
        self._settings = settings
        self._executor = submitit.AutoExecutor(folder=str(shared / "submitit" / "%j"), cluster=settings.manager)
        self.has_gpus = settings.gpus

    def parameters(self, name: str, needs: Needs) -> dict[str, Any]:
        """What a job is submitted with, in submitit's words."""
        common = {
            "name": "".join(letter if letter.isalnum() else "_" for letter in name),
            "timeout_min": max(int(self._settings.hours * _MINUTES_AN_HOUR), 1),
            "cpus_per_task": 1,
            "gpus_per_node": needs.gpus,
            "mem_gb": needs.memory_gb,
        }
        if self._settings.manager == LOCAL:
            return common
        own = {"slurm_partition": self._settings.partition, "slurm_account": self._settings.account}
        # A lost job is sent again by the engine, as a new attempt; Slurm must not start the old one once more.
        return common | {key: value for key, value in own.items() if value} | {
            "slurm_additional_parameters": {"no_requeue": True}
        }  # fmt: skip

    def submit(self, name: str, task: Task, needs: Needs) -> Any:
        self._executor.update_parameters(**self.parameters(name, needs))
        try:
            return self._executor.submit(run_task, task)
        except Exception as error:  # submitit raises what sbatch says as an error of its own
            raise StageError(f"Slurm refuses a job ({' '.join(str(error).split())}): see engine.partition, "
                             "engine.account, engine.hours and engine.memory_gb") from error  # fmt: skip

    def result(self, handle: Any) -> str | None:
        """How a job has ended, as far as submitit and Slurm's accounts tell."""
        if not handle.done():
            return None
        try:
            return str(handle.result() or "")
        except Exception as error:  # submitit's own, and whatever stopped its process
            lines = [line.strip() for line in str(error).splitlines() if line.strip()]
            return f"Slurm's job {handle.job_id} is {handle.state}: {lines[0] if lines else type(error).__name__}"

    def cancel(self, handle: Any) -> None:
        with contextlib.suppress(Exception):
            handle.cancel()

    def close(self) -> None:
        """Nothing is held between calls."""
