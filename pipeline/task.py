"""The task: devices, actions, images, limits and start of an episode, declared once and carried from stage to stage.

Every stage takes the run's ``task`` over as ``stage.task``, its jobs carry it, and what they leave (logs, policies)
says which one it was. A stage that goes on from an earlier one's results compares its own with theirs and refuses a
difference by name.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pipeline.settings import kinds
from pipeline.store.errors import ConfigurationError, StageError
from pipeline.store.provenance import hash_file

if TYPE_CHECKING:
    from cathsim import Catheter, Guidewire
    from cathsim.devices.pair import DevicePair

FEEDER, TIP_MOTORS = "feeder", "tip_motors"
TASK = "task"  # key in the metadata of policies
LENGTH = "wire_length_mm"
DESCENDING = "descending"  # the usual entry: from the groin
NO_WIRE = "none"  # in place of a wire: the catheter alone
_MM = 1e3
_DECISION_S = 0.3  # as of enn's DESK_SAC
USUAL_PACE = "usual"
_JOINTS, _FEEDER_STATE = ("joints", "internal"), "feeder"  # observations
_SAME = 1e-9  # relative: lengths come back from logs in metres


@kinds.validated("task.")
class Task:
    """What an episode asks for, whatever the anatomy and the target; treated as immutable once it is made."""

    wire: kinds.FolderName = "default"  # preset of the guidewire, or "none"; checked by `require_known_task`
    wire_length_mm: kinds.WireLength = 0.0  # to which it is scaled; 0: as long as the preset
    # preset of the catheter over the wire, or its YAML file; null: the wire alone
    catheter: kinds.PathText | None = None
    torsion: Annotated[str, kinds.one_of("elastic", "rigid")] = "elastic"  # of wire and catheter, where there is one
    # "feeder" (translation and rotation, of the wire, then of the catheter) or "tip_motors" (the thesis's twenty-one)
    actions: Annotated[str, kinds.one_of(FEEDER, TIP_MOTORS)] = FEEDER
    # how often decisions are taken and how far full actions move: "usual" (10 a second) or "arch_variety" (7.5)
    pace: Annotated[str, kinds.one_of(USUAL_PACE, "arch_variety")] = USUAL_PACE
    image_size_px: kinds.ImageSize = 80  # side of the images
    max_steps: kinds.Count = 300  # of 0.1 s at the usual pace, after which an episode is cut off
    success_radius_mm: kinds.SuccessRadius = 8.0  # the target is reached within this distance of the tip
    # "lumen" (in the target's branch) or "straight"; null: straight in learning stages on named phantoms, as the thesis
    success: Annotated[str, kinds.one_of("lumen", "straight")] | None = None
    start_jitter_mm: kinds.StartJitter = 1.0  # the wire starts advanced by up to this much
    start_rotation_deg: kinds.StartRotation = 180.0  # ... and turned by up to this much either way
    # where the sheath ends: a name of the anatomy's, or coordinates in m, world frame
    entry: kinds.PathText = DESCENDING

    def __post_init__(self) -> None:
        """Refuses neither wire nor catheter, and a catheter that motors are to steer."""
        if self.catheter is None and self.wire == NO_WIRE:
            raise ConfigurationError(f"{TASK}.wire={NO_WIRE} leaves no device: name a catheter or a wire")
        if self.catheter is not None and self.actions != FEEDER:
            raise ConfigurationError(
                f"{TASK}.actions={self.actions} bends the tip of a wire alone, got {TASK}.catheter={self.catheter}: "
                "leave one of them out"
            )

    @property
    def success_radius(self) -> float:
        """In m."""
        return self.success_radius_mm / _MM

    @property
    def device_names(self) -> str:
        """Wire and catheter in words."""
        if self.wire == NO_WIRE:
            return f"{self.catheter} alone"
        return self.wire if self.catheter is None else f"{self.wire} in {self.catheter}"

    @property
    def two_devices(self) -> bool:
        """Whether there is a wire in a catheter."""
        return self.catheter is not None and self.wire != NO_WIRE

    def guidewire(self) -> Guidewire:
        """The wire; there must be one."""
        return self.scaled(self.wire)

    def scaled(self, preset: str) -> Guidewire:
        """Another preset at the task's length."""
        from cathsim import load_guidewire

        wire = load_guidewire(preset)
        return wire.scaled(self.wire_length_mm / _MM) if self.wire_length_mm else wire

    def guiding_catheter(self) -> Catheter | None:
        """The catheter; None: there is none."""
        from cathsim import load_catheter

        return None if self.catheter is None else load_catheter(self.catheter)

    def devices(self) -> dict[str, Any]:
        """Wire, and where there is one, catheter and torsion, as arguments of an environment."""
        wire, catheter = self._wire(), self.guiding_catheter()
        return {"wire": wire} if catheter is None else {"wire": wire, "catheter": catheter, "torsion": self.torsion}

    def _wire(self) -> Guidewire | None:
        return None if self.wire == NO_WIRE else self.guidewire()

    def pair(self) -> DevicePair:
        """Wire and catheter, either of which may be absent; a ValueError where the wire does not pass the catheter."""
        from cathsim.devices.pair import DevicePair

        return DevicePair(self._wire(), self.guiding_catheter())

    def success_in(self, phantom: str | None) -> str:
        """The rule of success in a phantom of a name, or in others."""
        from cathsim import PHANTOMS
        from cathsim.navigation import NavigationTask

        return self.success or ("straight" if phantom in PHANTOMS else NavigationTask.success)

    def rules(self, phantom: str | None = None) -> dict[str, Any]:
        """Pace, images, limits, success, start and entry as arguments of an environment, in m and rad.

        Args:
            phantom: the name of the anatomy, where it counts as the thesis's if it has that of one.
        """
        return {
            "pace": self.pace,
            "image_size": self.image_size_px,
            "max_steps": self.max_steps,
            "success_radius": self.success_radius,
            "success": self.success_in(phantom),
            "start_jitter": self.start_jitter_mm / _MM,
            "start_rotation": math.radians(self.start_rotation_deg),
            "entry": entry_place(self.entry),
        }

    def arguments(self, phantom: str | None = None) -> dict[str, Any]:
        """All of it as arguments of `cathsim.NavigateEnv`; the phantom as of `rules`."""
        return {**self.devices(), "actions": self.actions, **self.rules(phantom)}


