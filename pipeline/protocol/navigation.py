"""Cases of a claim of navigation: an episode each, of the policy that the devices' rule chooses."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.anatomies.anatomy_file import AnatomyFile, load_anatomy
from pipeline.data.sources import Sources, read_sources
from pipeline.protocol.claims import Navigation, Variation
from pipeline.seeds import protocol_arches, protocol_start
from pipeline.stages.unseen.task import UnseenTask
from pipeline.store.errors import ConfigurationError

if TYPE_CHECKING:
    from cathsim import Guidewire
    from cathsim.anatomy import Phantom

_REFUSED = "refused"  # stands for the targets of a file that cannot be imported


def cases(claim: Navigation, seed: int) -> Iterator[dict[str, Any]]:
    """Each case: anatomy, target, seed of the episode's start, and the variation where there are some."""
    numbers = iter(protocol_arches(claim.first, seed, 1000))
    for anatomy, targets in _anatomies(claim, seed):
        for number in [next(numbers) for _ in range(1 if claim.arches else claim.count)]:
            for k, target in enumerate(targets):
                case = {"anatomy": anatomy, "target": target, "seed": protocol_start(number, k)}
                for name in claim.variations:
                    yield case | ({"variation": name} if name else {})


def files(claim: Navigation) -> dict[str, str]:
    """SHA-256 of the files that it plays in, by their source's name and their own."""
    if claim.sources is None:
        return {}
    sources = read_sources()
    return {
        f"{name}/{file.name}": file.sha256 for name in _named(sources, claim) for file in sources.entries[name].files
    }


def play(claim: Navigation, case: dict[str, Any]) -> dict[str, Any]:
    """Plays a case's episode; in a file that cannot be imported, or has no such branch, it fails.

    Returns:
        `success`, `straight` (whether the tip came within the success radius in a straight line), `branch`, `depth_mm`,
        `steps`, `force_p95_n`, `force_max_n` and the name of the `policy`; or `success` and the `reason`.
    """
    from enn.retrying import RetryingController

    place = _place(claim, case["anatomy"])
    phantom = _phantom(place)
    try:
        if isinstance(phantom, str):
            raise ValueError(phantom)
        phantom.target(case["target"])
    except ValueError as error:
        return {"success": False, "reason": str(error)}
    name = claim.policies[_which(claim, phantom, case["target"])]
    policy, environment, radius = _scene(claim, name, place, case)
    controller = RetryingController(partial(controller_of, policy), claim.steps, claim.attempts, case["seed"])
    outcome, infos = steered(environment, controller, seed=case["seed"])
    environment.close()
    return {
        "success": outcome.pop("success"),
        "straight": any(info["distance"] <= radius for info in infos),
        "branch": infos[-1]["branch"],
        "depth_mm": round(1e3 * float(infos[-1]["depth"]), 1),
        **outcome,
        "policy": name,
    }


def controller_of(policy: Any, seed: int) -> Any:
    """What steers an episode: actions are drawn where they can be; a policy by images always takes the best one."""
    from enn.policy import Policy

    return policy.controller(deterministic=False, seed=seed) if isinstance(policy, Policy) else policy.controller()


