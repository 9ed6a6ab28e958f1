"""Frames: compressed without loss, each of a stack kept once, saved and put back."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
import torch

from enn.reinforcement.observation_store import FrameStore
from enn.reinforcement.replay import ReplayBuffer

SIDE, STACK, ENVS = 48, 3, 2
SPACE = gymnasium.spaces.Box(0, 255, (STACK, SIDE, SIDE), np.uint8)
ACTIONS = gymnasium.spaces.Box(-1, 1, (2,), np.float32)


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
    buffer, source = ReplayBuffer(capacity * ENVS, SPACE, ACTIONS, n_envs=ENVS), Stacks(noisy)
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


@pytest.mark.parametrize("noisy", [False, True])
@pytest.mark.parametrize("count", [5, 40, 97])
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


def test_saved_frames_go_back_and_the_buffer_goes_on_the_same() -> None:
    first, moments = _filled(70, 40)
    second = ReplayBuffer(40 * ENVS, SPACE, ACTIONS, n_envs=ENVS)
    second.restore(first.state(), {name: array.copy() for name, _, array in first.chunks()})
    _same(second, moments, 40)
    source = Stacks(noisy=False, seed=5)
    for _ in range(30):
        moment = source.step(0.2)
        first.add(*moment)
        second.add(*moment)
    for _ in range(3):
        one, other = first.sample(50), second.sample(50)
        assert torch.equal(one.observations, other.observations)
        assert torch.equal(one.next_observations, other.next_observations)


def test_an_unchanged_piece_has_unchanged_bytes() -> None:
    buffer, _ = _filled(600, 1000)
    pieces = {name: (version, array.copy()) for name, version, array in buffer.chunks()}
    source = Stacks(noisy=False, seed=3)
    for _ in range(5):
        buffer.add(*source.step(0.1))
    unchanged = [
        np.array_equal(array, pieces[name][1])
        for name, version, array in buffer.chunks()
        if pieces[name][0] == version and name.startswith("observation")
    ]
    assert unchanged == [True]


def test_frames_of_another_buffer_are_refused() -> None:
    store = FrameStore("image", SPACE, (4, 1))
    with pytest.raises(ValueError, match="the saved frames of 'image' are of another size"):
        store.put_back(0, 4, np.zeros(3, np.uint8))
    other = FrameStore("image", SPACE, (8, 1))
    other.write(0, np.zeros((1, STACK, SIDE, SIDE), np.uint8))
    with pytest.raises(ValueError, match="the saved frames of 'image' are of another size"):
        store.put_back(0, 4, other.saved(0, 8))
    store.put_back(0, 4, other.saved(0, 4))
    np.testing.assert_array_equal(store.read(np.array([0, 3])), 0)


def test_rows_grow() -> None:
    store = FrameStore("image", SPACE, (2,))
    image = np.random.default_rng(0).integers(0, 256, (STACK, SIDE, SIDE), np.uint8)
    store.write(1, image)
    store.grow(4)
    assert store.rows == 4
    np.testing.assert_array_equal(store.read(np.array([1]))[0], image)
