"""The task: wire, actions, images, limits and start of an episode, declared once and carried from stage to stage.

``task`` and ``unseen_task`` in ``conf/config.yaml`` are the only declarations. Every stage takes one of them over as
``stage.task``, its jobs carry it, and what they leave (logs, policies) says which one it was. A stage that goes on from
an earlier one's results compares its own with theirs and refuses a difference by name.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any

from pipeline.settings.checks import validated
from pipeline.settings.kinds import (
    Count,
    FolderName,
    ImageSize,
    StartJitter,
    StartRotation,
    SuccessRadius,
    WireLength,
    one_of,
)
from pipeline.store.errors import ConfigurationError, StageError

if TYPE_CHECKING:
    from cathsim import Guidewire

FEEDER, TIP_MOTORS = "feeder", "tip_motors"
TASK = "task"  # key in the metadata of policies
LENGTH = "wire_length_mm"
_MM = 1e3
_SAME = 1e-9  # relative: lengths come back from logs in metres


@validated("task.")
class Task:
    """What an episode asks for, whatever the anatomy and the target; treated as immutable once it is made."""

    wire: FolderName = "default"  # preset of the guidewire; checked by `require_known_task`
    wire_length_mm: WireLength = 0.0  # to which it is scaled; 0: as long as the preset
    # "feeder" (two: translation, rotation) or "tip_motors" (the thesis's twenty-one)
    actions: Annotated[str, one_of(FEEDER, TIP_MOTORS)] = FEEDER
    image_size_px: ImageSize = 80  # side of the images
    max_steps: Count = 300  # of 0.1 s, after which an episode is cut off
    success_radius_mm: SuccessRadius = 8.0  # the target is reached within this distance of the tip
    start_jitter_mm: StartJitter = 1.0  # the wire starts advanced by up to this much
    start_rotation_deg: StartRotation = 180.0  # ... and turned by up to this much either way

    @property
    def success_radius(self) -> float:
        """In m."""
        return self.success_radius_mm / _MM

    def guidewire(self) -> Guidewire:
        """The wire."""
        return self.scaled(self.wire)

    def scaled(self, preset: str) -> Guidewire:
        """Another preset at the task's length."""
        from cathsim import load_guidewire

        wire = load_guidewire(preset)
        return wire.scaled(self.wire_length_mm / _MM) if self.wire_length_mm else wire

    def rules(self) -> dict[str, Any]:
        """Images, limits and start as arguments of an environment, in m and rad."""
        return {
            "image_size": self.image_size_px,
            "max_steps": self.max_steps,
            "success_radius": self.success_radius,
            "start_jitter": self.start_jitter_mm / _MM,
            "start_rotation": math.radians(self.start_rotation_deg),
        }

    def arguments(self) -> dict[str, Any]:
        """All of it as arguments of `cathsim.NavigateEnv`."""
        return {"wire": self.guidewire(), "actions": self.actions, **self.rules()}


def number_of_actions(task: Task) -> int:
    """How many numbers an action has: as `cathsim.NavigateEnv` makes its space."""
    wire = task.guidewire()
    return 2 if task.actions == FEEDER else 2 * min(wire.motor_joints, wire.joints) + 1


PARTS = tuple(field.name for field in dataclasses.fields(Task))
# What the actions of an episode have to do with: the same wire, moved the same way, to the same end.
MOTION = ("wire", LENGTH, "actions", "success_radius_mm")


def task_in_random_arches() -> Task:
    """The default in random arches: a wire that reaches the targets of large ones."""
    return Task(wire_length_mm=312.0, image_size_px=192)


def task_from(values: Any) -> Task | None:
    """The task that a policy's metadata tells of.

    Args:
        values: as `dataclasses.asdict` gave them.

    Returns:
        None: there is none, or it is of another version.
    """
    try:
        return Task(**values)
    except (TypeError, ValueError, ConfigurationError):
        return None


def require_known_task(task: Task) -> None:
    """Refuses a wire that there is not.

    Raises:
        ConfigurationError: listing the wires.
    """
    from cathsim import GUIDEWIRES

    if task.wire not in GUIDEWIRES:
        raise ConfigurationError(f"unknown wire {task.wire!r}: choose from {', '.join(GUIDEWIRES)}")


def require_feeder(task: Task, stage: str) -> None:
    """Refuses the tip motors where only the feeder is steered.

    Raises:
        ConfigurationError: naming the stage.
    """
    if task.actions != FEEDER:
        raise ConfigurationError(
            f"stage {stage} steers the feeder's two actions, got {TASK}.actions={task.actions}: leave it at {FEEDER}"
        )


def differences(one: Task, other: Task, parts: Sequence[str] = PARTS) -> list[str]:
    """Names of the parts in which two tasks differ."""
    found = [name for name in parts if not _same(getattr(one, name), getattr(other, name))]
    if LENGTH in found and one.wire == other.wire and one.guidewire() == other.guidewire():
        found.remove(LENGTH)  # wires are made of whole links: two lengths may be one wire
    return found


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, float) or isinstance(other, float):
        return math.isclose(one, other, rel_tol=_SAME, abs_tol=_SAME)
    return bool(one == other)


def require_same_task(
    stage: str, wanted: Task, found: Task, whose: str, maker: str, parts: Sequence[str] = PARTS
) -> None:
    """Refuses what an earlier stage made for another task.

    Args:
        whose: what that is, e.g. "the expert policy of type_1/bca".

    Raises:
        StageError: names every difference.
    """
    differing = differences(wanted, found, parts)
    if not differing:
        return
    here, there = (", ".join(f"{name}={getattr(task, name)}" for name in differing) for task in (wanted, found))
    raise StageError(
        f"stage {stage} was asked for {here}, but {whose} was made by stage {maker} with {there}: give both stages the "
        f"same task ({', '.join(f'task.{name}=…' for name in differing)}), or run stage={maker} again"
    )
