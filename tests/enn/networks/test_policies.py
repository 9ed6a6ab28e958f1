"""Policies: who sees what, whose loss trains what, saving and loading, the chapter's baselines."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from stable_baselines3 import PPO, SAC

from enn.networks.features import MultimodalExtractor
from enn.networks.policies import AsymmetricSACPolicy, LayerNormSACPolicy

ARRAYS = dict[str, np.ndarray]


class Chase(gymnasium.Env[ARRAYS, np.ndarray]):
    """A dot on a line that is to come to zero; a picture, and its position."""

    observation_space = gymnasium.spaces.Dict(
        {
            "image": gymnasium.spaces.Box(0, 255, (1, 40, 40), np.uint8),
            "state": gymnasium.spaces.Box(-np.inf, np.inf, (2,), np.float32),
        }
    )
    action_space = gymnasium.spaces.Box(-1, 1, (2,), np.float32)

    def _observe(self) -> ARRAYS:
        image = np.zeros((1, 40, 40), np.uint8)
        image[0, :, int(np.clip(20 + 10 * self.at, 0, 39))] = 255
        return {"image": image, "state": np.array((self.at, self.steps / 20), np.float32)}

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[ARRAYS, dict[str, Any]]:
        super().reset(seed=seed)
        self.at, self.steps = self.np_random.uniform(-1, 1), 0
        return self._observe(), {}

    def step(self, action: np.ndarray) -> tuple[ARRAYS, float, bool, bool, dict[str, Any]]:
        self.at += 0.2 * float(action[0])
        self.steps += 1
        return self._observe(), -abs(self.at), False, self.steps >= 10, {}


def model(**arguments: Any) -> SAC:
    kwargs = {"features_extractor_kwargs": {"variant": "desk"}, "net_arch": [16], **arguments}
    sizes = {"buffer_size": 100, "batch_size": 8, "learning_starts": 8}
    return SAC(AsymmetricSACPolicy, Chase(), policy_kwargs=kwargs, seed=0, device="cpu", **sizes)


def observed(rows: int = 4) -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(1)
    image = torch.randint(0, 256, (rows, 1, 40, 40), generator=generator, dtype=torch.uint8)
    return {"image": image, "state": torch.randn(rows, 2, generator=generator)}


def weights(module: torch.nn.Module) -> list[torch.Tensor]:
    return [value.detach().clone() for value in module.parameters()]


def moved(module: torch.nn.Module, before: list[torch.Tensor]) -> bool:
    return any(not torch.equal(old, new) for old, new in zip(before, module.parameters(), strict=True))


def test_the_actor_ignores_the_critics_keys() -> None:
    policy = model(actor_keys=("image",), critic_keys=("state",)).policy
    seen = observed()
    changed = seen | {"state": seen["state"] + 5}
    assert torch.equal(policy.actor(seen, deterministic=True), policy.actor(changed, deterministic=True))
    actions = torch.zeros(4, 2)
    assert not torch.equal(policy.critic(seen, actions)[0], policy.critic(changed, actions)[0])
    blind = seen | {"image": 255 - seen["image"]}
    assert torch.equal(policy.critic(seen, actions)[0], policy.critic(blind, actions)[0])
    assert not torch.equal(policy.actor(seen, deterministic=True), policy.actor(blind, deterministic=True))


def test_the_actor_acts_without_the_critics_keys() -> None:
    trained = model(actor_keys=("image",), critic_keys=("state",))
    whole = Chase().reset(seed=0)[0]
    alone, _ = trained.predict({"image": whole["image"]}, deterministic=True)
    together, _ = trained.predict(whole, deterministic=True)
    assert alone.shape == (2,)
    assert np.array_equal(alone, together)
    batch, _ = trained.predict({"image": np.stack([whole["image"]] * 3)}, deterministic=True)
    assert batch.shape == (3, 2)
    with pytest.raises(ValueError, match="actor needs the observations image, got state"):
        trained.predict({"state": whole["state"]})


def test_training_moves_both_extractors() -> None:
    trained = model(actor_keys=("image",), critic_keys=("image", "state"))
    actor, critic = trained.policy.actor.features_extractor, trained.policy.critic.features_extractor
    before = weights(actor), weights(critic)
    trained.learn(14)
    assert moved(actor, before[0])
    assert moved(critic, before[1])


@pytest.mark.parametrize("trained_by", ["actor", "critic"])
def test_shared_features_are_trained_by_one_loss(trained_by: str) -> None:
    trained = model(share_features_extractor=True, features_trained_by=trained_by)
    policy = trained.policy
    extractor = policy.actor.features_extractor
    assert extractor is policy.critic.features_extractor
    assert extractor is not policy.critic_target.features_extractor

    def has_gradient(loss: torch.Tensor) -> bool:
        policy.zero_grad(set_to_none=True)
        loss.backward()
        return all(value.grad is not None for value in extractor.parameters())

    seen = observed()
    assert has_gradient(policy.actor.action_log_prob(seen)[0].sum()) == (trained_by == "actor")
    assert has_gradient(policy.critic(seen, torch.zeros(4, 2))[0].sum()) == (trained_by == "critic")
    owner = policy.actor if trained_by == "actor" else policy.critic
    other = policy.critic if trained_by == "actor" else policy.actor
    mine = {id(value) for value in extractor.parameters()}
    assert mine <= {id(value) for group in owner.optimizer.param_groups for value in group["params"]}
    assert not mine & {id(value) for group in other.optimizer.param_groups for value in group["params"]}
    before = weights(extractor)
    trained.learn(12)
    assert moved(extractor, before)


def test_features_of_different_keys_cannot_be_shared() -> None:
    with pytest.raises(ValueError, match="shared only between equal keys"):
        model(actor_keys=("image",), critic_keys=("state",), share_features_extractor=True)
    with pytest.raises(ValueError, match="wants 'joints', but the observation has image, state"):
        model(actor_keys=("joints",))
    with pytest.raises(ValueError, match="unknown features_trained_by 'both'"):
        model(features_trained_by="both")


def test_saved_and_loaded_it_is_the_same(tmp_path: Path) -> None:
    trained = model(actor_keys=("image",), critic_keys=("state",))
    trained.learn(12)
    trained.save(tmp_path / "model.zip")
    loaded = SAC.load(tmp_path / "model.zip", device="cpu")
    assert loaded.policy.actor_keys == ("image",)
    seen = observed()
    for name in ("actor", "critic"):
        ours, theirs = (getattr(which.policy, name).state_dict() for which in (trained, loaded))
        assert all(torch.equal(ours[key], theirs[key]) for key in ours)
    trained.policy.save(tmp_path / "policy.pt")
    alone = AsymmetricSACPolicy.load(tmp_path / "policy.pt", device="cpu")
    assert torch.equal(alone.actor(seen, deterministic=True), trained.policy.actor(seen, deterministic=True))


def test_ppo_takes_the_extractor() -> None:
    kwargs = {
        "features_extractor_class": MultimodalExtractor,
        "features_extractor_kwargs": {"keys": ("image", "state"), "variant": "desk"},
        "net_arch": [16],
    }
    sizes = {"n_steps": 16, "batch_size": 8, "n_epochs": 1}
    trained = PPO("MultiInputPolicy", Chase(), policy_kwargs=kwargs, seed=0, device="cpu", **sizes)
    extractor = trained.policy.features_extractor
    before = weights(extractor)
    trained.learn(16)
    assert moved(extractor, before)


@pytest.mark.parametrize("policy", [LayerNormSACPolicy, AsymmetricSACPolicy])
def test_layer_norm_stands_in_the_critics_alone(policy: type, tmp_path: Path) -> None:
    arguments = {"features_extractor_class": MultimodalExtractor, "net_arch": [16, 16], "critic_layer_norm": True}
    arguments["features_extractor_kwargs"] = {"variant": "desk"} | (
        {"keys": ("image", "state")} if policy is LayerNormSACPolicy else {}
    )
    sac = SAC(policy, Chase(), policy_kwargs=arguments, seed=0, device="cpu", buffer_size=100, learning_starts=8)

    def norms(module: torch.nn.Module) -> int:
        return sum(isinstance(layer, torch.nn.LayerNorm) for layer in module.modules())

    assert norms(sac.critic.qf0) == norms(sac.critic.qf1) == norms(sac.critic_target.qf0) == 2
    assert norms(sac.actor.latent_pi) == 0
    action, seen = torch.zeros(4, 2), observed()
    for first, second in zip(sac.critic(seen, action), sac.critic_target(seen, action), strict=True):
        assert torch.equal(first, second)
    with torch.no_grad():  # scale of the hidden layers no longer reaches the value
        before = sac.critic(seen, action)[0]
        for layer in sac.critic.qf0:
            if isinstance(layer, torch.nn.Linear) and layer.out_features == 16:
                layer.weight.mul_(100.0), layer.bias.mul_(100.0)
        assert torch.allclose(sac.critic(seen, action)[0], before, atol=0.05 * before.abs().max().item())
    sac.learn(30)
    sac.save(tmp_path / "model")
    again = SAC.load(tmp_path / "model")
    for first, second in zip(sac.critic(seen, action), again.critic(seen, action), strict=True):
        assert torch.equal(first, second)
