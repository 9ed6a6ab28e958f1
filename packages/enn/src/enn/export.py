"""Export of a policy to ONNX: from its observations to the deterministic action, to be run without torch."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import gymnasium
import torch
from torch import Tensor, nn

from enn.model_file import write_whole
from enn.policy import Policy


class _Actions(nn.Module):
    """A policy as a module of tensors, one an observation in the order of the policy's keys."""

    def __init__(self, policy: Policy) -> None:
        super().__init__()
        self.policy, self.network, self.encoder = policy, policy.module, policy.encoder

    def forward(self, *observations: Tensor) -> Tensor:
        keys = self.policy.keys
        return self.policy.mean_action(dict(zip(keys, observations, strict=True)) if keys else observations[0])


def export_onnx(policy: Policy, path: Path | str) -> Path:
    """Writes a policy as ONNX; the file appears whole.

    Inputs are the observations by name ("observation" where the policy sees one array), with a leading 1 and in the
    environment's own types; the output "action" is `policy.act` of them, shape (1, actions). An action is meant for
    `policy.action_repeat` steps, which the file's metadata holds, too.

    Raises:
        ModuleNotFoundError: the extra `endonav-enn[onnx]` is not installed.
    """
    _require("onnx", "onnxscript")
    space: Any = policy.observation_space
    spaces = {key: space[key] for key in policy.keys} if isinstance(space, gymnasium.spaces.Dict) else {
        "observation": space
    }  # fmt: skip
    inputs = tuple(torch.as_tensor(one.sample()[None]).to(policy.module.device) for one in spaces.values())
    program = torch.onnx.export(
        _Actions(policy).eval(), inputs, input_names=list(spaces), output_names=["action"], dynamo=True, verbose=False
    )
    assert program is not None
    model = program.model_proto
    model.metadata_props.add(key="action_repeat", value=str(policy.action_repeat))
    file = Path(path).with_suffix(".onnx")
    write_whole(file, model.SerializeToString())
    return file


def _require(*modules: str) -> None:
    missing = [name for name in modules if importlib.util.find_spec(name) is None]
    if missing:
        raise ModuleNotFoundError(f"ONNX needs {', '.join(missing)}: pip install 'endonav-enn[onnx]'")
