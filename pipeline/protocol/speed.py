"""Cases of a claim of speed: an environment each, stepped with random actions on one core."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import numpy as np

from pipeline.protocol.claims import Speed

_OBSERVATIONS = {"roadmap": ("roadmap", "history"), "images": ("image", "mask")}


def cases(claim: Speed, seed: int) -> Iterator[dict[str, Any]]:
    """Each case: a phantom and what is observed."""
    for name in claim.phantoms:
        yield from ({"anatomy": name, "target": "bca", "seed": seed, "variation": seen} for seen in _OBSERVATIONS)


def play(claim: Speed, case: dict[str, Any]) -> dict[str, Any]:
    """Steps an environment.

    Returns:
        `success` (whether the simulation stayed valid), and `steps_per_s` of processor time.
    """
    from cathsim import NavigateEnv

    environment = NavigateEnv(case["anatomy"], target=case["target"], observation=_OBSERVATIONS[case["variation"]])
    environment.reset(seed=case["seed"])
    generator, spent, valid = np.random.default_rng(case["seed"]), 0.0, True
    for number in range(claim.steps):
        push, turn = generator.uniform(-1, 1, 2)
        action = np.array([1.0 if number // 120 % 2 else push, turn], np.float32)
        begun = time.process_time()
        _, _, success, truncated, info = environment.step(action)
        spent += time.process_time() - begun
        valid &= not info["invalid"]
        if success or truncated:
            environment.reset()
    environment.close()
    return {"success": bool(valid), "steps_per_s": round(claim.steps / spent, 1)}
