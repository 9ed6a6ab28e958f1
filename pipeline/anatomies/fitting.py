"""A task that fits a way: a wire as long as it asks for, and episodes that last long enough."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from pipeline.task import NO_WIRE, Task, entry_place

if TYPE_CHECKING:
    from cathsim.anatomy import Phantom

_LEAST_TIMES, _TIMES = 2.0, 3.0  # of the steps that a way takes at full speed: the fewest of an episode; a long one's
_ROOM = 0.03  # m of wire beyond the way to the target and what lies in the sheath

_LOGGER = logging.getLogger(__name__)


def fitted_task(task: Task, phantom: Phantom, targets: Sequence[Any]) -> Task:
    """The task with a wire that reaches the targets from its entry, where its length is left open.

    Args:
        targets: names, or points in m.

    Raises:
        ValueError: an unknown target or entry.
    """
    from cathsim.anatomy.entry import entry_name
    from cathsim.devices.arena import RESERVE

    ways = [phantom.way_length(target, entry_name(entry_place(task.entry), target)) for target in targets]
    if task.wire_length_mm or task.wire == NO_WIRE:
        return task
    needed = max(ways) + RESERVE + _ROOM
    return task if needed <= task.guidewire().length else replace(task, wire_length_mm=10.0 * math.ceil(100.0 * needed))


def fitted_steps(task: Task, phantom: Phantom, target: Any) -> Task:
    """The task with longer episodes, where its own leave less than twice the time of a straight way at full speed.

    They then have three times that, in full hundreds of steps, and the log says so.

    Args:
        target: a name, or a point in m.

    Raises:
        ValueError: an unknown target or entry.
    """
    from cathsim.anatomy.entry import entry_name
    from cathsim.robot.pace import named_pace

    way = phantom.way_length(target, entry_name(entry_place(task.entry), target))
    straight = way / named_pace(task.pace).translation
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
