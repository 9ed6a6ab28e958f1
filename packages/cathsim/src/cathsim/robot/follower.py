"""The follower robot that feeds the wire, and the leader that an operator moves.

The wire's feeder moves as the platform does whose clamp holds it: clamps do not slip and the wire does not buckle
between robot and sheath (the thesis's assumption of perfect motion).
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import Annotated, Any

import mujoco
import numpy as np
from annotated_types import Interval

from cathsim.robot.model import (
    CARRIAGE,
    DRIVING_CLAMP,
    GUIDEWIRE_ROTARY,
    HOLDING_CLAMP,
    JAWS,
    WHEEL,
    robot_spec,
)
from cathsim.robot.model import RobotSettings as RobotSettings
from cathsim.validation import Coordinate, Length, settings

CLOSED = 1.0e-4  # a jaw nearer than this to the wire holds it, m
SETTLED = 2.0e-6  # m from the set point
STILL = 1.0e-4  # m/s and rad/s, below which nothing moves


_Scale = Annotated[float, Interval(gt=0, le=1000)]
_STATE = mujoco.mjtState.mjSTATE_INTEGRATION.value


class Phase(enum.IntEnum):
    """Where the cycle stands; the wire can move in DRIVE alone, and comes to rest in HOLD."""

    DRIVE = 0  # the driving clamp holds the wire and moves it
    HOLD = 1  # the carriage settles, then the holding clamp closes
    RELEASE = 2  # the driving clamp opens
    RETURN = 3  # the carriage goes back to the other end of its stroke
    GRIP = 4  # the driving clamp closes
    LET_GO = 5  # the holding clamp opens


@dataclass(frozen=True)
class Measured:
    """Joint positions and rates that the cycle reads."""

    carriage: float  # of the driving clamp's platform, m
    carriage_speed: float  # m/s
    wheel: float  # of the guidewire's rotary part, rad
    wheel_speed: float  # rad/s
    driving_jaw: float  # opening of the driving clamp, m
    holding_jaw: float  # ... of the holding clamp, m.

    @property
    def driven(self) -> bool:
        """Whether the wire moves with the carriage: the driving clamp holds it and the holding clamp does not."""
        return self.driving_jaw < CLOSED <= self.holding_jaw


class FeedCycle:
    """Set points of carriage, wheel and clamps from what is still to be fed, one tick after the other.

    Attributes:
        phase: where the cycle stands.
        carriage: set point of the carriage, m, in 0 to the stroke.
        wheel: set point of the wheel, rad.
        driving_jaw: set point of the driving clamp's opening, m.
        holding_jaw: ... of the holding clamp's, m.
        strokes: completed strokes.
    """

    def __init__(self, settings: RobotSettings) -> None:
        self.settings = settings
        self.reset()

    def reset(self) -> None:
        """Back to the rear end of the stroke, the driving clamp closed and the holding clamp open."""
        self.phase = Phase.DRIVE
        self.carriage = self.wheel = self.driving_jaw = 0.0
        self.holding_jaw = self.settings.jaw_opening
        self.strokes = 0
        self._back = 0.0

    def state(self) -> dict[str, float]:
        """Where the cycle stands, as plain numbers, for `restore`."""
        return {name: value for name, value in vars(self).items() if name != "settings"} | {"phase": int(self.phase)}

    def restore(self, state: dict[str, float]) -> None:
        """Returns to a saved place."""
        vars(self).update(state)
        self.phase = Phase(int(state["phase"]))

    def tick(self, measured: Measured, translation: float, rotation: float) -> None:
        """Moves the set points on by one time step.

        Args:
            measured: the robot's state.
            translation: that the wire is still to be moved, m.
            rotation: that it is still to be turned, rad.
        """
        settings, step = self.settings, self.settings.timestep
        if self.phase == Phase.DRIVE:
            raw_goal = measured.carriage + translation
            goal = min(max(raw_goal, 0.0), settings.stroke)
            self.carriage = _towards(self.carriage, goal, settings.speed * step)
            self.wheel = _towards(self.wheel, measured.wheel + rotation, settings.rotation_speed * step)
            spent = abs(raw_goal - goal) > SETTLED and abs(measured.carriage - goal) < 10 * SETTLED
            if spent:
                self.phase = Phase.HOLD
                self._back = 0.0 if translation > 0 else settings.stroke
        elif self.phase == Phase.HOLD:
            settled = abs(measured.carriage - self.carriage) < SETTLED and abs(measured.carriage_speed) < STILL
            if settled and abs(measured.wheel_speed) < STILL and self._jaw("holding_jaw", 0.0, measured):
                self.phase = Phase.RELEASE
        elif self.phase == Phase.RELEASE:
            if self._jaw("driving_jaw", settings.jaw_opening, measured):
                self.phase = Phase.RETURN
        elif self.phase == Phase.RETURN:
            self.carriage = _towards(self.carriage, self._back, settings.return_speed * step)
            arrived = abs(measured.carriage - self._back) < SETTLED and abs(measured.carriage_speed) < STILL
            if arrived:
                self.phase = Phase.GRIP
        elif self.phase == Phase.GRIP:
            if self._jaw("driving_jaw", 0.0, measured):
                self.phase = Phase.LET_GO
        elif self._jaw("holding_jaw", settings.jaw_opening, measured):
            self.phase = Phase.DRIVE
            self.strokes += 1

    def _jaw(self, name: str, goal: float, measured: Measured) -> bool:
        """Moves a jaw's set point to a goal; whether the jaw is there."""
        set_point = _towards(getattr(self, name), goal, self.settings.jaw_speed * self.settings.timestep)
        setattr(self, name, set_point)
        return abs(getattr(measured, name) - goal) < CLOSED / 2


