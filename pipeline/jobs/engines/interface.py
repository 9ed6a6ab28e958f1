"""What every engine does: take jobs, pass on what they report, stop them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

from pipeline.jobs.job import Job
from pipeline.jobs.worker import Message
from pipeline.store.run_folder import RunFolder

STARTED, ENDED, AGAIN = "started", "ended", "again"  # kinds of messages beside those of a job
LOST = "lost"  # and the kind of the last one where a job on another machine did not end by itself


@dataclass(frozen=True)
class Notes:
    """Where a job's process notes the files that it writes: see `pipeline.store.written_files.noted`."""

    folder: Path  # of the stage
    journal: Path

    @classmethod
    def of(cls, folder: RunFolder, job: Job) -> Notes:
        """Those of a job of a stage."""
        return cls(folder.path, folder.journal(job.key))


class Engine(ABC):
    """Runs jobs.

    After `submit` the engine reports of a job, in this order: ``started``; what the job itself sends (``progress``,
    ``log``, then ``done`` or ``failed``); ``ended``, whose text is the reason where the job has not answered. ``again``
    says that its machine was lost and that it will start once more.
    """

    capacity: int  # jobs beside each other, for the estimate of the end

    @abstractmethod
    def check(self, jobs: Sequence[Job]) -> None:
        """Refuses jobs that would wait for ever.

        Raises:
            StageError: nothing that the engine has is large enough for one of them.
        """

    @abstractmethod
    def submit(self, job: Job, notes: Notes) -> bool:
        """Takes a job.

        Returns:
            Whether it was taken; False while there is no room.
        """

    @abstractmethod
    def listen(self, timeout_s: float) -> list[tuple[str, Message]]:
        """Waits for messages.

        Returns:
            Keys of jobs and their messages; empty after `timeout_s`.
        """

    @abstractmethod
    def stop(self) -> None:
        """Asks the jobs under way to write their checkpoints and leave, and drops those that have not started."""

    @abstractmethod
    def close(self) -> None:
        """Ends what is still under way, and lets go of the machines."""

    def __enter__(self) -> Engine:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()
