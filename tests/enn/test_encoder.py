"""Encoder: scripted samples, what it reads off them, freezing, and environments behind it."""

from __future__ import annotations

import dataclasses
import functools
import io
import json
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from stable_baselines3.common.vec_env import DummyVecEnv

from enn.encoder import (
    EncodedEnvs,
    Encoder,
    EncoderSettings,
    Samples,
    encoder_report,
    fit_encoder,
    scripted_samples,
)
from enn.exploration import TRUTH, Frontier, Moves, points_behind_tip

SIZE = 32
QUICK = EncoderSettings(hidden=32, features=12, epochs=6, batch_size=25, learning_rate=4e-3)
ARRAYS = dict[str, np.ndarray]


class Rod(gymnasium.Env[ARRAYS, np.ndarray]):
    """A straight rod in a plane, fed up and turned; drawn dark on a grey ramp. Ends after 30 steps."""

    action_space = gymnasium.spaces.Box(-1, 1, (2,), np.float32)

    def __init__(self, names: tuple[str, ...] = ("image", "mask", "joints", *TRUTH)) -> None:
        box = gymnasium.spaces.Box
        spaces = {
            "image": box(0, 255, (1, SIZE, SIZE), np.uint8),
            "mask": box(0, 255, (1, SIZE, SIZE), np.uint8),
            "joints": box(-np.inf, np.inf, (4,), np.float32),
            "shape": box(-np.inf, np.inf, (5, 3), np.float32),
            "feeder": box(-np.inf, np.inf, (3,), np.float32),
            "force": box(-np.inf, np.inf, (3,), np.float32),
        }
        self.observation_space = gymnasium.spaces.Dict({name: spaces[name] for name in names})

    def _observe(self) -> ARRAYS:
        heading = np.array((np.sin(self.angle), 0.0, np.cos(self.angle)))
        tip = (0.01 + self.length) * heading
        shape = tip - np.linspace(0, 0.08, 5)[:, None] * heading
        along = np.linspace(0, 1, 60)[:, None] * tip
        columns = np.clip(16 + along[:, 0] / 0.002, 0, SIZE - 1).astype(int)
        rows = np.clip(28 - along[:, 2] / 0.002, 0, SIZE - 1).astype(int)
        image = np.tile(np.linspace(100, 200, SIZE), (SIZE, 1))
        mask = np.zeros((SIZE, SIZE))
        image[rows, columns] -= 40
        mask[rows, columns] = 255
        everything = {
            "image": image[None].astype(np.uint8),
            "mask": mask[None].astype(np.uint8),
            "joints": np.array((self.length, self.turns, self.angle, 0), np.float32),
            "shape": shape.astype(np.float32),
            "feeder": np.array((self.length, np.cos(self.turns), np.sin(self.turns)), np.float32),
            "force": np.zeros(3, np.float32),
        }
        return {name: everything[name] for name in self.observation_space.spaces}

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[ARRAYS, dict[str, Any]]:
        super().reset(seed=seed)
        start = (options or {}).get("start")
        self.length, self.angle = (0.02, 0.0) if start is None else start
        self.turns, self.steps = 0.0, 0
        return self._observe(), {}

    def start_state(self) -> np.ndarray:
        return np.array((self.length, self.angle))

    def step(self, action: np.ndarray) -> tuple[ARRAYS, float, bool, bool, dict[str, Any]]:
        self.length = float(np.clip(self.length + 0.002 * action[0], 0, 0.04))
        self.angle = float(np.clip(self.angle + 0.05 * action[1], -0.7, 0.7))
        self.turns += 0.3 * float(action[1])
        self.steps += 1
        return self._observe(), 0.0, False, self.steps >= 30, {}


@functools.cache
def _drawn() -> Samples:
    return scripted_samples(Rod, 1000, seed=0)


@pytest.fixture(scope="module")
def samples() -> Samples:
    return _drawn()


@functools.cache
def fitted(*keys: str) -> tuple[Encoder, dict[str, Any]]:
    return fit_encoder(_drawn(), keys, QUICK)


def tensors(samples: Samples, rows: int = 6) -> dict[str, torch.Tensor]:
    return {key: torch.from_numpy(values[:rows]) for key, values in samples.observations.items()}


def test_samples_hold_observations_and_the_truth(samples: Samples) -> None:
    assert len(samples) == 1000
    assert set(samples.observations) == {"image", "mask", "joints"}
    assert samples.observations["image"].dtype == np.uint8
    reach = np.linalg.norm(samples.points_mm[:, 0], axis=1)
    assert np.allclose(reach, 10 + samples.feeder[:, 0], atol=1e-3)  # mm: the rod's tip
    assert np.allclose(samples.points_mm[:, 1], samples.points_mm[:, 0] - 4 * samples.direction, atol=1e-3)
    assert np.allclose(np.linalg.norm(samples.direction, axis=1), 1, atol=1e-5)
    assert len(np.unique(samples.episode)) > 20


