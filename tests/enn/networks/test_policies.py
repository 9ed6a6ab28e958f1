"""Networks of policies: extractors of the thesis's tables, critics, shared features."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
import yaml
from stable_baselines3 import SAC

from enn.imitation.cloned_policy import CloningNetwork, CloningNetworkSettings
from enn.networks.features import MultimodalExtractor, layer_table, thesis_cnn, thesis_mlp
from enn.networks.policies import AsymmetricSACPolicy
from tests.enn.conftest import PointEnv

KEYS = ("image", "place")


def model(**arguments: Any) -> SAC:
    kwargs = {"features_extractor_kwargs": {"variant": "desk"}, "net_arch": [16], **arguments}
    sizes = {"buffer_size": 100, "batch_size": 8, "learning_starts": 8}
    return SAC(AsymmetricSACPolicy, PointEnv(KEYS), policy_kwargs=kwargs, seed=0, device="cpu", **sizes)


def observed(rows: int = 4) -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(1)
    image = torch.randint(0, 256, (rows, 1, 36, 36), generator=generator, dtype=torch.uint8)
    return {"image": image, "place": torch.randn(rows, 2, generator=generator)}


def test_the_actor_acts_without_the_critics_keys() -> None:
    trained = model(actor_keys=("image",), critic_keys=("place",))
    whole = PointEnv(KEYS).reset(seed=0)[0]
    alone, _ = trained.predict({"image": whole["image"]}, deterministic=True)
    together, _ = trained.predict(whole, deterministic=True)
    assert alone.shape == (2,)
    assert np.array_equal(alone, together)
    batch, _ = trained.predict({"image": np.stack([whole["image"]] * 3)}, deterministic=True)
    assert batch.shape == (3, 2)
    with pytest.raises(ValueError, match="actor needs the observations image, got place"):
        trained.predict({"place": whole["place"]})


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
    before = [value.detach().clone() for value in extractor.parameters()]
    trained.learn(12)
    assert not all(torch.equal(old, new) for old, new in zip(before, extractor.parameters(), strict=True))


def test_saved_and_loaded_it_is_the_same(tmp_path: Path) -> None:
    trained = model(actor_keys=("image",), critic_keys=("place",))
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
    picture: Any = PICTURE
    refusals: list[tuple[Callable[[], object], str]] = [
        (lambda: MultimodalExtractor(SPACE, variant="lab"), "unknown variant 'lab'; there are thesis, desk"),
        (lambda: MultimodalExtractor(SPACE, ("image", "tip")), "wants 'tip', but the observation has history, image"),
        (lambda: MultimodalExtractor(SPACE, ("image",), image_features=64), r"128 .* or 256 .*, got 64"),
        (lambda: MultimodalExtractor(picture, ("image",)), "expected a Dict observation"),
        (lambda: thesis_cnn((1, 20, 20)), r"\(1, 20, 20\) are too small"),
    ]
    for call, said in refusals:
        with pytest.raises(ValueError, match=said):
            call()
