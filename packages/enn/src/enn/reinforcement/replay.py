"""Replay buffer that fits memory: observations stored once, images compressed; only what was changed is saved again."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.buffers import ReplayBuffer as BaseReplayBuffer
from stable_baselines3.common.type_aliases import DictReplayBufferSamples, ReplayBufferSamples
from stable_baselines3.common.vec_env import VecNormalize

from enn.reinforcement.observation_store import FrameStore, bytes_per_observation, make_store
from enn.reinforcement.resources import available_bytes
from enn.trajectory import Trajectory

CHUNK = 512  # slots that are saved together
_STORED, _LARGE = "observation_", ("actions", "rewards", "dones")
ASIDE_SHARE = 0.02  # of the transitions end an episode, as far as a size is estimated


class ReplayBuffer(BaseReplayBuffer):
    """Transitions of several environments; draws exactly what stable-baselines3's buffers would for the same indices.

    The next observation of a transition is the observation of the following slot; only the last observations of
    episodes are kept aside. Draws come from the buffer's own generator.

    Args:
        buffer_size: number of transitions kept, all environments together.
        demonstrations: a filled buffer of the same spaces.
        demonstration_share: of each batch, drawn from the demonstrations.

    Raises:
        MemoryError: it would not fit the memory that is available.
    """

    def __init__(
        self,
        buffer_size: int,
        observation_space: gymnasium.Space[Any],
        action_space: gymnasium.Space[Any],
        device: torch.device | str = "cpu",
        n_envs: int = 1,
        optimize_memory_usage: bool = False,
        *,
        half: bool = False,
        seed: int = 0,
        demonstrations: ReplayBuffer | None = None,
        demonstration_share: float = 0.0,
    ) -> None:
        if not 0.0 <= demonstration_share < 1.0:
            raise ValueError(f"demonstration_share must be at least 0 and below 1, got {demonstration_share}")
        needed, free = nbytes_needed(observation_space, buffer_size, action_space, half=half), available_bytes()
        if needed > free:
            raise MemoryError(
                f"a replay buffer of {buffer_size:,} transitions needs {needed / 1e9:.1f} GB, of which "
                f"{free / 1e9:.1f} GB are available: set a smaller buffer_size"
            )
        # not the parent's initialiser: that one allocates every observation twice
        super(BaseReplayBuffer, self).__init__(buffer_size, observation_space, action_space, device, n_envs=n_envs)
        self.buffer_size = max(buffer_size // n_envs, 1)
        self._slots = self.buffer_size + 1
        self._names = list(observation_space) if isinstance(observation_space, gymnasium.spaces.Dict) else []
        boxes = observation_space.spaces if self._names else {"": observation_space}  # type: ignore[attr-defined]
        self._stores = {name: make_store(name, box, (self._slots, n_envs), half) for name, box in boxes.items()}
        self._aside = {name: make_store(name, box, (16,), half) for name, box in boxes.items()}
        self._aside_row = np.full((self._slots, n_envs), -1, np.int32)
        self._free = list(range(15, -1, -1))
        self.actions = np.zeros((self._slots, n_envs, self.action_dim), np.float32)
        self.rewards = np.zeros((self._slots, n_envs), np.float32)
        self.dones = np.zeros((self._slots, n_envs), np.float32)
        self.added = 0
        self._versions = np.zeros(-(-self._slots // CHUNK), np.int64)
        self._generator = np.random.default_rng(seed)
        self.demonstrations, self.demonstration_share = demonstrations, demonstration_share

    @property
    def nbytes(self) -> int:
        """Bytes allocated; images take more as they come."""
        stores = (*self._stores.values(), *self._aside.values())
        rest = (self.actions, self.rewards, self.dones, self._aside_row)
        return sum(store.nbytes for store in stores) + sum(array.nbytes for array in rest)

    def add(
        self,
        obs: Any,
        next_obs: Any,
        action: NDArray[Any],
        reward: NDArray[Any],
        done: NDArray[Any],
        infos: list[dict[str, Any]],
    ) -> None:
        """Stores one transition of every environment.

        Args:
            obs: what was seen. Name to (environments, ...).
            next_obs: what followed, the last observation where an episode ended. Name to (environments, ...).
            action: shape (environments, actions).
            reward: shape (environments,).
            done: whether the episode ended. Shape (environments,).
            infos: with `TimeLimit.truncated` where an episode was cut off rather than ended.
        """
        slot = self.added % self._slots
        after = (slot + 1) % self._slots
        done = np.asarray(done, bool)
        for row in self._aside_row[slot]:
            if row >= 0:
                self._free.append(int(row))
        self._aside_row[slot] = -1
        for name, store in self._stores.items():
            store.write(slot, obs[name] if name else obs)
            store.write(after, next_obs[name] if name else next_obs)
        for env in np.flatnonzero(done):
            row = self._aside_place()
            self._aside_row[slot, env] = row
            for name, store in self._aside.items():
                store.write(row, (next_obs[name] if name else next_obs)[env])
        cut = np.fromiter((bool(info.get("TimeLimit.truncated", False)) for info in infos), bool, len(infos))
        self.actions[slot] = np.asarray(action, np.float32).reshape(self.n_envs, self.action_dim)
        self.rewards[slot], self.dones[slot] = reward, done & ~cut
        self.added += 1
        self._versions[slot // CHUNK] += 1
        if after // CHUNK != slot // CHUNK:
            self._versions[after // CHUNK] += 1
        self.full = self.added >= self.buffer_size
        self.pos = self.added % self.buffer_size
        if self.added >= CHUNK and self.added.bit_count() == 1 and not self.full:
            self._require_memory()

    def _require_memory(self) -> None:
        """Refuses images that compress so little that the rest of them will not fit."""
        images = [store for store in self._stores.values() if isinstance(store, FrameStore)]
        now = sum(store.nbytes for store in images)
        more, free = now * (self._slots - self.added) / self.added, available_bytes()
        if more > free:
            each, count = now / (self.added * self.n_envs), self.buffer_size * self.n_envs
            raise MemoryError(
                f"images take {each:,.0f} bytes a transition in the replay buffer, so that {count:,} of them need "
                f"{more / 1e9:.1f} GB more, of which {free / 1e9:.1f} GB are available: set a smaller buffer_size, or "
                "take images without noise"
            )

    def _aside_place(self) -> int:
        if not self._free:
            rows = self._aside[next(iter(self._aside))].rows
            for store in self._aside.values():
                store.grow(2 * rows)
            self._free = list(range(2 * rows - 1, rows - 1, -1))
        return self._free.pop()

    def demonstrations_in(self, batch_size: int) -> int:
        """How many transitions of a batch are those of demonstrations: its last ones."""
        return round(batch_size * self.demonstration_share) if self.demonstrations is not None else 0

    def sample(self, batch_size: int, env: VecNormalize | None = None) -> Any:
        """Draws transitions, each equally likely; the demonstrations' share of them, the last ones, from there."""
        filled = min(self.added, self.buffer_size)
        if filled == 0:
            raise ValueError("the replay buffer is empty: nothing can be drawn from it")
        borrowed = self.demonstrations_in(batch_size)
        rows = self._generator.integers(0, filled, batch_size - borrowed)
        envs = self._generator.integers(0, self.n_envs, batch_size - borrowed)
        parts = self._arrays(rows, envs)
        if self.demonstrations is not None and borrowed:
            other = self.demonstrations
            rows = self._generator.integers(0, min(other.added, other.buffer_size), borrowed)
            envs = self._generator.integers(0, other.n_envs, borrowed)
            parts = _joined(parts, other._arrays(rows, envs))
        return self._tensors(parts)

    def gather(self, rows: NDArray[np.integer[Any]], envs: NDArray[np.integer[Any]]) -> Any:
        """The transitions of given rows (of stable-baselines3's ring) and environments, as tensors."""
        return self._tensors(self._arrays(rows, envs))

    def _arrays(self, rows: NDArray[Any], envs: NDArray[Any]) -> dict[str, Any]:
        # row i of a ring of `buffer_size` holds the latest transition whose number leaves the remainder i
        slots = (self.added - 1 - (self.added - 1 - rows) % self.buffer_size) % self._slots
        aside = self._aside_row[slots, envs]
        ends = np.flatnonzero(aside >= 0)
        flat, after = slots * self.n_envs + envs, (slots + 1) % self._slots * self.n_envs + envs
        parts: dict[str, Any] = {"obs": {}, "next": {}}
        for name, store in self._stores.items():
            both = store.read(np.concatenate((flat, after)))  # together, for they share images
            parts["obs"][name], following = both[: len(flat)], both[len(flat) :]
            if len(ends):
                following[ends] = self._aside[name].read(aside[ends])
            parts["next"][name] = following
        parts["actions"] = self.actions.reshape(-1, self.action_dim)[flat]
        parts["dones"], parts["rewards"] = self.dones.reshape(-1, 1)[flat], self.rewards.reshape(-1, 1)[flat]
        return parts

    def _tensors(self, parts: dict[str, Any]) -> ReplayBufferSamples | DictReplayBufferSamples:
        def side(which: str) -> Any:
            tensors = {name: self.to_torch(array, copy=False) for name, array in parts[which].items()}
            return tensors if self._names else tensors[""]

        rest = {name: self.to_torch(parts[name], copy=False) for name in ("actions", "dones", "rewards")}
        kind = DictReplayBufferSamples if self._names else ReplayBufferSamples
        return kind(observations=side("obs"), next_observations=side("next"), **rest)

    def state(self) -> dict[str, Any]:
        """What is small: counts, ends of episodes and random state; `chunks` gives the rest."""
        return {
            "added": self.added,
            "aside": {name: store.saved(0, store.rows) for name, store in self._aside.items()},
            "aside_rows": self._aside[next(iter(self._aside))].rows,
            "references": {
                name: (store.reference, aside.reference)
                for (name, store), aside in zip(self._stores.items(), self._aside.values(), strict=True)
                if isinstance(store, FrameStore) and isinstance(aside, FrameStore)
            },
            "aside_row": self._aside_row,
            "free": list(self._free),
            "versions": self._versions.copy(),
            "generator": self._generator.bit_generator.state,
        }

    def chunks(self) -> Iterator[tuple[str, int, NDArray[Any]]]:
        """What is large, in pieces: name, version and array; a piece of the same name and version has not changed."""
        used = min(self.added + 1, self._slots)
        for chunk, version in enumerate(self._versions):
            first, last = chunk * CHUNK, min((chunk + 1) * CHUNK, used)
            if first < last:
                for name, store in self._stores.items():
                    yield f"{_STORED}{name}.{chunk}", int(version), store.saved(first, last)
                for name in _LARGE:
                    yield f"{name}.{chunk}", int(version), getattr(self, name)[first:last]

    def restore(self, state: dict[str, Any], chunks: dict[str, NDArray[Any]]) -> None:
        """Returns to a saved buffer of the same size and spaces.

        Args:
            state: from `state`.
            chunks: name to array, from `chunks`.

        Raises:
            ValueError: it was saved with another size.
        """
        if state["aside_row"].shape != self._aside_row.shape:
            raise ValueError(
                f"the saved replay buffer has {state['aside_row'].shape} slots and environments, this one "
                f"{self._aside_row.shape}: keep buffer_size and n_envs as they were"
            )
        self.added = state["added"]
        self.full, self.pos = self.added >= self.buffer_size, self.added % self.buffer_size
        self._aside_row[:], self._versions[:] = state["aside_row"], state["versions"]
        self._free = list(state["free"])
        for name, array in state["aside"].items():
            self._aside[name].grow(state["aside_rows"])
            self._aside[name].put_back(0, state["aside_rows"], array)
        for name, references in state["references"].items():
            for store, reference in zip((self._stores[name], self._aside[name]), references, strict=True):
                assert isinstance(store, FrameStore)
                store.reference = reference
        self._generator.bit_generator.state = state["generator"]
        used = min(self.added + 1, self._slots)
        for key, array in chunks.items():
            name, _, chunk = key.rpartition(".")
            first, last = int(chunk) * CHUNK, min((int(chunk) + 1) * CHUNK, used)
            if name.startswith(_STORED):
                self._stores[name.removeprefix(_STORED)].put_back(first, last, array)
            else:
                getattr(self, name)[first:last] = array


