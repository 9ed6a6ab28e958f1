"""The replay buffer: the same samples as stable-baselines3's, less memory, exact continuation."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from stable_baselines3.common.buffers import DictReplayBuffer
from stable_baselines3.common.buffers import ReplayBuffer as BoxReplayBuffer

from enn.reinforcement import replay as replay_module
from enn.reinforcement.observation_store import ObservationStore
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


@pytest.mark.parametrize("n_envs", [1, 3])
@pytest.mark.parametrize("count", [7, 75])
def test_the_same_transitions_as_the_library(n_envs: int, count: int) -> None:
    mine = ReplayBuffer(20 * n_envs, SPACE, ACTIONS, n_envs=n_envs)
    theirs = DictReplayBuffer(20 * n_envs, SPACE, ACTIONS, n_envs=n_envs)
    for moment in _stream(count, n_envs):
        mine.add(*moment)
        theirs.add(*moment)
    there = min(count, 20)
    rows, envs = np.divmod(np.arange(there * n_envs), n_envs)
    expected = {}
    for name in SPACE:
        expected[name] = torch.as_tensor(theirs.observations[name][rows, envs])
    drawn = mine.gather(rows, envs)
    for name in SPACE:
        assert torch.equal(drawn.observations[name], expected[name])
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


def test_a_single_box_too(monkeypatch: pytest.MonkeyPatch) -> None:
    space = SPACE["joints"]
    mine, theirs = ReplayBuffer(10, space, ACTIONS, seed=1), BoxReplayBuffer(10, space, ACTIONS)
    for now, last, *rest in _stream(25, 1):
        mine.add(now["joints"], last["joints"], *rest)
        theirs.add(now["joints"], last["joints"], *rest)
    generator = np.random.default_rng(1)
    monkeypatch.setattr(np.random, "randint", lambda low, high, size: generator.integers(low, high, size))
    _equal(mine.sample(50), theirs.sample(50))


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


def test_half_precision_rounds_vectors_alone() -> None:
    buffer = ReplayBuffer(30, SPACE, ACTIONS, n_envs=2, half=True)
    stream = _stream(9, 2)
    for moment in stream:
        buffer.add(*moment)
    drawn = buffer.gather(np.arange(9), np.ones(9, int))
    joints = np.stack([moment[0]["joints"][1] for moment in stream])
    assert drawn.observations["joints"].dtype == torch.float32
    np.testing.assert_allclose(drawn.observations["joints"], joints, rtol=1e-3, atol=1e-6)
    assert not np.array_equal(drawn.observations["joints"], joints)
    np.testing.assert_array_equal(drawn.observations["image"], [moment[0]["image"][1] for moment in stream])


def test_too_little_memory_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(replay_module, "available_bytes", lambda: 1_000_000)
    with pytest.raises(MemoryError, match=r"1,000,000 transitions needs 0.1 GB, of which 0.0 GB.*smaller buffer_size"):
        ReplayBuffer(1_000_000, SPACE, ACTIONS)


def test_images_that_do_not_compress_are_refused_before_they_fill_the_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    buffer = ReplayBuffer(100_000, SPACE, ACTIONS)
    monkeypatch.setattr(replay_module, "available_bytes", lambda: 5_000_000)
    stream = _stream(600, 1)

    def fill() -> None:
        for moment in stream:
            buffer.add(*moment)

    with pytest.raises(MemoryError, match=r"images take 1\d\d bytes a transition.*100,000 of them need 0\.0 GB more"):
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
    stream = _stream(before + 30, 2)
    first, second = (ReplayBuffer(60, SPACE, ACTIONS, n_envs=2, seed=seed) for seed in (1, 2))
    for moment in stream[:before]:
        first.add(*moment)
    first.sample(5)
    pieces = {name: array.copy() for name, _, array in first.chunks()}
    second.restore(first.state(), pieces)
    for moment in stream[before:]:
        first.add(*moment)
        second.add(*moment)
        _equal(first.sample(16), second.sample(16))


def test_pieces_that_did_not_change_keep_their_version(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(replay_module, "CHUNK", 8)
    buffer = ReplayBuffer(64, SPACE, ACTIONS)
    stream = _stream(50, 1)
    for moment in stream[:40]:
        buffer.add(*moment)
    before = {name: (version, array.copy()) for name, version, array in buffer.chunks()}
    for moment in stream[40:]:
        buffer.add(*moment)
    kept = 0
    for name, version, array in buffer.chunks():
        if name in before and before[name][0] == version and len(array) == len(before[name][1]):
            np.testing.assert_array_equal(array, before[name][1])
            kept += 1
    assert kept == 5 * 6  # the first 40 slots, six arrays


def test_refusals_say_why() -> None:
    with pytest.raises(ValueError, match="replay buffer is empty"):
        ReplayBuffer(10, SPACE, ACTIONS).sample(4)
    store = ObservationStore("mask", SPACE["mask"], (3,))
    with pytest.raises(ValueError, match="'mask' must hold 0 and 255 alone"):
        store.write(0, np.full((1, 9, 9), 1, np.uint8))
    other = ReplayBuffer(10, SPACE, ACTIONS)
    with pytest.raises(ValueError, match="keep buffer_size and n_envs as they were"):
        ReplayBuffer(20, SPACE, ACTIONS).restore(other.state(), {})
