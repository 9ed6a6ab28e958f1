"""Devices for an anatomy, by how far an ostium lies behind the top of the arch, or by episodes in copies of it."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from pipeline.anatomies.fitting import fitted_task
from pipeline.task import DESCENDING, Task

if TYPE_CHECKING:
    from cathsim.anatomy import Phantom
    from cathsim.anatomy.point_target import TargetLike
    from enn.device_trials import Tried
    from enn.policy import Policy

# mm; a policy of the wire alone reached most targets below it, and few of those far beyond (docs/results/generalist.md)
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

_LOGGER = logging.getLogger(__name__)


def catheter_better_mm(policy: str, branch: str) -> float:
    """The set-back, mm, from which on a policy of wire and catheter reaches more targets than that of the wire alone.

    Args:
        policy: its name among the shipped ones, or a file.
        branch: that the target lies in.
    """
    return _BETTER_MM.get((policy, branch), CATHETER_BETTER_MM)


def set_back_mm(phantom: Phantom, target: TargetLike) -> float:
    """How far the ostium of a target's branch lies behind the top of the arch, mm.

    Raises:
        ValueError: the target lies in the aorta itself.
    """
    from cathsim.anatomy.vessel_tree import set_back

    return 1e3 * set_back(phantom.tree, phantom.target(target).branch)


def with_catheter_where_steep(phantom: Phantom, target: TargetLike, task: Task, *, choose: bool) -> Task:
    """The task with a catheter over the wire, where a wire alone comes from below and the ostium is set back so far.

    Says so in the log.

    Args:
        choose: False: the task stays as it is, and the log names the catheter.
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
        else f"stage.catheter={CATHETER} reaches further",
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
    """Number of the policy whose devices are to be taken in an anatomy, by episodes in copies of it.

    Args:
        policies: by a roadmap.
        tasks: of each, its devices and rules; their wires are longer where the way asks for it.
        target: its name, or a point in m.
        usual: as of `enn.device_trials.best_devices`.
        seed: of the first episode of each.
    """
    from cathsim.rehearsal.environment import NavigateCopiesEnv
    from cathsim.rehearsal.perturbation import Perturbation
    from enn.device_trials import TRIALS, Tried, best_devices, try_in_copies

    def tried(policy: Policy, task: Task, copies: int) -> Tried:
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
        outcome = Tried.of(try_in_copies(policy, environment, seed, cases=range(copies)))
        environment.close()
        return outcome

    return best_devices([partial(tried, *each) for each in zip(policies, tasks, strict=True)], usual)
