"""Policies as ONNX, from observations to the deterministic action: written to run without torch, and read to steer."""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from enn.model_file import write_whole
from enn.policy import Observation, Policy, PolicyController

_ONE = "observation"  # name of the input where a policy sees one array
_REPEAT, _LOW, _HIGH = "action_repeat", "action_low", "action_high"


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
        _ONE: space
    }  # fmt: skip
    inputs = tuple(torch.as_tensor(one.sample()[None]).to(policy.module.device) for one in spaces.values())
    program = torch.onnx.export(
        _Actions(policy).eval(), inputs, input_names=list(spaces), output_names=["action"], dynamo=True, verbose=False
    )
    assert program is not None
    model = program.model_proto
    model.metadata_props.add(key=_REPEAT, value=str(policy.action_repeat))
    for name, bound in ((_LOW, policy.action_space.low), (_HIGH, policy.action_space.high)):
        model.metadata_props.add(key=name, value=json.dumps(bound.tolist()))
    file = Path(path) if Path(path).suffix == ".onnx" else Path(f"{path}.onnx")
    write_whole(file, model.SerializeToString())
    return file


class OnnxPolicy:
    """A policy in an ONNX file, from whatever program: inputs are observations by name, or one, `observation`.

    Attributes:
        keys: names of the observations that it sees; () where it sees one array.
        action_repeat: environment steps that each action is meant for, of the file's metadata; 1 without.

    Raises:
        ModuleNotFoundError: the extra `endonav-enn[onnx]` is not installed.
        ValueError: the file is damaged, has more outputs than the actions, or metadata that do not fit together.
    """

    def __init__(self, file: Path) -> None:
        _require("onnxruntime")
        import onnxruntime

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        options.add_session_config_entry("session.model_external_initializers_file_folder_path", str(file.parent))
        try:
            self._session = onnxruntime.InferenceSession(file.read_bytes(), options, ["CPUExecutionProvider"])
        except Exception as error:  # the runtime's own, which have no common base
            raise ValueError(f"{file} is no ONNX model that can be run: {str(error).splitlines()[0]}") from error
        self._inputs = [one.name for one in self._session.get_inputs()]
        if len(self._session.get_outputs()) != 1:
            raise ValueError(f"{file} must have one output, the actions, got {len(self._session.get_outputs())}")
        self.keys = () if self._inputs == [_ONE] else tuple(self._inputs)
        metadata = self._session.get_modelmeta().custom_metadata_map
        bounds = (metadata.get(_LOW, "-1"), metadata.get(_HIGH, "1"))
        try:
            self.action_repeat = int(metadata.get(_REPEAT, 1))
            self._low, self._high = (np.asarray(json.loads(bound), np.float32) for bound in bounds)
            finite = bool(np.isfinite([self._low, self._high]).all())
            fit = self.action_repeat >= 1 and finite and bool((self._low < self._high).all())
        except (ValueError, TypeError, RecursionError):  # no number, other lengths, nested too deep
            fit = False
        if not fit:
            raise ValueError(
                f"{file} says in its metadata {_REPEAT} {metadata.get(_REPEAT, 1)!s:.20}, {_LOW} {bounds[0]:.80}, "
                f"{_HIGH} {bounds[1]:.80}: expected a count of at least 1, and numbers, each low one below its high one"
            )

    def act(
        self, observation: Observation, deterministic: bool = True, generator: np.random.Generator | None = None
    ) -> NDArray[np.float32]:
        """The action for one observation, cut to the range in the file's metadata, or to -1 and 1; never drawn.

        Returns:
            Shape (actions,).

        Raises:
            ValueError: the observations have other shapes or types than the inputs, or the action is not finite.
        """
        seen = observation if isinstance(observation, Mapping) else dict.fromkeys(self._inputs, observation)
        try:
            [action] = self._session.run(None, {name: seen[name][None] for name in self._inputs})
        except Exception as error:  # as above
            words = str(error).splitlines()[0]
            raise ValueError(f"the ONNX model does not take these observations: {words}") from error
        flat = np.asarray(action, np.float32).reshape(-1)
        if not np.isfinite(flat).all():
            raise ValueError("the ONNX model's action is not finite: check the observations")
        return flat.clip(self._low, self._high).astype(np.float32)

    def controller(self) -> PolicyController:
        """The policy over episodes."""
        return PolicyController(self)


def _require(*modules: str) -> None:
    missing = [name for name in modules if importlib.util.find_spec(name) is None]
    if missing:
        raise ModuleNotFoundError(f"ONNX needs {', '.join(missing)}: pip install 'endonav-enn[onnx]'")
