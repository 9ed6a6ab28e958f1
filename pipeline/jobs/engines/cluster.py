"""What a cluster's scheduler does for the remote engine: start errands on its machines, and tell of their ends."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

from pipeline.jobs.engines.sending import Errand


@dataclass(frozen=True)
class Needs:
    """What a job needs of a machine."""

    cpus: int
    gpus: int
    memory_gb: float

    def __str__(self) -> str:
        """For example ``1 CPU, 1 GPU and 4.0 GB of memory``."""
        gpus = f", {self.gpus} GPU{'s' if self.gpus > 1 else ''}" if self.gpus else ""
        return f"{self.cpus} CPU{'s' if self.cpus > 1 else ''}{gpus} and {self.memory_gb:.1f} GB of memory"


class Cluster(ABC):
    """Machines that share a folder."""

    capacity: int  # jobs beside each other, for the estimate of the end
    has_gpus: bool  # for stage.device=auto

    @abstractmethod
    def fits(self, needs: Needs) -> bool:
        """Whether a machine of it is large enough."""

    @abstractmethod
    def submit(self, name: str, errand: Errand, needs: Needs) -> Any:
        """Queues an errand.

        Returns:
            What the other methods are given.
        """

    @abstractmethod
    def ended(self, handle: Any) -> str | None:
        """How an errand has ended.

        Returns:
            None: it waits or runs; "": it has ended by itself; otherwise why it has not.
        """

    @abstractmethod
    def cancel(self, handle: Any) -> None:
        """Takes an errand out of the queue, or ends it."""

    @abstractmethod
    def close(self) -> None:
        """Lets go of the cluster."""
