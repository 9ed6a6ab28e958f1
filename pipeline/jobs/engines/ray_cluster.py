"""A Ray cluster: every job is a task with its CPUs, GPUs and memory named; which machine runs it is Ray's choice."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
from collections.abc import Iterator
from typing import Any

from pipeline.jobs.engines import task as task_module
from pipeline.jobs.engines.cluster import Executor, Needs
from pipeline.jobs.engines.settings import RaySettings
from pipeline.jobs.engines.task import Task
from pipeline.printing import installing
from pipeline.store.errors import StageError

ADDRESS = "RAY_ADDRESS"
_GB = 1e9
_SECONDS_TO_CONNECT = 5.0
_START = "start one with `ray start --head`, or name another by engine.address=HOST:PORT or RAY_ADDRESS"


class RayExecutor(Executor):
    """A cluster that is running already."""

    def __init__(self, settings: RaySettings) -> None:
        """Connects; a StageError where Ray is not installed, or there is no cluster at the address."""
        try:
            import ray
        except ModuleNotFoundError as error:
            if error.name != "ray":
                raise
            raise StageError(
                f"engine=ray needs Ray, which is not installed: run `{installing('make ray')}`, or take engine=local"
            ) from (error)
        self._ray: Any = ray
        self._connect(settings.address or os.environ.get(ADDRESS))
        # The function goes to the machines by value: what one of them lacks is then named by it, not by Ray.
        ray.cloudpickle.register_pickle_by_value(task_module)
        self._run: Any = ray.remote(max_retries=0, max_calls=1)(task_module.run_task)
        self.has_gpus = ray.cluster_resources().get("GPU", 0) > 0

    def _connect(self, address: str | None) -> None:
        if address is not None and address not in ("auto", "local"):
            _require_listening(address)
        try:
            with _signals_kept():
                self._ray.init(
                    address="auto" if address in (None, "local") else address,
                    namespace="endonav", log_to_driver=False, logging_level="ERROR", configure_logging=False,
                )  # fmt: skip
        except ConnectionError as error:
            where = "on this machine" if address is None else f"at {address}"
            raise StageError(f"there is no Ray cluster {where}: {_START}") from error
        except (RuntimeError, ValueError) as error:  # another version of Ray or Python, an address that is none
            reason = " ".join(str(error).split())
            raise StageError(f"the Ray cluster cannot be used ({reason}): {_START}") from error

    def fits(self, needs: Needs) -> bool:
        """Whether a machine has so much in all."""
        return any(
            node["Resources"].get("CPU", 0) >= 1
            and node["Resources"].get("GPU", 0) >= needs.gpus
            and node["Resources"].get("memory", 0) >= needs.memory_gb * _GB
            for node in self._ray.nodes()
            if node["Alive"]
        )

    def submit(self, name: str, task: Task, needs: Needs) -> Any:
        """Submits a task; Ray starts it when a machine has room for it."""
        memory = int(needs.memory_gb * _GB)
        return self._run.options(name=name, num_cpus=1, num_gpus=needs.gpus, memory=memory).remote(task)

    def result(self, handle: Any) -> str | None:
        """How a task has ended; Ray says so of one whose machine or process is gone, too."""
        ready, _ = self._ray.wait([handle], timeout=0)
        if not ready:
            return None
        try:
            return str(self._ray.get(handle) or "")
        except self._ray.exceptions.RayError as error:
            return _first_sentence(error)

    def cancel(self, handle: Any) -> None:
        """Cancels a task; its process ends."""
        with contextlib.suppress(self._ray.exceptions.RayError, ValueError):
            self._ray.cancel(handle, force=True)

    def close(self) -> None:
        """Leaves the cluster."""
        with _signals_kept():
            self._ray.shutdown()


def _first_sentence(error: BaseException) -> str:
    first = next((line.strip() for line in str(error).splitlines() if line.strip()), "")
    return f"{type(error).__name__}: {first.partition('. ')[0].rstrip('.')}" if first else type(error).__name__


def _require_listening(address: str) -> None:
    """Refuses an address where nobody answers, for which Ray itself would wait for minutes."""
    host, _, port = address.rpartition("://")[2].rpartition(":")
    if not host or not port.isdecimal():
        raise StageError(f"{address!r} is no address of a Ray cluster, HOST:PORT such as 10.0.0.5:6379: {_START}")
    try:
        with socket.create_connection((host, int(port)), timeout=_SECONDS_TO_CONNECT):
            pass
    except (OSError, OverflowError) as error:
        raise StageError(f"there is no Ray cluster at {address}: {_START}") from error


@contextlib.contextmanager
def _signals_kept() -> Iterator[None]:
    """Keeps what this process does at Ctrl-C and SIGTERM: Ray has a handler of its own."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            if signal.getsignal(number) is not handler:
                signal.signal(number, handler)
