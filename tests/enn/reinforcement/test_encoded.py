"""Encoded environments: features at every moment, other images refused."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from stable_baselines3.common.vec_env import DummyVecEnv

from enn.encoder import (
    EncodedEnvs,
    Encoder,
)
from tests.enn.rod import Rod, fitted


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
