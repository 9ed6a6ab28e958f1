"""The replay buffer: samples, memory, demonstrations, frames that are kept once."""

from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from stable_baselines3.common.buffers import DictReplayBuffer

from enn.reinforcement import replay as replay_module
from enn.reinforcement.observation_store import FrameStore, ObservationStore
from enn.reinforcement.replay import ReplayBuffer, nbytes_needed

SPACE = gymnasium.spaces.Dict(
    [
        ("image", gymnasium.spaces.Box(0, 255, (1, 9, 9), np.uint8)),
        ("joints", gymnasium.spaces.Box(-np.inf, np.inf, (5,), np.float32)),
        ("mask", gymnasium.spaces.Box(0, 255, (1, 9, 9), np.uint8)),
    ]
)
ACTIONS = gymnasium.spaces.Box(-1, 1, (2,), np.float32)


def _stream(count: int, n_envs: int, seed: int = 0) -> list[tuple[Any, ...]]:
    """Transitions as they come from environments: what follows is what is seen next, unless an episode ended."""
    generator = np.random.default_rng(seed)

    def observe() -> dict[str, np.ndarray]:
        return {
            "image": generator.integers(0, 256, (n_envs, 1, 9, 9), np.uint8),
            "joints": generator.standard_normal((n_envs, 5)).astype(np.float32),
            "mask": generator.integers(0, 2, (n_envs, 1, 9, 9), np.uint8) * np.uint8(255),
        }

    moments, now = [], observe()
    for _ in range(count):
        following, done = observe(), generator.random(n_envs) < 0.15
        cut = done & (generator.random(n_envs) < 0.5)
        last = {name: values.copy() for name, values in following.items()}
        fresh = observe()
        for name, values in last.items():
            values[done] = fresh[name][done]
        infos = [{"TimeLimit.truncated": bool(flag)} for flag in cut]
        action = generator.uniform(-1, 1, (n_envs, 2)).astype(np.float32)
        moments.append((now, last, action, generator.random(n_envs).astype(np.float32), done, infos))
        now = following
    return moments


def _equal(first: Any, second: Any) -> None:
    for one, other in zip(first, second, strict=True):
        if one is None or other is None:
            assert one is other
        elif isinstance(one, dict):
            assert list(one) == list(other)
            for name in one:
                assert one[name].dtype == other[name].dtype
                assert torch.equal(one[name], other[name]), name
        else:
            assert torch.equal(one, other)


@pytest.mark.parametrize(("n_envs", "count"), [(1, 7), (3, 75)])
def test_the_same_transitions_as_the_library(n_envs: int, count: int) -> None:
    mine = ReplayBuffer(20 * n_envs, SPACE, ACTIONS, n_envs=n_envs)
    theirs = DictReplayBuffer(20 * n_envs, SPACE, ACTIONS, n_envs=n_envs)
    for moment in _stream(count, n_envs):
        mine.add(*moment)
        theirs.add(*moment)
    there = min(count, 20)
    rows, envs = np.divmod(np.arange(there * n_envs), n_envs)
    drawn = mine.gather(rows, envs)
    for name in SPACE:
        assert torch.equal(drawn.observations[name], torch.as_tensor(theirs.observations[name][rows, envs]))
        assert torch.equal(drawn.next_observations[name], torch.as_tensor(theirs.next_observations[name][rows, envs]))
    assert torch.equal(drawn.actions, torch.as_tensor(theirs.actions[rows, envs]))
    assert torch.equal(drawn.rewards[:, 0], torch.as_tensor(theirs.rewards[rows, envs]))
    ended = theirs.dones[rows, envs] * (1 - theirs.timeouts[rows, envs])
    assert torch.equal(drawn.dones[:, 0], torch.as_tensor(ended))


def test_the_same_samples_as_the_library_from_the_same_generator(monkeypatch: pytest.MonkeyPatch) -> None:
    mine, theirs = ReplayBuffer(40, SPACE, ACTIONS, n_envs=2, seed=4), DictReplayBuffer(40, SPACE, ACTIONS, n_envs=2)
    for moment in _stream(50, 2):
        mine.add(*moment)
        theirs.add(*moment)
    generator = np.random.default_rng(4)
    monkeypatch.setattr(np.random, "randint", lambda low, high, size: generator.integers(low, high, size))
    for _ in range(3):
        _equal(mine.sample(64), theirs.sample(64))


