"""Policies act as the library's, on any device."""

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch

import enn
from enn.model_file import decoded, encoded
from enn.networks.devices import bfloat16_on_processor
from enn.networks.network import NetworkSettings, build_network
from enn.networks.normalisation import fit_normalisation
from enn.policy import Policy

ACTIONS = gymnasium.spaces.Box(np.array([-1, 0], np.float32), np.array([1, 4], np.float32))
SPACE = gymnasium.spaces.Dict(
    [
        ("tip", gymnasium.spaces.Box(-np.inf, np.inf, (3,), np.float32)),
        ("feeder", gymnasium.spaces.Box(-np.inf, np.inf, (2,), np.float32)),
    ]
)


def _policy(settings: NetworkSettings | None = None, space: gymnasium.Space[Any] = SPACE, **rest: Any) -> Policy:
    torch.manual_seed(0)
    settings = settings or NetworkSettings(hidden=(8, 8))
    return Policy(settings, build_network(settings, space, ACTIONS), space, ACTIONS, **rest)


def _batch(count: int, seed: int = 0) -> dict[str, np.ndarray]:
    generator = np.random.default_rng(seed)
    return {name: generator.standard_normal((count, *SPACE[name].shape)).astype(np.float32) for name in SPACE}


@pytest.mark.parametrize("algorithm", ["sac", "ppo"])
def test_actions_lie_in_the_action_space_and_one_is_as_many(algorithm: str) -> None:
    policy = _policy(NetworkSettings(algorithm=algorithm, hidden=(8,)))
    batch = _batch(200)
    for deterministic in (True, False):
        actions = policy.act_batch(batch, deterministic, np.random.default_rng(0))
        assert actions.shape == (200, 2)
        assert actions.dtype == np.float32
        assert (actions >= ACTIONS.low).all()
        assert (actions <= ACTIONS.high).all()
    few = _batch(20)
    np.testing.assert_allclose(policy.act_batch(few), policy.module.predict(few, deterministic=True)[0], atol=1e-6)
    single = policy.act({name: values[7] for name, values in batch.items()} | {"unseen": np.zeros(9)})
    np.testing.assert_allclose(single, policy.act_batch(batch)[7], atol=1e-6)


def test_a_controller_holds_its_actions_and_decides_anew_after_a_reset() -> None:
    policy = _policy(action_repeat=3)
    controller = policy.controller()
    moments = [{name: values[i] for name, values in _batch(8).items()} for i in range(8)]
    controller.reset()
    actions = [controller(moment, {}) for moment in moments[:5]]
    for number, action in enumerate(actions):
        np.testing.assert_array_equal(action, policy.act(moments[3 * (number // 3)]))
    controller.reset()
    np.testing.assert_array_equal(controller(moments[6], {}), policy.act(moments[6]))
    assert (actions[4] != policy.act(moments[6])).any()


@pytest.mark.parametrize("algorithm", ["sac", "ppo"])
def test_saved_and_loaded_it_acts_the_same(algorithm: str, tmp_path: Path) -> None:
    policy = _policy(NetworkSettings(algorithm=algorithm), action_repeat=2, metadata={"target": "bca"})
    batch = _batch(50)
    fit_normalisation(policy.module, {name: torch.as_tensor(3 * values + 1) for name, values in batch.items()})
    policy.save(tmp_path / "folder" / "policy.pt")
    loaded = Policy.load(tmp_path / "folder" / "policy.pt")
    np.testing.assert_array_equal(loaded.act_batch(batch), policy.act_batch(batch))
    np.testing.assert_array_equal(loaded.features(batch), policy.features(batch))
    assert loaded.features(batch).shape == (50, 5)
    assert loaded.action_repeat == 2
    assert loaded.metadata == {"target": "bca"}
    assert loaded.keys == ("tip", "feeder")
    assert loaded.observation_space == SPACE
    assert loaded.action_space == ACTIONS
    assert [file.name for file in (tmp_path / "folder").iterdir()] == ["policy.pt"]


def test_other_observations_are_one_clear_sentence() -> None:
    policy = _policy()
    for observation, said in (
        ({"tip": np.zeros(3)}, "sees tip, feeder, but feeder is missing"),
        ({"tip": np.zeros(4), "feeder": np.zeros(2)}, r"'tip' of shape \(3,\), got \(4,\): another wire"),
        (np.zeros(3), "sees tip, feeder by name, got one array"),
        ({"tip": np.zeros(3), "feeder": np.array([0.0, np.nan])}, "'feeder' is not finite"),
        ({"tip": np.zeros(3), "feeder": np.zeros(2, bool)}, "'feeder' of type float32, got bool"),
        (None, "sees tip, feeder by name, got one array"),
    ):
        with pytest.raises(ValueError, match=said):
            policy.act(observation)


def test_numbers_of_another_precision_and_lists_are_taken_and_images_of_another_range_are_not() -> None:
    observation = {"tip": np.full(3, 0.5, np.float32), "feeder": np.ones(2, np.float32)}
    policy, action = _policy(), _policy().act(observation)
    for other in (lambda values: values.astype(float), lambda values: values.tolist()):
        np.testing.assert_array_equal(policy.act({key: other(observation[key]) for key in observation}), action)
    reader = enn.load("type_1_bca")
    seen = {key: np.zeros(space.shape, space.dtype) for key, space in reader.observation_space.items()}
    reader.act(seen)
    with pytest.raises(ValueError, match="'image' of type uint8, got float32"):
        reader.act(seen | {"image": seen["image"].astype(np.float32)})


@pytest.mark.parametrize(
    ("abilities", "expected"), [({"avx512_bf16": True}, torch.bfloat16), ({"avx2": True}, torch.float32)]
)
def test_products_are_bfloat16_where_the_processor_has_it(
    monkeypatch: pytest.MonkeyPatch, abilities: dict[str, bool], expected: torch.dtype
) -> None:
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: abilities)
    layer = torch.nn.Conv2d(1, 4, 3)
    with bfloat16_on_processor():
        found = layer(torch.zeros(2, 1, 8, 8))
    assert found.dtype == expected
    found.float().sum().backward()
    assert layer.weight.dtype == layer.weight.grad.dtype == torch.float32
    assert layer(torch.zeros(2, 1, 8, 8)).dtype == torch.float32  # outside


def test_a_file_of_a_network_that_there_is_no_more_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "policy.pt"
    _policy().save(path)
    content = decoded(path.read_bytes())
    content["network"] |= {"critic_keys": (), "shared": ""}  # as earlier versions wrote them
    path.write_bytes(encoded(content | {"passthrough": []}))
    np.testing.assert_array_equal(Policy.load(path).act_batch(_batch(3)), _policy().act_batch(_batch(3)))
    path.write_bytes(encoded(content | {"passthrough": ["tip"]}))
    with pytest.raises(ValueError, match=r"another architecture .*networks with passthrough are gone"):
        Policy.load(path)


def test_a_single_box(tmp_path: Path) -> None:
    policy = _policy(space=SPACE["tip"])
    policy.save(tmp_path / "policy.pt")
    tip = np.array([1, 2, 3], np.float32)
    np.testing.assert_array_equal(Policy.load(tmp_path / "policy.pt").act(tip), policy.act(tip))
    with pytest.raises(ValueError, match="sees one array of shape \\(3,\\), got the observations tip"):
        policy.act({"tip": tip})


def test_reading_a_policy_does_not_import_the_compiler_of_torch(run_python) -> None:  # which takes 2 CPU-s
    assert (
        run_python("import enn.shipped, sys; enn.shipped.load('generalist'); print('torch._dynamo' in sys.modules)")
        == "False\n"
    )
