"""A word beforehand where a wire alone seldom gets in: ostia far behind the top of the arch."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

from pipeline.task import DESCENDING, Task

if TYPE_CHECKING:
    from cathsim.anatomy import Phantom
    from cathsim.anatomy.point_target import TargetLike

# mm; the shipped policy reached 128 of 133 targets below it and 6 of 17 others (docs/results/generalist.md)
STEEP_MM = 13.0

_LOGGER = logging.getLogger(__name__)


def warn_of_steep_take_off(phantom: Phantom, target: TargetLike, task: Task) -> None:
    """Logs that a wire alone may not do, where it comes from below and the target's ostium is set back so far."""
    from cathsim.anatomy.measurement.take_off import set_back

    place = phantom.target(target)
    if task.catheter is not None or task.entry != DESCENDING or place.branch == phantom.tree.root.name:
        return
    back = 1e3 * set_back(phantom.tree, place.branch)
    if back >= STEEP_MM:
        _LOGGER.warning(
            "%s of %s leaves the aorta steeply: its ostium lies %.0f mm behind the top of the arch, seen along the "
            "branch; from %.0f mm on a wire alone is seldom brought in: task.catheter=simmons2 reaches further",
            place.name,
            phantom.name,
            back,
            STEEP_MM,
        )
