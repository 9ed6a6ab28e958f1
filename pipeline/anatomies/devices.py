"""Devices for an anatomy, as long as its ways, by how far an ostium lies behind the top of the arch, or by trials."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

from pipeline.task import DESCENDING, NO_WIRE, Task, entry_place

if TYPE_CHECKING:
    from cathsim.anatomy import Phantom
    from cathsim.anatomy.point_target import TargetLike
    from enn.device_trials import TrialStatistics
    from enn.policy import Policy


_LEAST_TIMES, _TIMES = 2.0, 3.0  # of the steps that a way takes at full speed: the fewest of an episode; a long one's
_MARGIN = 0.03  # m of wire beyond the way to the target and what lies in the sheath

_LOGGER = logging.getLogger(__name__)


def fitted_task(task: Task, phantom: Phantom, targets: Sequence[Any]) -> Task:
    """The task with a wire that reaches targets (names, or points in m) from its entry, where its length is open."""
    from cathsim.anatomy.entry import entry_name
    from cathsim.devices.arena import RESERVE

    ways = [phantom.way_length(target, entry_name(entry_place(task.entry), target)) for target in targets]
    if task.wire_length_mm or task.wire == NO_WIRE:
        return task
    needed = max(ways) + RESERVE + _MARGIN
    return task if needed <= task.guidewire().length else replace(task, wire_length_mm=10.0 * math.ceil(100.0 * needed))


def fitted_steps(task: Task, phantom: Phantom, target: Any) -> Task:
    """The task with three times a straight way's steps, in hundreds, where its own are less than twice them."""
    from cathsim.anatomy.entry import entry_name
    from cathsim.presets import PACES

    way = phantom.way_length(target, entry_name(entry_place(task.entry), target))
    straight = way / PACES[task.pace].translation
    if task.max_steps >= _LEAST_TIMES * straight:
        return task
    steps = 100 * math.ceil(_TIMES * straight / 100)
    _LOGGER.warning(
        "the way to %s of %s is %.0f mm long, for which %d steps are few: episodes last %d (stage.fit_steps=false: "
        "task.max_steps)",
        target,
        phantom.name,
        1e3 * way,
        task.max_steps,
        steps,
    )
    return replace(task, max_steps=steps)


# mm; a policy of the wire alone reached most targets below it, few of those far beyond (docs/results/steep_arches.md)
STEEP_MM = 13.0
CATHETER = "jb2"  # that reaches further
WITH_POLICIES = (CATHETER, "simmons2")  # catheters over the wire that shipped policies steer, the better ones first
# Two thirds and a sixth as stiff as the usual wire; the latter goes with a JB2 of 4F, a third as stiff as that of 5F.
SOFTER_WIRES = ("radifocus_angled", "radifocus_angled_025")
_SOFTER = f"{CATHETER}_4f"
# mm; from here on the shipped policies of wire and catheter reach more targets than those of the wire alone (same page)
CATHETER_BETTER_MM = 5.0
SHARE = 0.5  # of what may differ on the day, by which the copies for a choice differ from the scan
_BETTER_MM = {("generalist_jb2", "lcca"): 0.0, ("generalist_jb2", "lsa"): 0.0}  # of others: policy and branch


def catheter_better_mm(policy: str, branch: str) -> float:
    """The ostium offset, mm, from which on a policy reaches more targets in a branch with a catheter than without."""
    return _BETTER_MM.get((policy, branch), CATHETER_BETTER_MM)


def set_back_mm(phantom: Phantom, target: TargetLike) -> float:
    """How far the ostium of a target's branch lies behind the top of the arch, mm; a ValueError in the aorta itself."""
    from cathsim.anatomy.vessel_tree import set_back

    return 1e3 * set_back(phantom.tree, phantom.target(target).branch)


def with_catheter_where_steep(phantom: Phantom, target: TargetLike, task: Task, *, choose: bool) -> Task:
    """The task with a catheter over the wire, where a wire alone comes from below and the ostium offset is so large.

    Says so in the log.
    """
    place = phantom.target(target)
    if task.catheter is not None or task.entry != DESCENDING or place.branch == phantom.tree.root.name:
        return task
    back = set_back_mm(phantom, target)
    if back < STEEP_MM:
        return task
    _LOGGER.warning(
        "%s of %s leaves the aorta steeply: its ostium lies %.0f mm behind the top of the arch, seen along the branch, "
        "and from %.0f mm on a wire alone is seldom brought in: %s",
        place.name,
        phantom.name,
        back,
        STEEP_MM,
        f"it gets a {CATHETER} (stage.choose_catheter=false leaves it out)"
        if choose
        else f"task.catheter={CATHETER} reaches further",
    )
    return replace(task, catheter=CATHETER) if choose else task


def softened(task: Task) -> Task:
    """A task with a JB2 of 4F over a thin wire in place of one of 5F over the usual wire.

    Policies that learnt with the latter bring the former to more targets, and press less (docs/results/rehearsal.md).
    Another catheter stays, and so does a wire that somebody chose.
    """
    if task.catheter != CATHETER:
        return task
    wire = SOFTER_WIRES[-1] if task.wire == Task().wire else task.wire
    return replace(task, wire=wire, catheter=_SOFTER)


def best_in_copies(
    policies: Sequence[Policy], tasks: Sequence[Task], phantom: Phantom, target: TargetLike, *, usual: int, seed: int
) -> int:
    """Number of the policy whose devices, their wires as long as the way asks for, do best in copies of an anatomy."""
    from cathsim.rehearsal.environment import NavigateCopiesEnv, Perturbation
    from enn.device_trials import TRIALS, TrialStatistics, best_devices, try_in_copies

    def trial_statistics(policy: Policy, task: Task, copies: int) -> TrialStatistics:
        fitted = fitted_task(replace(task, wire_length_mm=0.0), phantom, [target])
        task = max(task, fitted, key=lambda one: one.guidewire().length)
        environment = NavigateCopiesEnv(
            phantom,
            (target,),
            copies=range(1, TRIALS + 1),
            perturbation=Perturbation().scaled(SHARE),
            observation=policy.keys,
            **task.devices(),
            **task.rules(),
        )
        outcome = TrialStatistics.of(try_in_copies(policy, environment, seed, cases=range(copies)))
        environment.close()
        return outcome

    return best_devices([partial(trial_statistics, *each) for each in zip(policies, tasks, strict=True)], usual)
