"""Cases of a claim of navigation: an episode each, of the policy that the devices' rule chooses."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from pipeline.protocol.claims import Navigation
from pipeline.seeds import protocol_arches, protocol_start


def cases(claim: Navigation, seed: int) -> Iterator[dict[str, Any]]:
    """Each case: the anatomy, the target, and the seed of the episode's start."""
    for arch in protocol_arches(claim.first, seed, claim.count):
        for number, target in enumerate(claim.targets):
            yield {"anatomy": f"{claim.arches}_{arch}", "target": target, "seed": protocol_start(arch, number)}


def play(claim: Navigation, case: dict[str, Any]) -> dict[str, Any]:
    """Plays a case's episode.

    Returns:
        `success`, `straight` (whether the tip came within the success radius in a straight line), `branch`, `depth_mm`,
        `steps`, `force_p95_n`, `force_max_n` and the name of the `policy`.
    """
    from enn.policy import Policy
    from enn.retrying import RetryingController

    name = claim.policies[_which(claim, case)]
    policy, environment, radius = _scene(claim, name, case)

    def attempt(seed: int) -> Any:
        # actions are drawn where they can be; a policy by images always takes the best one
        return policy.controller(deterministic=False, seed=seed) if isinstance(policy, Policy) else policy.controller()

    controller = RetryingController(attempt, claim.steps, claim.attempts, case["seed"])
    observation, info = environment.reset(seed=case["seed"])
    forces: list[float] = []
    ended = success = straight = False
    while not ended:
        observation, _, success, truncated, info = environment.step(controller(observation, info))
        forces.append(float(info["force"]))
        straight |= bool(info["distance"] <= radius)
        ended = success or truncated
    environment.close()
    return {
        "success": bool(success),
        "straight": straight,
        "branch": info["branch"],
        "depth_mm": round(1e3 * float(info["depth"]), 1),
        "steps": len(forces),
        "force_p95_n": round(float(np.percentile(forces, 95)), 3),
        "force_max_n": round(max(forces), 3),
        "policy": name,
    }


def _which(claim: Navigation, case: dict[str, Any]) -> int:
    from cathsim.anatomy import load_phantom
    from pipeline.anatomies.devices import catheter_better_mm, set_back_mm

    if len(claim.policies) == 1:
        return 0
    phantom = load_phantom(case["anatomy"])
    return int(set_back_mm(phantom, case["target"]) >= catheter_better_mm(claim.policies[1], case["target"]))


def _scene(claim: Navigation, name: str, case: dict[str, Any]) -> tuple[Any, Any, float]:
    """The policy, the environment that it sees, and the success radius, m."""
    from cathsim.observations.xray import XrayEnvironment
    from enn.imitation.images.policy import ImagePolicy
    from enn.retrying import steps_of_attempts
    from pipeline.stages.unseen.task import UnseenTask
    from pipeline.task import TASK, task_in_random_arches

    policy = _policy(name)
    catheter = policy.metadata.get(TASK, {}).get("catheter")
    devices = {} if catheter is None else {"catheter": catheter}
    steps = steps_of_attempts(claim.steps, claim.attempts)
    rules = replace(task_in_random_arches(), max_steps=steps, start_rotation_deg=180.0, **devices)
    task = UnseenTask(claim.targets, rules, arches=claim.arches)
    arch = int(case["anatomy"].rsplit("_", 1)[1])
    if isinstance(policy, ImagePolicy):
        bare = task.test_environment(arch, case["target"], rules.wire, ("goal_image",))
        return policy, XrayEnvironment(bare, rules.image_size_px, **policy.imaging), rules.success_radius
    environment = task.test_environment(arch, case["target"], rules.wire, policy.keys)
    return policy, environment, rules.success_radius


@lru_cache(maxsize=4)
def _policy(name: str) -> Any:
    import enn

    return enn.load(name)