def test_samples_are_the_same_for_a_seed_and_others_for_another(samples: Samples) -> None:
    again, other = scripted_samples(Rod, 300, seed=0), scripted_samples(Rod, 300, seed=1)
    assert np.array_equal(again.points_mm, samples.points_mm[:300])
    assert not np.array_equal(again.points_mm, other.points_mm)


def test_roll_outs_start_at_given_states() -> None:
    starts = np.array([[0.04, 0.6]])
    drawn = scripted_samples(Rod, 600, seed=0, starts=starts)
    first = np.flatnonzero(np.diff(drawn.episode, prepend=-1))
    there = np.isclose(drawn.feeder[first, 0], 40) & np.isclose(drawn.direction[first, 0], np.sin(0.6))
    assert 0.15 < there.mean() < 0.7


def test_samples_need_their_truth() -> None:
    with pytest.raises(ValueError, match="shape, feeder, force is missing: add it"):
        scripted_samples(lambda: Rod(("image",)), 10, seed=0)
    with pytest.raises(ValueError, match="count must be at least 1, got 0"):
        scripted_samples(Rod, 0, seed=0)


def test_samples_need_as_many_rows_in_every_array(samples: Samples) -> None:
    with pytest.raises(ValueError, match="expected 3 rows in every array, got direction 2"):
        dataclasses.replace(samples.take(np.arange(3)), direction=samples.direction[:2])


def test_points_behind_the_tip_follow_the_wire() -> None:
    shape = np.array([[0, 0, 3.0], [0, 0, 1], [4, 0, 1]])
    points = points_behind_tip(shape, np.array([0, 1, 4, 99]))
    assert np.allclose(points, [[0, 0, 3], [0, 0, 2], [2, 0, 1], [4, 0, 1]])


@pytest.mark.parametrize("size", [2, 21])
def test_moves_persist_and_stay_in_range(size: int) -> None:
    moves = Moves(size, np.random.default_rng(0))
    actions = np.array([moves.action() for _ in range(2000)])
    assert np.abs(actions).max() <= 1
    translation = actions[:, 0 if size == 2 else -1]
    assert np.corrcoef(translation[1:], translation[:-1])[0, 1] > 0.5
    assert translation.mean() > 0.1  # more in than out


def test_the_frontier_prefers_rare_places() -> None:
    frontier = Frontier(np.random.default_rng(0))
    assert frontier.draw() is None
    for _ in range(500):
        frontier.add(np.zeros(1), np.zeros(3))
    frontier.add(np.ones(1), np.array((0.05, 0, 0)))
    assert len(frontier) == 2
    assert np.mean([frontier.draw()[0] for _ in range(200)]) > 0.9  # type: ignore[index]


@pytest.mark.parametrize(
    ("keys", "limit_mm"), [(("image",), 2.5), (("mask",), 2.5), (("image", "mask"), 2.5), (("joints",), 2.0)]
)
def test_the_tip_is_read_off_every_modality(keys: tuple[str, ...], limit_mm: float) -> None:
    encoder, report = fitted(*keys)
    fresh = scripted_samples(Rod, 400, seed=7)
    spread = np.linalg.norm(fresh.points_mm[:, 0] - fresh.points_mm[:, 0].mean(0), axis=1).mean()
    assert spread > 8  # so that a blind guess would be far off
    assert encoder_report(encoder, fresh)["tip_mm"] < limit_mm
    assert report["tip_frontal_mm"] <= report["tip_mm"] < limit_mm
    assert report["samples"] == 1000


def test_features_are_normalised_frozen_and_read_nothing_else(samples: Samples) -> None:
    encoder, _ = fitted("image", "mask")
    features = encoder(tensors(samples, 1000))
    assert features.shape == (1000, 12)
    assert features.mean(0).abs().max() < 0.2
    assert (features.std(0) - 1).abs().max() < 0.2
    assert not features.requires_grad
    assert not encoder.training
    seen = tensors(samples)
    assert torch.equal(encoder(seen), encoder({key: seen[key] for key in ("image", "mask")}))
    assert not torch.equal(encoder(seen), encoder(seen | {"mask": seen["mask"] * 0}))


def test_a_turn_of_the_feeder_changes_no_feature(samples: Samples) -> None:
    encoder, _ = fitted("joints")
    turned = tensors(samples)
    turned["joints"] = turned["joints"].clone()
    turned["joints"][:, 1] += 2 * np.pi * 50
    assert torch.allclose(encoder(turned), encoder(tensors(samples)), atol=1e-3)


def test_the_same_seed_gives_the_same_encoder_whatever_was_drawn_before(samples: Samples) -> None:
    settings = dataclasses.replace(QUICK, epochs=1)
    first, _ = fit_encoder(samples, ("image",), settings)
    torch.rand(5)
    second, _ = fit_encoder(samples, ("image",), settings)
    other, _ = fit_encoder(samples, ("image",), dataclasses.replace(settings, seed=1))
    pairs = zip(first.state_dict().values(), second.state_dict().values(), strict=True)
    assert all(torch.equal(a, b) for a, b in pairs)
    assert not torch.equal(first(tensors(samples)), other(tensors(samples)))


