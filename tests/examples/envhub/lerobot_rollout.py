"""Evaluates a policy that feeds the wire forwards with LeRobot's own loader and rollout; run where LeRobot is.

python lerobot_rollout.py ENV.PY PHANTOM/TARGET
"""

import json
import sys
from types import SimpleNamespace
from typing import Any

import torch
from lerobot.envs.utils import _call_make_env, _import_hub_module, _normalize_hub_result
from lerobot.processor.pipeline import PolicyProcessorPipeline
from lerobot.scripts.lerobot_eval import rollout
from torch import nn

SEEN: list[dict[str, Any]] = []


class Forwards(nn.Module):
    """Feeds the wire in, whatever it sees."""

    def reset(self) -> None:
        """Nothing is remembered."""

    def select_action(self, observation: dict[str, Any]) -> torch.Tensor:
        """The action of every environment."""
        SEEN.append({name: value for name, value in observation.items() if name != "info"})
        return torch.tensor([[1.0, 0.0]]).repeat(len(observation["observation.state"]), 1)


def main(path: str, task: str) -> None:
    module = _import_hub_module(path, "user/repository")
    small = SimpleNamespace(make_env=lambda **given: module.make_env(**given, accuracy="fast", image_size=32))
    made = _normalize_hub_result(_call_make_env(small, n_envs=2, use_async_envs=False, cfg=SimpleNamespace(task=task)))
    vector = made["cathsim"][0]
    same = [PolicyProcessorPipeline(steps=[]) for _ in range(2)]
    ended = rollout(vector, Forwards(), *same, lambda seen: seen, lambda action: action, seeds=[0, 1])
    images = SEEN[0]["observation.images.frontal"][:1]
    assert 0.0 <= float(images.min()) < float(images.max()) <= 1.0
    result = {"success": ended["success"].any(dim=1).tolist(), "images": list(images.shape), "task": SEEN[0]["task"][0]}
    print(json.dumps(result))
    vector.close()


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