def _towards(value: float, goal: float, most: float) -> float:
    """A value moved to a goal by so much at most."""
    return value + min(max(goal - value, -most), most)


class FollowerRobot:
    """A robot that feeds and turns a wire stroke by stroke.

    Attributes:
        model: of the robot alone; see `cathsim.robot.model` for its frame and joints.
        cycle: the state machine behind its set points.
    """

    def __init__(self, settings: RobotSettings | None = None) -> None:
        self.settings = settings or RobotSettings()
        self.model = robot_spec(self.settings).compile()
        self.data = mujoco.MjData(self.model)
        self.cycle = FeedCycle(self.settings)
        place = {self.model.joint(i).name: i for i in range(self.model.njnt)}  # every joint has one number
        self._carriage, self._wheel = place[DRIVING_CLAMP], place[WHEEL.format(GUIDEWIRE_ROTARY)]
        self._pair = [place[name] for name in CARRIAGE]
        self._driving = [place[jaw.format(DRIVING_CLAMP)] for jaw in JAWS]
        self._holding = [place[jaw.format(HOLDING_CLAMP)] for jaw in JAWS]
        self._servo = [int(self.model.actuator(self.model.joint(i).name).id) for i in range(self.model.njnt)]
        self.reset()

    def reset(self) -> None:
        """Back to the rear end of the stroke, the wire clamped."""
        mujoco.mj_resetData(self.model, self.data)
        self.cycle.reset()
        self.data.qpos[self._holding] = self.cycle.holding_jaw
        self.pending_translation = self.pending_rotation = 0.0
        self._set()
        mujoco.mj_forward(self.model, self.data)

    def state(self) -> dict[str, Any]:
        """Everything that a continuation depends on, to be pickled; for `restore`."""
        joints = np.zeros(mujoco.mj_stateSize(self.model, _STATE))
        mujoco.mj_getState(self.model, self.data, joints, _STATE)
        pending = (self.pending_translation, self.pending_rotation)
        return {"joints": joints, "cycle": self.cycle.state(), "pending": pending}

    def restore(self, state: dict[str, Any]) -> None:
        """Returns to a state of a robot with the same settings."""
        mujoco.mj_resetData(self.model, self.data)
        mujoco.mj_setState(self.model, self.data, state["joints"], _STATE)
        mujoco.mj_kinematics(self.model, self.data)
        self.cycle.restore(state["cycle"])
        self.pending_translation, self.pending_rotation = state["pending"]

    def __getstate__(self) -> dict[str, Any]:
        return {"settings": self.settings, "state": self.state()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        FollowerRobot.__init__(self, state["settings"])
        self.restore(state["state"])

    @property
    def phase(self) -> Phase:
        """Where the feed cycle stands."""
        return self.cycle.phase

    @property
    def driven(self) -> bool:
        """Whether the wire follows the carriage at the moment."""
        return self._measure().driven

    def advance(self, translation: float, rotation: float, duration: float = 0.1) -> tuple[float, float]:
        """Moves the robot on for a while (s).

        Args:
            translation: commanded on top of what is pending, m; positive inserts.
            rotation: commanded on top of what is pending, rad; positive about the direction of insertion.

        Returns:
            Translation (m) and rotation (rad) of the wire; zero while the driving clamp does not hold it.

        Raises:
            ValueError: a command that is not finite.
        """
        if not (np.isfinite(translation) and np.isfinite(rotation)):
            raise ValueError(f"expected a finite translation (m) and rotation (rad), got {translation}, {rotation}")
        moved = turned = 0.0
        left, left_rotation = self.pending_translation + translation, self.pending_rotation + rotation
        before = self._measure()
        for _ in range(round(duration / self.settings.timestep)):
            self.cycle.tick(before, left - moved, left_rotation - turned)
            self._set()
            mujoco.mj_step(self.model, self.data)
            now = self._measure()
            if before.driven and now.driven:
                moved += now.carriage - before.carriage
                turned += now.wheel - before.wheel
            before = now
        settings = self.settings
        self.pending_translation = min(max(left - moved, -settings.backlog), settings.backlog)
        most = settings.rotation_backlog
        self.pending_rotation = min(max(left_rotation - turned, -most), most)
        return moved, turned

    def _measure(self) -> Measured:
        qpos, qvel = self.data.qpos, self.data.qvel
        return Measured(
            carriage=float(qpos[self._carriage]),
            carriage_speed=float(qvel[self._carriage]),
            wheel=float(qpos[self._wheel]),
            wheel_speed=float(qvel[self._wheel]),
            driving_jaw=float(qpos[self._driving].max()),
            holding_jaw=float(qpos[self._holding].max()),
        )

    def _set(self) -> None:
        cycle = self.cycle
        for joints, value in (
            (self._pair, cycle.carriage),
            ([self._wheel], cycle.wheel),
            (self._driving, cycle.driving_jaw),
            (self._holding, cycle.holding_jaw),
        ):
            for joint in joints:
                self.data.ctrl[self._servo[joint]] = value


@settings(frozen=False)
class Leader:
    """The operator's side: a handle whose displacement and rotation map linearly to the follower's command."""

    translation_scale: _Scale = 1.0  # follower's translation over the leader's
    rotation_scale: _Scale = 1.0  # follower's rotation over the leader's
    stroke: Length = 0.060  # travel of the handle to either side of its middle, m; beyond it the handle stops
    position: Coordinate = 0.0  # of the handle, m
    engaged: bool = True  # with the clutch open the handle moves alone

    def move(self, translation: float, rotation: float) -> tuple[float, float]:
        """Moves the handle by a translation (m), as far as its stroke allows, and a rotation (rad).

        Returns:
            The follower's command: translation (m) and rotation (rad), zero with the clutch open.
        """
        place = min(max(self.position + translation, -self.stroke), self.stroke)
        done, self.position = place - self.position, place
        if not self.engaged:
            return 0.0, 0.0
        return self.translation_scale * done, self.rotation_scale * rotation