def test_settings_and_weights_make_the_same_encoder(samples: Samples) -> None:
    encoder, _ = fitted("image", "mask")
    file = io.BytesIO()
    torch.save(encoder.state_dict(), file)
    settings = json.loads(json.dumps(dataclasses.asdict(encoder.settings)))
    loaded = Encoder(EncoderSettings(**settings)).eval()
    loaded.load_state_dict(torch.load(io.BytesIO(file.getvalue()), weights_only=True))
    assert loaded.keys == encoder.keys
    assert torch.equal(loaded(tensors(samples)), encoder(tensors(samples)))


def test_progress_counts_up_to_the_end(samples: Samples) -> None:
    seen: list[float] = []
    fit_encoder(samples, ("joints",), dataclasses.replace(QUICK, epochs=3), lambda share, _: seen.append(share))
    assert seen == pytest.approx([1 / 3, 2 / 3, 1])
    drawn: list[int] = []
    scripted_samples(Rod, 50, 0, progress=lambda done, total: drawn.append(done))
    assert drawn[-1] == 50


def test_vectors_are_looked_at_more_often_than_pictures(samples: Samples) -> None:
    some = samples.take(np.arange(120))
    quick = dataclasses.replace(QUICK, epochs=0)
    assert [fit_encoder(some, (key,), quick)[1]["epochs"] for key in ("mask", "joints")] == [10, 30]


@pytest.mark.parametrize("channels", [(), (4,), (4, 8)])
def test_convolutions_are_a_choice(samples: Samples, channels: tuple[int, ...]) -> None:
    settings = dataclasses.replace(QUICK, channels=channels, epochs=1)
    encoder, _ = fit_encoder(samples, ("image", "mask"), settings)
    convolutions = [module for module in encoder.modules() if isinstance(module, torch.nn.Conv2d)]
    assert [layer.out_channels for layer in convolutions] == list(channels)
    assert encoder(tensors(samples)).shape == (6, 12)


def test_bad_samples_are_refused(samples: Samples) -> None:
    with pytest.raises(ValueError, match="wants 'internal', but the samples have image, joints, mask"):
        fit_encoder(samples, ("internal",), QUICK)
    broken = samples.take(np.arange(200))  # a copy
    broken.observations["joints"][3, 0] = np.nan
    with pytest.raises(ValueError, match="'joints' of the samples has numbers that are not finite"):
        fit_encoder(broken, ("joints",), QUICK)
    with pytest.raises(ValueError, match="at least two roll-outs, got 1"):
        fit_encoder(samples.take(samples.episode == 0), ("mask",), QUICK)
    with pytest.raises(ValueError, match="needs the keys and shapes"):
        Encoder(EncoderSettings())
    with pytest.raises(ValueError, match="held_out must be less than 1, got 1"):
        EncoderSettings(held_out=1)


def test_encoded_environments_give_features_at_every_moment() -> None:
    encoder, _ = fitted("image", "mask")
    envs = EncodedEnvs(DummyVecEnv([Rod, Rod]), encoder, passthrough=("joints",))
    plain = DummyVecEnv([Rod, Rod])
    assert set(envs.observation_space.spaces) == {"features", "joints"}  # type: ignore[attr-defined]
    observations, raw = envs.reset(), plain.reset()
    generator = np.random.default_rng(0)
    ends = 0
    for _ in range(31):
        assert observations["features"].shape == (2, 12)
        assert np.allclose(observations["features"], envs.encode(raw)["features"], atol=1e-5)  # type: ignore[arg-type]
        assert np.array_equal(observations["joints"], raw["joints"])  # type: ignore[call-overload, index]
        actions = generator.uniform(-1, 1, (2, 2)).astype(np.float32)
        observations, _, dones, infos = envs.step(actions)  # type: ignore[assignment]
        raw, _, _, plain_infos = plain.step(actions)
        for index in np.flatnonzero(dones):
            ends += 1
            last = {key: value[None] for key, value in plain_infos[index]["terminal_observation"].items()}
            expected = envs.encode(last)["features"][0]
            assert set(infos[index]["terminal_observation"]) == {"features", "joints"}
            assert np.allclose(infos[index]["terminal_observation"]["features"], expected, atol=1e-5)
    assert ends == 2


def test_environments_with_other_images_are_refused() -> None:
    encoder, _ = fitted("image", "mask")
    wrong = Encoder(dataclasses.replace(encoder.settings, shapes=((1, 48, 48), (1, 48, 48))))
    with pytest.raises(ValueError, match=r"trained with 'image' of shape \(1, 48, 48\), but the environment gives"):
        EncodedEnvs(DummyVecEnv([Rod]), wrong)
    with pytest.raises(ValueError, match="wants 'mask', but the observation has image"):
        EncodedEnvs(DummyVecEnv([lambda: Rod(("image",))]), encoder)
