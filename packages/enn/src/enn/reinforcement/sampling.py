"""Sampling: environments stepped together in threads, with action repeat and starts from a start-state buffer."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.wrappers import OrderEnforcing, PassiveEnvChecker
from numpy.typing import NDArray

from enn.networks.observation_spaces import kept_space
from enn.reinforcement.resources import SharedWork, Workers
from enn.reinforcement.start_state_buffer import RECORD_EVERY, StartStateBuffer

logger = logging.getLogger(__name__)

Observations = dict[str, NDArray[Any]] | NDArray[Any]


class NotFiniteError(ValueError):
    """An environment gave an observation or a reward that is not a number."""


class Sampling:
    """Environments stepped in threads: native simulators release the interpreter's lock.

    It imports neither torch nor stable-baselines3, for which `SampledEnvs` is the same.

    Results do not depend on the number of threads. An environment that has ended is reset in the same step; its info
    then holds `terminal_observation`, `TimeLimit.truncated` and `episode`: `r` sum of rewards, `l` length in steps,
    `success`, and `fresh`, whether it started by the task, not from the start-state buffer. Every info holds `steps`,
    the number of environment steps that the decision took.

    Args:
        factories: each makes one environment; all with the same spaces.
        action_repeat: environment steps a decision, each with the same action; rewards are added up.
        start_state_buffer: states to start from; own successes from the usual start are added to it. Needs
            `env.unwrapped.start_state()` or `env.unwrapped.simulation.state()`, and `reset(options={"start": state})`.
        keys: observations of a `Dict` to keep; none: all.

    Raises:
        ValueError: no factories, spaces that differ, or an action repeat below 1.
    """

    def __init__(
        self,
        factories: Sequence[Callable[[], gymnasium.Env[Any, Any]]],
        *,
        seed: int,
        threads: int = 1,
        action_repeat: int = 1,
        start_state_buffer: StartStateBuffer | None = None,
        keys: Sequence[str] = (),
    ) -> None:
        if not factories:
            raise ValueError("expected at least one environment factory, got none")
        if action_repeat < 1:
            raise ValueError(f"action_repeat must be at least 1, got {action_repeat}")
        self.envs = [without_checks(factory()) for factory in factories]
        first = self.envs[0]
        for env in self.envs:
            if env.observation_space != first.observation_space or env.action_space != first.action_space:
                raise ValueError("all environments sampled together need the same observation and action spaces")
        space = kept_space(first.observation_space, keys)
        self.num_envs, self.observation_space, self.action_space = len(self.envs), space, first.action_space
        self.action_repeat, self.start_state_buffer = action_repeat, start_state_buffer
        self._start_states = [start_state_of(env) for env in self.envs] if start_state_buffer is not None else []
        spaces: dict[str, Any] = space.spaces if isinstance(space, gymnasium.spaces.Dict) else {"": space}
        self._names = [name for name in spaces if name]
        self._checked = [name for name, space in spaces.items() if np.issubdtype(space.dtype, np.floating)]
        self.workers = Workers(min(threads, len(self.envs)))
        self._stepping: SharedWork | None = None
        self._seed = seed
        self._env_seeds: list[int] = np.random.SeedSequence(seed).generate_state(self.num_envs).tolist()
        self._actions = np.zeros((self.num_envs, *(first.action_space.shape or ())))
        self._returns, self._lengths = np.zeros(self.num_envs), np.zeros(self.num_envs, int)
        self._fresh = np.ones(self.num_envs, bool)
        self._paths: list[list[NDArray[Any]]] = [[] for _ in self.envs]
        self.decisions = 0

    def reset(self) -> Observations:
        """Starts an episode everywhere, seeded at the first call and going on from there afterwards."""
        starts = [self._draw(index) for index in range(self.num_envs)]
        seeds: list[int | None] = [*self._env_seeds] if self._env_seeds else [None] * self.num_envs
        self._env_seeds = []
        observations = self._each(lambda index: self._begin(index, starts[index], seeds[index]))
        return self._batch(observations)

    def step_async(self, actions: NDArray[Any]) -> None:
        """Takes the actions of the next `step_wait`, and begins with it where there are helpers.

        Args:
            actions: shape (environments, actions).
        """
        self._actions = actions
        self._stepping = self.workers.begin(self._advance, range(self.num_envs))

    def step_wait(self) -> tuple[Observations, NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Steps every environment with the actions of `step_async`.

        Raises:
            NotFiniteError: an observation or a reward is not finite.
        """
        assert self._stepping is not None
        results = self._stepping.finish()
        self._stepping = None
        self.decisions += 1
        observations = [result[0] for result in results]
        rewards = np.array([result[1] for result in results], np.float32)
        dones = np.array([result[2] or result[3] for result in results])
        infos: list[dict[str, Any]] = [result[4] for result in results]
        if not np.isfinite(rewards).all():
            raise NotFiniteError(self._complaint("the reward", int(np.argmin(np.isfinite(rewards)))))
        if dones.any():
            self._check(self._batch(observations))
            ended = np.flatnonzero(dones).tolist()
            for index in ended:
                self._finish(index, observations[index], results[index][2], infos[index])
            # drawn here and in order, so that the number of threads changes nothing
            starts = {index: self._draw(index) for index in ended}
            fresh = self._each(lambda index: self._begin(index, starts[index], None), ended)
            for index, observation in zip(ended, fresh, strict=True):
                observations[index] = observation
        batch = self._batch(observations)
        self._check(batch)
        return batch, rewards, dones, infos

    def step(self, actions: NDArray[Any]) -> tuple[Observations, NDArray[np.float32], NDArray[np.bool_], list[Any]]:
        """`step_async` and `step_wait`."""
        self.step_async(actions)
        return self.step_wait()

    def _advance(self, index: int) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        env, action, total = self.envs[index], self._actions[index], 0.0
        taken, terminated, truncated = 0, False, False
        while taken < self.action_repeat and not (terminated or truncated):
            observation, reward, terminated, truncated, info = env.step(action)
            taken, total = taken + 1, total + float(reward)
            self._lengths[index] += 1
            if (
                self.start_state_buffer is not None
                and self._lengths[index] % RECORD_EVERY == 0
                and not (terminated or truncated)
            ):
                self._paths[index].append(self._start_states[index]())
        self._returns[index] += total
        info["steps"] = taken
        return observation, total, terminated, truncated, info

    def _draw(self, index: int) -> dict[str, Any] | None:
        """Options of the next episode's reset."""
        start = None if self.start_state_buffer is None else self.start_state_buffer.draw()
        self._fresh[index] = start is None
        if start is not None:
            return {"start": start}
        case = None if self.start_state_buffer is None else self.start_state_buffer.choose_case()
        return None if case is None else {"case": case}

    def _begin(self, index: int, options: dict[str, Any] | None, seed: int | None) -> Any:
        self._returns[index], self._lengths[index] = 0.0, 0
        observation, _ = self.envs[index].reset(seed=seed, options=options)
        self._paths[index] = [] if self.start_state_buffer is None else [self._start_states[index]()]
        return observation

    def _finish(self, index: int, observation: Any, terminated: bool, info: dict[str, Any]) -> None:
        success = bool(info.get("success", terminated))
        info["terminal_observation"] = observation
        info["TimeLimit.truncated"] = not terminated
        info["episode"] = {
            "r": float(self._returns[index]),
            "l": int(self._lengths[index]),
            "success": success,
            "fresh": bool(self._fresh[index]),
        }
        if self.start_state_buffer is not None and self._fresh[index] and "case" in info:
            self.start_state_buffer.record_outcome(info["case"], success=success)
        # episodes from the start-state buffer would fill it with states near the target alone
        if success and self.start_state_buffer is not None and self._fresh[index]:
            self.start_state_buffer.add_episode(np.stack(self._paths[index]))

    def _each(self, work: Callable[[int], Any], indices: Sequence[int] | None = None) -> list[Any]:
        return self.workers.each(work, range(self.num_envs) if indices is None else indices)

    def _batch(self, observations: list[Any]) -> Observations:
        if self._names:
            return {name: np.stack([observation[name] for observation in observations]) for name in self._names}
        return np.stack(observations)

    def _check(self, batch: Observations) -> None:
        for name in self._checked:
            values = batch[name] if isinstance(batch, dict) else batch
            if not np.isfinite(values).all():
                bad = ~np.isfinite(values.reshape(self.num_envs, -1)).all(axis=1)
                raise NotFiniteError(
                    self._complaint(f"observation '{name}'" if name else "the observation", bad.argmax())
                )

    def _complaint(self, what: str, index: int | np.integer[Any]) -> str:
        return (
            f"{what} of environment {index} is not finite after {self.decisions * self.num_envs} decisions: training "
            "stops here; look at the environment's state and the actions that led to it"
        )

    def state(self) -> dict[str, Any]:
        """Everything that the rest of the sampling depends on, as plain data; for `restore`.

        Environments without `state()` cannot be saved: `restore` starts new episodes in them. Wrappers are taken
        to have no state of their own.
        """
        return {
            "envs": [env.unwrapped.state() if hasattr(env.unwrapped, "state") else None for env in self.envs],
            "seeds": list(self._env_seeds),
            "returns": self._returns.copy(),
            "lengths": self._lengths.copy(),
            "fresh": self._fresh.copy(),
            "paths": [np.stack(path) if path else None for path in self._paths],
            "decisions": self.decisions,
            "start_state_buffer": None if self.start_state_buffer is None else self.start_state_buffer.state(),
        }

    def restore(self, state: dict[str, Any]) -> Observations:
        """Goes on where environments of the same factories were saved.

        Returns:
            The observations of that moment.

        Raises:
            ValueError: the state is of another number of environments, or of another wire.
        """
        if len(state["envs"]) != self.num_envs:
            raise ValueError(f"the saved sampling has {len(state['envs'])} environments, this one {self.num_envs}")
        self._env_seeds, self.decisions = list(state["seeds"]), state["decisions"]
        if self.start_state_buffer is not None and state["start_state_buffer"] is not None:
            self.start_state_buffer.restore(state["start_state_buffer"])
        if any(saved is None for saved in state["envs"]):
            logger.warning("environments without state() cannot go on exactly: they start new episodes")
            again = np.random.SeedSequence((self._seed, self.decisions))
            self._env_seeds = again.generate_state(self.num_envs).tolist()
            return self.reset()
        self._returns[:], self._lengths[:], self._fresh[:] = state["returns"], state["lengths"], state["fresh"]
        self._paths = [[] if path is None else list(path) for path in state["paths"]]

        def back(index: int) -> Any:
            env = self.envs[index]
            observation_wrappers = []
            if env is not env.unwrapped:
                env.reset()  # wrappers want to have seen one
            while env is not env.unwrapped:
                if isinstance(env, gymnasium.ObservationWrapper):
                    observation_wrappers.append(env)
                if isinstance(env, gymnasium.wrappers.TimeLimit):
                    env._elapsed_steps = int(self._lengths[index])  # type: ignore[assignment]
                env = env.env  # type: ignore[attr-defined]
            observation = env.restore(state["envs"][index])  # type: ignore[attr-defined]
            for wrapper in reversed(observation_wrappers):
                observation = wrapper.observation(observation)
            return observation

        return self._batch(self._each(back))

    def close(self) -> None:
        """Ends the threads and closes the environments."""
        self.workers.close()
        for env in self.envs:
            env.close()

    def each_of(self, read: Callable[[Any], Any], indices: Sequence[int]) -> list[Any]:
        """What a function gives of some environments."""
        return [read(self.envs[index]) for index in indices]


def without_checks(env: gymnasium.Env[Any, Any]) -> gymnasium.Env[Any, Any]:
    """The environment without the wrappers of `gymnasium.make` that only check its use, which cost time a step."""
    while isinstance(env, OrderEnforcing | PassiveEnvChecker):
        env = env.env
    return env


def start_state_of(env: gymnasium.Env[Any, Any]) -> Callable[[], NDArray[Any]]:
    """The function that gives the state from which an episode of this environment can be started.

    Raises:
        ValueError: the environment has none.
    """
    inner: Any = env.unwrapped
    if hasattr(inner, "start_state"):
        return inner.start_state
    if hasattr(inner, "simulation"):
        return inner.simulation.state
    raise ValueError(
        f"{type(inner).__name__} cannot start from a start-state buffer: it needs start_state() or a simulation with "
        "state(); train with start_state_buffer_share=0"
    )
