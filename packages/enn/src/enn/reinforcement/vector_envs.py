"""Environments for stable-baselines3: in this process, or in one of their own beside a training's updates.

In threads of one process both want the interpreter's lock after every native call; then the environments take twice as
long, and the updates a third longer: `docs/results/rehearsal.md#how-long-it-trains`.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection
from operator import attrgetter, methodcaller
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector.utils import CloudpickleWrapper
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from enn.networks.observation_spaces import kept_space
from enn.reinforcement.resources import Workers
from enn.reinforcement.sampling import Observations, Sampling, without_checks
from enn.reinforcement.start_state_buffer import StartStateBuffer

POSSIBLE = os.name == "posix"  # an open connection can be handed over to a new process
_END_S = 5.0  # that the process has to end by itself
# bytes; MuJoCo's arenas are larger: each then goes back to the system at once (GNU C library)
_OWN_PAGES = {"MALLOC_MMAP_THRESHOLD_": str(12 * 2**20)}
_MAIN = "import sys; sys.path[:] = {path!r}; from enn.reinforcement.environment_process import serve; serve({number})"


class _Reached(VecEnv):
    """What stable-baselines3 asks of single environments."""

    def each_of(self, read: Callable[[Any], Any], indices: Sequence[int]) -> list[Any]:
        """As of `Sampling`."""
        raise NotImplementedError

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute of each environment."""
        return self.each_of(attrgetter(attr_name), [*self._get_indices(indices)])

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Sets an attribute of each environment."""
        self.each_of(methodcaller("__setattr__", attr_name, value), [*self._get_indices(indices)])

    def env_method(self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any) -> list[Any]:
        """Calls a method of each environment."""
        return self.each_of(methodcaller(method_name, *method_args, **method_kwargs), [*self._get_indices(indices)])

    def env_is_wrapped(
        self, wrapper_class: type[gymnasium.Wrapper[Any, Any, Any, Any]], indices: Any = None
    ) -> list[bool]:
        """Whether each environment is wrapped so; Monitor is not needed, episodes are counted here."""
        return [False for _ in self._get_indices(indices)]


class SampledEnvs(Sampling, _Reached):
    """`Sampling` in this process, for stable-baselines3."""

    def __init__(self, factories: Sequence[Callable[[], gymnasium.Env[Any, Any]]], **settings: Any) -> None:
        Sampling.__init__(self, factories, **settings)
        VecEnv.__init__(self, self.num_envs, self.observation_space, self.action_space)


class SubprocessEnvs(_Reached):
    """`SampledEnvs` in another process; gives exactly what they would give here.

    The process starts at once and makes its environments while this one goes on; `reset` waits for it. It ends with
    `close`, or when this process ends.

    Args:
        factories: as of `SampledEnvs`; sent there by cloudpickle. The first makes an environment here, too, whose
            spaces are taken.
        threads: that step the environments there.
        start_state_buffer: as of `SampledEnvs`; a copy of it goes there as it is.
        evaluation_threads: of `workers`, which are for evaluations here.
        settings: further arguments of `SampledEnvs`.

    Raises:
        RuntimeError: from any call: the process has ended, for want of memory for instance. What an environment raises
            there is raised here.
    """

    def __init__(
        self,
        factories: Sequence[Callable[[], gymnasium.Env[Any, Any]]],
        *,
        keys: Sequence[str] = (),
        threads: int = 1,
        start_state_buffer: StartStateBuffer | None = None,
        evaluation_threads: int = 1,
        **settings: Any,
    ) -> None:
        first = without_checks(factories[0]())
        self._render_mode = first.render_mode
        super().__init__(len(factories), kept_space(first.observation_space, keys), first.action_space)
        first.close()
        self.workers = Workers(evaluation_threads)
        parent_socket, child_socket = socket.socketpair()
        with child_socket:
            self._process = subprocess.Popen(
                [sys.executable, "-c", _MAIN.format(path=sys.path, number=child_socket.fileno())],
                pass_fds=[child_socket.fileno()],
                env={**_OWN_PAGES, **os.environ},
            )
        self._connection = Connection(parent_socket.detach())
        arguments = {"keys": tuple(keys), "threads": threads, "start_state_buffer": start_state_buffer, **settings}
        self._waits, self._cpu_s = True, 0.0
        self._send((CloudpickleWrapper(list(factories)), arguments))  # type: ignore[arg-type]  # a list goes as well

    @property
    def cpu_s(self) -> float:
        """Processor time that the environments' process has taken, at its last answer, s."""
        return self._cpu_s

    def reset(self) -> Observations:
        """As of `SampledEnvs.reset`."""
        return self._ask("reset")

    def step_async(self, actions: NDArray[Any]) -> None:
        """Lets all environments begin with these actions. Shape (environments, actions)."""
        self._request("step", actions)

    def step_wait(self) -> tuple[Observations, NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """As of `SampledEnvs.step_wait`."""
        return self._answer()

    def state(self) -> dict[str, Any]:
        """As of `SampledEnvs.state`."""
        return self._ask("state")

    def restore(self, state: dict[str, Any]) -> Observations:
        """As of `SampledEnvs.restore`."""
        return self._ask("restore", state)

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute of each environment."""
        if attr_name == "render_mode":
            return [self._render_mode for _ in self._get_indices(indices)]
        return super().get_attr(attr_name, indices)

    def each_of(self, read: Callable[[Any], Any], indices: Sequence[int]) -> list[Any]:
        """As of `Sampling`."""
        return self._ask("each_of", read, indices)

    def close(self) -> None:
        """Ends the process and the threads."""
        self.workers.close()
        self._connection.close()  # which tells it to end
        self._ended()

    def _ask(self, name: str, *arguments: Any, **named: Any) -> Any:
        self._request(name, *arguments, **named)
        return self._answer()

    def _request(self, name: str, *arguments: Any, **named: Any) -> None:
        if self._waits:
            self._waits = False
            self._answer()  # it was made
        self._send((name, arguments, named))

    def _send(self, content: Any) -> None:
        try:
            self._connection.send(content)
        except OSError as error:
            raise self._gone() from error

    def _answer(self) -> Any:
        try:
            error, result, self._cpu_s = self._connection.recv()
        except (EOFError, OSError) as gone:
            raise self._gone() from gone
        except Exception as failure:  # of making it again
            raise RuntimeError(
                f"what an environment gave or raised cannot be sent between processes ({failure}): use threads=1, "
                "which steps them in this process"
            ) from failure
        if error is not None:
            raise error
        return result

    def _ended(self) -> int:
        """The code with which the process has ended; it is killed if it does not end by itself."""
        try:
            return self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            return self._process.wait()

    def _gone(self) -> RuntimeError:
        return RuntimeError(
            f"the process that steps the environments has ended (code {self._ended()}): see what it "
            "printed; where memory was short, take fewer environments, or threads=1, which steps them in this process"
        )
