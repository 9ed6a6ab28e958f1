"""A cluster for tests: every machine is a process of this one, which a test can kill."""

from __future__ import annotations

import multiprocessing
from typing import Any

from pipeline.jobs.engines.cluster import Executor, Needs
from pipeline.jobs.engines.task import Task, run_task


class ProcessExecutor(Executor):
    """Starts as many tasks beside each other as it has machines; the others wait."""

    def __init__(self, machines: int = 2, memory_gb: float = 8.0, has_gpus: bool = False) -> None:
        self.capacity, self.memory_gb, self.has_gpus = machines, memory_gb, has_gpus
        self.tasks: list[tuple[str, Task, Needs]] = []
        self.processes: dict[int, Any] = {}
        self.cancelled: set[int] = set()
        self.closed = False

    def fits(self, needs: Needs) -> bool:
        return needs.memory_gb <= self.memory_gb

    def submit(self, name: str, task: Task, needs: Needs) -> int:
        self.tasks.append((name, task, needs))
        self._start()
        return len(self.tasks) - 1

    def _start(self) -> None:
        context = multiprocessing.get_context("fork")
        for number, (_, task, _) in enumerate(self.tasks):
            running = sum(process.is_alive() for process in self.processes.values())
            if number not in self.processes and number not in self.cancelled and running < self.capacity:
                process = context.Process(target=run_task, args=(task,))
                process.start()
                self.processes[number] = process

    def result(self, handle: int) -> str | None:
        self._start()
        if handle in self.cancelled:
            return "it was cancelled"
        process = self.processes.get(handle)
        if process is None or process.is_alive():
            return None
        return "" if process.exitcode == 0 else f"machine {handle} does not answer"

    def lose(self, handle: int) -> None:
        """Kills a machine."""
        self.processes[handle].kill()
        self.processes[handle].join()

    def cancel(self, handle: int) -> None:
        self.cancelled.add(handle)
        if handle in self.processes:
            self.processes[handle].kill()

    def close(self) -> None:
        self.closed = True
        for process in self.processes.values():
            process.kill()
            process.join()
