"""A policy as ONNX acts as the policy does."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

import enn
from enn.export import export_onnx


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
    assert session.get_modelmeta().custom_metadata_map == {"action_repeat": str(policy.action_repeat)}
    for seed in range(5):
        policy.observation_space.seed(seed)
        observation = policy.observation_space.sample()
        [action] = session.run(None, {key: observation[key][None] for key in policy.keys})
        assert np.abs(action[0] - policy.act(observation)).max() < 1e-4
