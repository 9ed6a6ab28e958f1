"""Many environments stepped in one process on all cores: the native code releases the interpreter's lock."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Annotated, Any

import numpy as np
from annotated_types import Interval
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space, concatenate, create_empty_array

from cathsim.environment import NavigateEnv
from cathsim.many_anatomies import NavigateManyEnv
from cathsim.registration.description import Specified
from cathsim.registration.usage import Usage, exclusive
from cathsim.validation import Count, numbers, quantity

_Many = Annotated[int, Interval(ge=1, le=100_000)]


class ThreadedVectorEnv(Specified, VectorEnv[Any, Any, np.ndarray]):
    """`num_envs` navigation environments in threads; nothing is pickled or copied between processes.

    Results do not depend on the number of threads. Wrappers of single environments and other vectors are those of
    `gymnasium.make_vec` with `vectorization_mode="sync"` or "async".

    Args:
        threads: number of threads; by default one a core.
        autoreset_mode: as of `gymnasium.vector.SyncVectorEnv`, or its value: an environment that has ended is reset by
            the next step, which ignores its action and returns reward 0 ("NextStep"); in the same step, with the last
            observation in `info["final_obs"]` and `info["final_info"]` ("SameStep"); or by
            `reset(options={"reset_mask": …})` ("Disabled").
        max_episode_steps: truncates every episode after so many steps, as `gymnasium.make` does.
        variations: arguments of single environments, over `arguments`; as many as environments.
        arguments: of `NavigateEnv`.
    """

    _make: type[NavigateEnv] | type[NavigateManyEnv] = NavigateEnv

    def __init__(
        self,
        num_envs: int = 1,
        *,
        threads: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        max_episode_steps: int | None = None,
        variations: Sequence[dict[str, Any]] | None = None,
        **arguments: Any,
    ) -> None:
        num_envs = quantity("num_envs", num_envs, _Many)
        threads = None if threads is None else quantity("threads", threads, _Many)
        if autoreset_mode not in [*AutoresetMode, *(mode.value for mode in AutoresetMode)]:
            known = ", ".join(mode.value for mode in AutoresetMode)
            raise ValueError(f"unknown autoreset_mode {autoreset_mode!r}; there are {known}")
        self._autoreset = AutoresetMode(autoreset_mode)
        self._most_steps = (
            None if max_episode_steps is None else quantity("max_episode_steps", max_episode_steps, Count)
        )
        if variations is not None and len(variations) != num_envs:
            raise ValueError(f"expected {num_envs} variations, one an environment, got {len(variations)}")
        self.envs = [self._make(**{**arguments, **(variations[i] if variations else {})}) for i in range(num_envs)]
        self.num_envs = num_envs
        self.metadata = {**self.envs[0].metadata, "autoreset_mode": self._autoreset}
        self.render_mode = self.envs[0].render_mode
        self.single_action_space = self.envs[0].action_space
        self.single_observation_space = self.envs[0].observation_space
        for env in self.envs:
            if env.action_space != self.single_action_space or env.observation_space != self.single_observation_space:
                raise ValueError("all environments of a vector need the same action and observation spaces")
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._threads = min(num_envs, threads or os.cpu_count() or 1)
        self._pool = self._start_threads()
        self._ended, self._steps = np.zeros(num_envs, bool), np.zeros(num_envs, int)
        self.usage = Usage()

    def _start_threads(self) -> ThreadPoolExecutor | None:
        return ThreadPoolExecutor(self._threads - 1, "cathsim") if self._threads > 1 else None

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "_pool"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._pool = self._start_threads()

    def _each(self, work: Callable[[int], Any]) -> list[Any]:
        """Does the work for every environment, each thread taking the next one that is left."""
        results: list[Any] = [None] * self.num_envs
        # the likely longest first, so that no thread is left with a long one at the end
        queue = iter(sorted(range(self.num_envs), key=lambda index: -self.envs[index].simulation.last_effort))

        def run() -> None:
            for index in queue:
                results[index] = work(index)

        if self._pool is None:
            run()
        else:
            helpers = [self._pool.submit(run) for _ in range(self._threads - 1)]
            try:
                run()
            finally:
                for helper in helpers:
                    helper.result()
        return results

    def _batch(self, observations: list[Any]) -> Any:
        out: Any = create_empty_array(self.single_observation_space, self.num_envs)
        return concatenate(self.single_observation_space, observations, out)

    def _gather(self, infos: list[dict[str, Any]]) -> dict[str, Any]:
        """The infos of all environments as arrays, each with a mask of who has it, as Gymnasium's vectors give them."""
        if "final_obs" in infos[0] or any(info.keys() != infos[0].keys() for info in infos):
            gathered: dict[str, Any] = {}
            for index, info in enumerate(infos):
                gathered = self._add_info(gathered, info, index)
            return gathered
        everyone = np.ones(self.num_envs, bool)
        gathered = {
            key: np.array([info[key] for info in infos], dtype=object if isinstance(value, str) else None)
            for key, value in infos[0].items()
        }
        return gathered | {f"_{key}": everyone.copy() for key in infos[0]}

    @exclusive
    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Resets the environments; an integer seed gives environment i the seed + i.

        Args:
            seed: of all, or one each.
            options: `reset_mask`, bool of shape (num_envs,), restricts the reset to some environments.
        """
        seeds: list[int | None]
        if seed is None:
            seeds = [None] * self.num_envs
        elif isinstance(seed, int | np.integer):
            seeds = [int(seed) + i for i in range(self.num_envs)]
        else:
            seeds = list(seed)
        if len(seeds) != self.num_envs:
            raise ValueError(f"expected {self.num_envs} seeds, one an environment, got {len(seeds)}")
        own = dict(options or {})
        mask = np.asarray(own.pop("reset_mask", np.ones(self.num_envs)), bool)
        if mask.shape != (self.num_envs,):
            raise ValueError(f"expected a reset_mask of shape ({self.num_envs},), got {mask.shape}")

        def start(index: int) -> tuple[Any, dict[str, Any]]:
            env = self.envs[index]
            return env.reset(seed=seeds[index], options=own) if mask[index] else (env.observe(), {})

        results = self._each(start)
        self._ended[mask], self._steps[mask] = False, 0
        infos = self._gather([info for _, info in results])
        return self._batch([observation for observation, _ in results]), infos

    @exclusive
    def step(self, actions: np.ndarray) -> tuple[Any, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Steps every environment.

        Args:
            actions: shape (num_envs, actions).

        Raises:
            ValueError: the actions have another shape or are not finite.
            RuntimeError: an episode has ended and autoreset is disabled; the vector is closed, or in use by another
                thread.
        """
        assert self.action_space.shape is not None
        actions = numbers("actions", actions, self.action_space.shape)
        if self._autoreset == AutoresetMode.DISABLED and self._ended.any():
            ended = ", ".join(map(str, np.flatnonzero(self._ended)))
            raise RuntimeError(
                f"the episodes of {ended} have ended and autoreset is disabled: call reset(options={{'reset_mask': …}})"
            )

        def advance(index: int) -> tuple[Any, float, bool, bool, dict[str, Any]]:
            env = self.envs[index]
            if self._ended[index]:
                observation, info = env.reset()
                self._steps[index] = 0
                return observation, 0.0, False, False, info
            observation, reward, terminated, truncated, info = env.step(actions[index])
            self._steps[index] += 1
            truncated = truncated or self._steps[index] == self._most_steps
            if self._autoreset == AutoresetMode.SAME_STEP and (terminated or truncated):
                final = {"final_obs": observation, "final_info": info}
                observation, info = env.reset()
                self._steps[index] = 0
                info = {**info, **final}
            return observation, reward, terminated, truncated, info

        results = self._each(advance)
        infos = self._gather([result[4] for result in results])
        terminated = np.array([result[2] for result in results], bool)
        truncated = np.array([result[3] for result in results], bool)
        if self._autoreset != AutoresetMode.SAME_STEP:
            self._ended = terminated | truncated
        rewards = np.array([result[1] for result in results], np.float64)
        return self._batch([result[0] for result in results]), rewards, terminated, truncated, infos

    @exclusive
    def render(self) -> tuple[Any, ...] | None:
        """A picture of every environment."""
        return tuple(env.render() for env in self.envs)

    def close_extras(self, **kwargs: Any) -> None:
        """Ends the threads and frees the renderers."""
        self.usage.close(self._free)

    def _free(self) -> None:
        if self._pool is not None:
            self._pool.shutdown()
        for env in self.envs:
            env.close()


class ThreadedManyVectorEnv(ThreadedVectorEnv):
    """A `ThreadedVectorEnv` of `NavigateManyEnv`; arguments are those of both."""

    _make = NavigateManyEnv
