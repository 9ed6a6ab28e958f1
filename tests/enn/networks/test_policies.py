"""Networks of policies: extractors of the thesis's tables, critics, shared features."""

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
import yaml
from stable_baselines3 import SAC

from enn.imitation.cloned_policy import CloningNetwork, CloningNetworkSettings
from enn.networks.features import (
    MultimodalExtractor,
    layer_table,
    thesis_cnn,
    thesis_mlp,
)
from enn.networks.policies import AsymmetricSACPolicy

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


PICTURE = gymnasium.spaces.Box(0, 255, (1, 80, 80), np.uint8)
SPACE = gymnasium.spaces.Dict(
    {
        "joints": gymnasium.spaces.Box(-np.inf, np.inf, (336,), np.float32),
        "image": PICTURE,
        "mask": PICTURE,
        "roadmap": gymnasium.spaces.Box(-np.inf, np.inf, (71,), np.float32),
        "history": gymnasium.spaces.Box(-np.inf, np.inf, (18,), np.float32),
        "internal": gymnasium.spaces.Box(-np.inf, np.inf, (40,), np.float32),
        "sequential": gymnasium.spaces.Box(0, 255, (3, 128, 128), np.uint8),
    }
)
TABLES = Path(__file__).parents[3] / "pipeline" / "report" / "thesis.yaml"


def batch(keys: tuple[str, ...], rows: int = 2) -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(3)
    return {key: torch.rand((rows, *SPACE[key].shape), generator=generator) for key in keys}


def thesis_rows(table: str) -> dict[str, list]:
    return yaml.safe_load(TABLES.read_text())["tables"][table]["rows"]


def test_the_enn_networks_reproduce_the_thesis_table() -> None:
    cnn, mlp = layer_table(thesis_cnn((1, 80, 80)), (1, 80, 80)), layer_table(thesis_mlp(336), (336,))
    measured = {f"cnn/{name}": row for name, row in cnn.items()} | {f"mlp/{name}": row for name, row in mlp.items()}
    assert measured == thesis_rows("architecture_params")
    assert [row[1] for row in cnn.values()] == [0, 2080, 32832, 36928, 0, 590080, 32896]
    assert [row[1] for row in mlp.values()] == [0, 86272, 32896]
    inside = layer_table(MultimodalExtractor(SPACE, ("joints",)).networks["joints"], (336,))
    assert [row[1] for row in inside.values()] == [0, 86272, 32896]


def test_the_cloning_network_reproduces_the_thesis_table() -> None:
    rows = layer_table(CloningNetwork(CloningNetworkSettings(variant="thesis")).layers(), (1, 80, 80))
    assert rows == thesis_rows("bc_architecture")
    assert rows["linear_3"] == ["2", 258, "none", None, None, None]


def test_bad_arguments_are_refused() -> None:
    with pytest.raises(ValueError, match="unknown variant 'lab'; there are thesis, desk"):
        MultimodalExtractor(SPACE, variant="lab")
    with pytest.raises(ValueError, match="wants 'tip', but the observation has history, image"):
        MultimodalExtractor(SPACE, ("image", "tip"))
    with pytest.raises(ValueError, match=r"128 .* or 256 .*, got 64"):
        MultimodalExtractor(SPACE, ("image",), image_features=64)
    with pytest.raises(ValueError, match="expected a Dict observation"):
        MultimodalExtractor(PICTURE, ("image",))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"\(1, 20, 20\) are too small"):
        thesis_cnn((1, 20, 20))