def steered(environment: Any, controller: Any, **start: Any) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Plays an episode that begins by `reset(**start)`.

    Returns:
        `success`, `steps`, `force_p95_n` and `force_max_n`; and the info of each step.
    """
    observation, info = environment.reset(**start)
    infos: list[dict[str, Any]] = []
    ended = success = False
    while not ended:
        observation, _, success, truncated, info = environment.step(controller(observation, info))
        infos.append(info)
        ended = success or truncated
    forces = [float(info["force"]) for info in infos]
    outcome = {
        "success": bool(success),
        "steps": len(infos),
        "force_p95_n": round(float(np.percentile(forces, 95)), 3),
        "force_max_n": round(max(forces), 3),
    }
    return outcome, infos


def _anatomies(claim: Navigation, seed: int) -> Iterator[tuple[str, Sequence[str]]]:
    """Names of the anatomies with their targets."""
    if claim.arches:
        yield from (
            (f"{claim.arches}_{arch}", claim.targets) for arch in protocol_arches(claim.first, seed, claim.count)
        )
    yield from ((name, claim.targets) for name in claim.phantoms)
    if claim.sources:
        sources = read_sources()
        names = _named(sources, claim)
        if missing := [name for name in names if sources.missing(name)]:
            raise ConfigurationError(f"data are missing: `endonav data fetch {' '.join(missing)}`")
        for name in names:
            yield name, claim.targets or _branches(_place(claim, name))


def _named(sources: Sources, claim: Navigation) -> list[str]:
    return [
        name
        for name, entry in sources.entries.items()
        if entry.use == claim.sources and (entry.vessels == "arch") == (claim.vessels == "arch")
    ]


def _branches(place: str | AnatomyFile) -> Sequence[str]:
    phantom = _phantom(place)
    if isinstance(phantom, str):
        return [_REFUSED]
    return [target.name for target in phantom.targets.values() if not target.at_end]


@lru_cache(maxsize=16)
def _phantom(place: str | AnatomyFile) -> Phantom | str:
    """The anatomy, or why it cannot be imported, which takes as long to find."""
    try:
        return load_anatomy(place)
    except ValueError as error:
        return str(error)


def _place(claim: Navigation, anatomy: str) -> str | AnatomyFile:
    if claim.sources is None:
        return anatomy
    sources = read_sources()
    return AnatomyFile(str(sources.anatomy(anatomy)), sources.entries[anatomy].unit)


def _which(claim: Navigation, phantom: Phantom, target: str) -> int:
    from pipeline.anatomies.devices import catheter_better_mm, set_back_mm

    if len(claim.policies) == 1:
        return 0
    return int(set_back_mm(phantom, target) >= catheter_better_mm(claim.policies[1], phantom.target(target).branch))


@dataclass(frozen=True)
class _VariedTask(UnseenTask):
    """A task whose wire is another than the policy's."""

    varied: Variation = field(default_factory=Variation)

    def wire(self, kind: str) -> Guidewire:
        wire, factor = super().wire(kind), self.varied.stiffness
        return replace(
            wire,
            shaft_stiffness_nmm2=factor * wire.shaft_stiffness_nmm2,
            tip_stiffness_nmm2=factor * wire.tip_stiffness_nmm2,
            friction=self.varied.friction * wire.friction,
        )


def _scene(claim: Navigation, name: str, place: Any, case: dict[str, Any]) -> tuple[Any, Any, float]:
    """The policy, the environment that it sees, and the success radius, m."""
    from cathsim.contact.breathing import Breathing
    from cathsim.observations.scan import Scan
    from cathsim.observations.xray import XrayEnvironment
    from enn.imitation.images.policy import ImagePolicy
    from enn.retrying import steps_of_attempts
    from pipeline.task import TASK, task_in_random_arches

    policy = _policy(name)
    catheter = policy.metadata.get(TASK, {}).get("catheter")
    devices = {} if catheter is None else {"catheter": catheter}
    steps = steps_of_attempts(claim.steps, claim.attempts)
    rules = replace(task_in_random_arches(), max_steps=steps, start_rotation_deg=180.0, **devices)
    varied = claim.variations[case.get("variation", "")]
    task = _VariedTask((case["target"],), rules, arches=claim.arches or "random", varied=varied)
    breathing = Breathing(amplitude=1e-3 * varied.breathing_mm) if varied.breathing_mm else None
    physics: dict[str, Any] = {"breathing": breathing, "wall_stiffness": varied.wall_n_mm}
    if isinstance(policy, ImagePolicy):
        bare = task.test_environment(place, case["target"], rules.wire, ("goal_image",), **physics)
        return policy, XrayEnvironment(bare, rules.image_size_px, **policy.imaging), rules.success_radius
    scan = None
    if varied.shift_mm or varied.turn_deg:
        along, about = (way / np.linalg.norm(way) for way in np.random.default_rng(case["seed"]).normal(size=(2, 3)))
        scan = Scan(load_anatomy(place), 1e-3 * varied.shift_mm * along, math.radians(varied.turn_deg) * about)
    environment = task.test_environment(place, case["target"], rules.wire, policy.keys, scan=scan, **physics)
    return policy, environment, rules.success_radius


@lru_cache(maxsize=4)
def _policy(name: str) -> Any:
    import enn

    return enn.load(name)