def nbytes_needed(
    space: gymnasium.Space[Any], capacity: int, action_space: gymnasium.Space[Any] | None = None, *, half: bool = False
) -> int:
    """Bytes of a replay buffer of a capacity, all environments together.

    Args:
        action_space: of the actions; without it, two of them.
    """
    boxes = space.spaces.values() if isinstance(space, gymnasium.spaces.Dict) else [space]
    names = list(space) if isinstance(space, gymnasium.spaces.Dict) else [""]
    observation = sum(bytes_per_observation(name, box, half) for name, box in zip(names, boxes, strict=True))
    actions = 2 if action_space is None else int(np.prod(action_space.shape or ()))
    return int(capacity * (observation * (1 + ASIDE_SHARE) + 4 * actions + 12))


def _joined(first: Any, second: Any) -> Any:
    if isinstance(first, dict):
        return {key: _joined(first[key], second[key]) for key in first}
    return np.concatenate((first, second))


def demonstration_replay(
    trajectories: Sequence[Trajectory],
    space: gymnasium.Space[Any],
    action_space: gymnasium.spaces.Box,
    *,
    action_repeat: int = 1,
    encode: Callable[[dict[str, Any]], dict[str, Any]] | None = None,
    seed: int = 0,
) -> ReplayBuffer:
    """A replay buffer filled with demonstrations.

    With an action repeat, a decision is the mean of the actions that it stands for, and the sum of their rewards: an
    approximation, since the demonstrator did not hold them.

    Args:
        trajectories: with rewards of the task that is trained; at least one.
        encode: observations, name to (T + 1, ...), to those that reach the network.

    Raises:
        ValueError: there are no trajectories, or one lacks an observation.
    """
    if not trajectories:
        raise ValueError("there are no demonstrations to put into the replay buffer")
    names = list(space) if isinstance(space, gymnasium.spaces.Dict) else []
    decisions = sum(-(-len(trajectory) // action_repeat) for trajectory in trajectories)
    buffer = ReplayBuffer(decisions, space, action_space, seed=seed)
    half = 0.5 * (action_space.high - action_space.low)
    for trajectory in trajectories:
        if encode is not None:
            seen = encode(trajectory.observations)
        else:
            trajectory.require(names)
            seen = trajectory.observations
        for start in range(0, len(trajectory), action_repeat):
            end = min(start + action_repeat, len(trajectory))
            last = end == len(trajectory)
            before = {name: seen[name][start][None] for name in names}
            after = {name: seen[name][end][None] for name in names}
            if not names:
                single = next(iter(seen.values()))
                before, after = single[start][None], single[end][None]
            action = (trajectory.actions[start:end].mean(axis=0) - action_space.low) / half - 1.0
            cut = [{"TimeLimit.truncated": not trajectory.terminated}]
            reward = trajectory.rewards[start:end].sum()
            buffer.add(before, after, action[None], np.array([reward]), np.array([last]), cut)
    return buffer