def test_bytes_are_as_foretold_and_a_fraction_of_the_librarys() -> None:
    space = gymnasium.spaces.Dict(
        {
            "image": gymnasium.spaces.Box(0, 255, (1, 80, 80), np.uint8),
            "mask": gymnasium.spaces.Box(0, 255, (1, 80, 80), np.uint8),
            "joints": gymnasium.spaces.Box(-np.inf, np.inf, (336,), np.float32),
        }
    )
    needed = nbytes_needed(space, 1_000_000)
    assert 2.45e9 < needed < 2.65e9  # 320 + 800 + 1,344 bytes a transition, and little else
    assert nbytes_needed(space, 1_000_000, half=True) == pytest.approx(needed - 672e6, rel=0.01)
    buffer = ReplayBuffer(1000, space, ACTIONS, n_envs=4)
    wire = np.zeros((4, 1, 80, 80), np.uint8)
    for step in range(250):  # a wire of 3 px that moves in front of a fixed background
        wire[:] = np.arange(6400, dtype=np.uint32).reshape(80, 80) * 7 % 251
        wire[:, 0, 10 : 20 + step // 5, 38:41] -= np.uint8(40 + step % 7)
        seen = {"image": wire.copy(), "mask": 0 * wire, "joints": np.zeros((4, 336), np.float32)}
        buffer.add(seen, seen, np.zeros((4, 2)), np.zeros(4), np.zeros(4, bool), [{}] * 4)
    assert 0.7 * nbytes_needed(space, 1000, ACTIONS) < buffer.nbytes < 1.05 * nbytes_needed(space, 1000, ACTIONS)
    theirs = DictReplayBuffer(1000, space, ACTIONS, n_envs=4)
    both = (*theirs.observations.values(), *theirs.next_observations.values())
    assert sum(array.nbytes for array in both) > 7 * buffer.nbytes


def test_too_little_memory_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(replay_module, "available_bytes", lambda: 1_000_000)
    with pytest.raises(MemoryError, match=r"1,000,000 transitions needs 0.1 GB"):
        ReplayBuffer(1_000_000, SPACE, ACTIONS)


def test_images_that_do_not_compress_are_refused_before_they_fill_the_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    buffer = ReplayBuffer(100_000, SPACE, ACTIONS)
    monkeypatch.setattr(replay_module, "available_bytes", lambda: 5_000_000)
    stream = _stream(600, 1)

    def fill() -> None:
        for moment in stream:
            buffer.add(*moment)

    with pytest.raises(MemoryError, match=r"images take 1\d\d bytes a transition"):
        fill()
    assert buffer.added == 512


def test_demonstrations_make_up_their_share() -> None:
    expert = ReplayBuffer(50, SPACE, ACTIONS)
    for now, last, action, reward, done, infos in _stream(50, 1, seed=9):
        expert.add(now, last, action, reward * 0 - 7, done, infos)
    buffer = ReplayBuffer(50, SPACE, ACTIONS, n_envs=2, demonstrations=expert, demonstration_share=0.25)
    for moment in _stream(10, 2):
        buffer.add(*moment)
    drawn = buffer.sample(40)
    assert int((drawn.rewards == -7).sum()) == 10
    assert drawn.next_observations["mask"].shape == (40, 1, 9, 9)
    with pytest.raises(ValueError, match="demonstration_share must be at least 0 and below 1"):
        ReplayBuffer(50, SPACE, ACTIONS, demonstration_share=1.0)


@pytest.mark.parametrize("before", [11, 64])
def test_goes_on_exactly_after_a_restore(before: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(replay_module, "CHUNK", 8)
    stream, source = _stream(before + 30, 2), Stacks(noisy=False)
    for space, moments in ((SPACE, stream), (STACKED, [source.step(0.2) for _ in stream])):
        first, second = (ReplayBuffer(60, space, ACTIONS, n_envs=2, seed=seed) for seed in (1, 2))
        for moment in moments[:before]:
            first.add(*moment)
        first.sample(5)
        second.restore(first.state(), {name: array.copy() for name, _, array in first.chunks()})
        for moment in moments[before:]:
            first.add(*moment)
            second.add(*moment)
            _equal(first.sample(16), second.sample(16))


def test_refusals_say_why() -> None:
    with pytest.raises(ValueError, match="replay buffer is empty"):
        ReplayBuffer(10, SPACE, ACTIONS).sample(4)
    store = ObservationStore("mask", SPACE["mask"], (3,))
    with pytest.raises(ValueError, match="'mask' must hold 0 and 255 alone"):
        store.write(0, np.full((1, 9, 9), 1, np.uint8))
    other = ReplayBuffer(10, SPACE, ACTIONS)
    with pytest.raises(ValueError, match="keep buffer_size and n_envs as they were"):
        ReplayBuffer(20, SPACE, ACTIONS).restore(other.state(), {})


SIDE, STACK, ENVS = 48, 3, 2
STACKED = gymnasium.spaces.Box(0, 255, (STACK, SIDE, SIDE), np.uint8)


class Stacks:
    """Environments whose observation is their last three images: a wire before a background, noisy on request."""

    def __init__(self, noisy: bool, seed: int = 0) -> None:
        self.generator, self.noisy = np.random.default_rng(seed), noisy
        self.background = self.generator.integers(60, 250, (SIDE, SIDE), np.uint8)
        self.length = np.zeros(ENVS, int)
        self.stacks = np.stack([self._first(env) for env in range(ENVS)])

    def _image(self, env: int) -> np.ndarray:
        image = self.background.copy()
        image[: self.length[env], 20:23] -= np.uint8(50)
        return image + self.generator.integers(0, 5, image.shape, np.uint8) if self.noisy else image

    def _first(self, env: int) -> np.ndarray:
        self.length[env] = self.generator.integers(1, 10)
        return np.stack([self._image(env)] * STACK)  # as an episode begins

    def step(self, chance: float) -> tuple[Any, ...]:
        """A transition as stable-baselines3 gives it."""
        before, last = self.stacks, self.stacks.copy()
        done = self.generator.random(ENVS) < chance
        for env in range(ENVS):
            self.length[env] += 1
            last[env] = np.concatenate((before[env][1:], self._image(env)[None]))
        after = np.stack([self._first(env) if done[env] else last[env] for env in range(ENVS)])
        self.stacks = after
        return before, last, np.zeros((ENVS, 2), np.float32), np.zeros(ENVS), done, [{}] * ENVS


def _filled(count: int, capacity: int, *, noisy: bool = False) -> tuple[ReplayBuffer, list[tuple[Any, ...]]]:
    buffer, source = ReplayBuffer(capacity * ENVS, STACKED, ACTIONS, n_envs=ENVS), Stacks(noisy)
    moments = [source.step(0.1) for _ in range(count)]
    for moment in moments:
        buffer.add(*moment)
    return buffer, moments


def _same(buffer: ReplayBuffer, moments: list[tuple[Any, ...]], capacity: int) -> None:
    rows, envs = np.divmod(np.arange(min(len(moments), capacity) * ENVS), ENVS)
    drawn = buffer.gather(rows, envs)
    for place, (row, env) in enumerate(zip(rows.tolist(), envs.tolist(), strict=True)):
        numbers = [number for number in range(len(moments)) if number % capacity == row]
        before, last, *_ = moments[numbers[-1]]
        np.testing.assert_array_equal(drawn.observations[place], before[env])
        np.testing.assert_array_equal(drawn.next_observations[place], last[env])


@pytest.mark.parametrize(("count", "noisy"), [(5, False), (40, True), (97, False)])
def test_every_bit_comes_back_also_where_episodes_end(count: int, noisy: bool) -> None:
    buffer, moments = _filled(count, 40, noisy=noisy)
    _same(buffer, moments, 40)


def test_each_frame_of_a_stack_is_kept_once() -> None:
    buffer, moments = _filled(200, 300)
    store = buffer._stores[""]
    assert isinstance(store, FrameStore)
    frames = {id(frame) for stack in store._rows if stack is not None for frame in stack}
    ended = sum(int(moment[4].sum()) for moment in moments)
    assert len(frames) <= 200 * ENVS + STACK * (ended + ENVS)
    assert len({id(frame) for frame in (store._rows[0] or ())}) == STACK  # as the stacks began
    plain = 200 * ENVS * STACK * SIDE * SIDE
    assert store.nbytes < plain / 30
