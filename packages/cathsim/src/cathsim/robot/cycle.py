"""The feed cycle: clamp, advance, hold, release, return; an insertion of any length from short strokes."""

from __future__ import annotations

import enum
from dataclasses import dataclass

from cathsim.robot.model import RobotSettings

CLOSED = 1.0e-4  # a jaw nearer than this to the wire holds it, m
SETTLED = 2.0e-6  # m from the set point
STILL = 1.0e-4  # m/s and rad/s, below which nothing moves


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
            wanted = measured.carriage + translation
            goal = min(max(wanted, 0.0), settings.stroke)
            self.carriage = _towards(self.carriage, goal, settings.speed * step)
            self.wheel = _towards(self.wheel, measured.wheel + rotation, settings.rotation_speed * step)
            spent = abs(wanted - goal) > SETTLED and abs(measured.carriage - goal) < 10 * SETTLED
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
        here = _towards(getattr(self, name), goal, self.settings.jaw_speed * self.settings.timestep)
        setattr(self, name, here)
        return abs(getattr(measured, name) - goal) < CLOSED / 2


def _towards(value: float, goal: float, most: float) -> float:
    """A value moved to a goal by so much at most."""
    return value + min(max(goal - value, -most), most)
