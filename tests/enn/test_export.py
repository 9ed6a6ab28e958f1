"""A policy as ONNX acts as the policy does."""

import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest
from gymnasium.spaces import Box

import enn
from enn.export import OnnxPolicy, export_onnx


@pytest.mark.skipif(
    any(importlib.util.find_spec(name) is None for name in ("onnx", "onnxruntime", "onnxscript")),
    reason="the extra enn[onnx] is not installed",
)
@pytest.mark.parametrize("name", ["generalist", "type_1_bca"])
def test_its_actions_are_those_of_the_policy(name: str, tmp_path: Path) -> None:
    import onnxruntime

    policy = enn.load(name)
    file = export_onnx(policy, tmp_path / "new" / "policy")
    assert list(tmp_path.rglob("*.*")) == [file]
    session = onnxruntime.InferenceSession(str(file), providers=["CPUExecutionProvider"])
    assert tuple(one.name for one in session.get_inputs()) == policy.keys
    told = session.get_modelmeta().custom_metadata_map
    assert told["action_repeat"] == str(policy.action_repeat)
    assert (json.loads(told["action_low"]), json.loads(told["action_high"])) == ([-1, -1], [1, 1])
    for seed in range(5):
        policy.observation_space.seed(seed)
        observation = policy.observation_space.sample()
        [action] = session.run(None, {key: observation[key][None] for key in policy.keys})
        assert np.abs(action[0] - policy.act(observation)).max() < 1e-4
        np.testing.assert_allclose(OnnxPolicy(file).act(observation), policy.act(observation), atol=1e-4)
    with pytest.raises(ValueError, match="action is not finite"):
        OnnxPolicy(file).act({key: np.full_like(value, np.nan) if value.dtype.kind == "f" else value
                              for key, value in observation.items()})  # fmt: skip


def test_actions_of_another_range_are_kept_and_names_with_points_too(tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    policy = enn.load("generalist")
    policy.action_space = Box(-2.0, 2.0, policy.action_space.shape, np.float32)
    policy._low, policy._high = policy.action_space.low, policy.action_space.high
    file = export_onnx(policy, tmp_path / "torque_1.5")
    assert file.name == "torque_1.5.onnx"
    policy.observation_space.seed(1)
    seen = [policy.observation_space.sample() for _ in range(5)]
    wanted = np.array([policy.act(one) for one in seen])
    assert np.abs(wanted).max() > 1
    np.testing.assert_allclose([OnnxPolicy(file).act(one) for one in seen], wanted, atol=1e-3)