def entry_place(entry: str) -> str | tuple[float, float, float]:
    """An entry as an environment takes it: its name, or of coordinates in text the point in m."""
    from cathsim.anatomy.entry import read_point

    point = read_point(entry)
    return entry if point is None else point[0]


def decision_steps(task: Task) -> int:
    """Steps that a policy holds an action: those of 0.3 s."""
    from cathsim.presets import PACES

    return max(round(_DECISION_S / PACES[task.pace].interval), 1)


def number_of_actions(task: Task) -> int:
    """How many numbers an action has: as `cathsim.NavigateEnv` makes its space."""
    if task.actions == FEEDER:
        return 4 if task.two_devices else 2
    wire = task.guidewire()
    return 2 * min(wire.motor_joints, wire.joints) + 1


PARTS = tuple(field.name for field in dataclasses.fields(Task))
# What the actions of an episode have to do with: the same devices, moved the same way, to the same end.
MOTION = ("wire", LENGTH, "catheter", "torsion", "actions", "pace", "success_radius_mm", "success")


def task_in_random_arches() -> Task:
    """The default in random arches: a wire that reaches the targets of large ones."""
    return Task(wire_length_mm=400.0, image_size_px=192)


def task_from(values: Any) -> Task | None:
    """The task that `dataclasses.asdict` left in a policy's metadata; None: there is none, or of another version."""
    try:
        return Task(**values)
    except (TypeError, ValueError, ConfigurationError):
        return None


def require_known_task(task: Task) -> None:
    """Refuses a wire or catheter that there is not, and a catheter that the wire does not pass."""
    from cathsim import GUIDEWIRES

    if task.wire not in (*GUIDEWIRES, NO_WIRE):
        raise ConfigurationError(f"unknown wire {task.wire!r}: choose from {', '.join(GUIDEWIRES)}, {NO_WIRE}")
    if task.catheter is not None:
        try:
            task.pair()
        except ValueError as error:
            raise ConfigurationError(str(error)) from error


def observed(task: Task, keys: Sequence[str]) -> tuple[str, ...]:
    """What a policy sees of a task: with a catheter, joints of the rod of both devices and the feeders' state."""
    inside = task.two_devices and any(key in _JOINTS for key in keys) and _FEEDER_STATE not in keys
    return (*keys, _FEEDER_STATE) if inside else tuple(keys)


def joint_observations(task: Task) -> int:
    """How many numbers the observation `joints` has: positions and velocities of feeder and hinges."""
    joints = task.guidewire().joints if task.catheter is None else len(task.pair().links()) - 1
    return 4 * (joints + 1)


def device_files(task: Task) -> dict[str, str]:
    """Hash of the file of a catheter of one's own, which results depend on as on an earlier stage's."""
    if task.catheter is None or not Path(task.catheter).is_file():
        return {}
    return {"catheter": hash_file(Path(task.catheter))}


def require_feeder(task: Task, stage: str) -> None:
    """Refuses the tip motors where only the feeder is steered."""
    if task.actions != FEEDER:
        raise ConfigurationError(
            f"stage {stage} steers the feeder, got {TASK}.actions={task.actions}: leave it at {FEEDER}"
        )


def differences(one: Task, other: Task, parts: Sequence[str] = PARTS) -> list[str]:
    """Names of the parts in which two tasks differ."""
    names = [name for name in parts if not _same(getattr(one, name), getattr(other, name))]
    if LENGTH in names and one.wire == other.wire and (one.wire == NO_WIRE or one.guidewire() == other.guidewire()):
        names.remove(LENGTH)  # wires are made of whole links: two lengths may be one wire
    if "catheter" in names and _same_catheter(one, other):
        names.remove("catheter")
    if "torsion" in names and one.catheter is None and other.catheter is None:
        names.remove("torsion")
    return names


def _same_catheter(one: Task, other: Task) -> bool:
    """Whether two names are those of one catheter."""
    try:
        return one.guiding_catheter() == other.guiding_catheter()
    except ValueError:  # e.g. the file of one is no longer there
        return False


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, float) or isinstance(other, float):
        return math.isclose(one, other, rel_tol=_SAME, abs_tol=_SAME)
    return bool(one == other)


def require_same_task(
    stage: str, requested: Task, found: Task, whose: str, maker: str, parts: Sequence[str] = PARTS
) -> None:
    """Refuses what an earlier stage made for another task; `whose`: e.g. "the expert policy of type_1/bca"."""
    differing = differences(requested, found, parts)
    if not differing:
        return
    request, result = (", ".join(f"{name}={getattr(task, name)}" for name in differing) for task in (requested, found))
    raise StageError(
        f"stage {stage} was asked for {request}, but {whose} was made by stage {maker} with {result}: give both stages "
        f"the same task ({', '.join(f'task.{name}=…' for name in differing)}), or run stage={maker} again"
    )
