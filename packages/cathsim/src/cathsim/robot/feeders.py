"""What an action moves: the feeders of one or two devices and the motors of a tip, directly or by follower robots."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from cathsim.devices.simulation import DualSimulation
from cathsim.presets import ROTATION_STEP as ROTATION_STEP
from cathsim.presets import TRANSLATION_STEP as TRANSLATION_STEP
from cathsim.simulation import Simulation
from cathsim.validation import numbers

if TYPE_CHECKING:
    from cathsim.robot.follower import FollowerRobot

DRIVES = ("direct", "robot")


class Feeders:
    """Advances a simulation by actions of [-1, 1] each.

    An action holds translation and rotation of the wire's feeder, then those of the catheter's where there are two
    devices; or the shares of a tip's motors, then the translation.

    Attributes:
        robots: one a feeder, wire first; none with drive="direct".
        shape: of an action.

    Args:
        drive: "direct", or "robot": a follower robot for each feeder.

    Raises:
        ValueError: an unknown drive.
    """

    def __init__(self, simulation: Simulation, drive: str = "direct") -> None:
        if drive not in DRIVES:
            raise ValueError(f"unknown drive '{drive}'; there are {', '.join(DRIVES)}")
        self._simulation, self._motors = simulation, simulation.motors
        self._pair = simulation if isinstance(simulation, DualSimulation) and simulation.pair.both else None
        self.devices = 2 if self._pair else 1
        self.robots: tuple[FollowerRobot, ...] = ()
        if drive == "robot":
            from cathsim.robot.follower import FollowerRobot, RobotSettings

            interval = simulation.pace.interval
            timestep = interval / math.ceil(interval / RobotSettings().timestep - 1e-9)  # which divides it
            self.robots = tuple(FollowerRobot(RobotSettings(timestep=timestep)) for _ in range(self.devices))
        self.shape = (self._motors + 1,) if self._motors else (2 * self.devices,)

    def reset(self) -> None:
        """Puts the robots back to the rear end of their strokes."""
        for robot in self.robots:
            robot.reset()

    def checked(self, action: np.ndarray) -> np.ndarray:
        """An action as float64, clipped to [-1, 1].

        Raises:
            ValueError: it has another shape, holds no numbers, requires a gradient, or is not finite.
        """
        action = numbers("an action", action, self.shape)
        if not np.isfinite(action).all():
            raise ValueError(f"expected a finite action, got {action.tolist()}")
        return action.clip(-1.0, 1.0)

    def advance(self, action: np.ndarray) -> tuple[float, ...]:
        """One control step.

        Args:
            action: as `checked` returns it.

        Returns:
            Translation and rotation of each feeder, as shares of those at full action.
        """
        motors = action[:-1] if self._motors else None
        pace = self._simulation.pace
        if self._motors:
            moves = [(pace.translation * float(action[-1]), 0.0)]
        else:
            moves = [
                (pace.translation * float(action[2 * device]), pace.rotation * float(action[2 * device + 1]))
                for device in range(self.devices)
            ]
        if self.robots:
            moves = [robot.advance(*move, pace.interval) for robot, move in zip(self.robots, moves, strict=True)]
        if self._pair is not None:
            self._pair.advance(*moves[0], catheter=moves[1])
        else:
            self._simulation.advance(*moves[0], motors)
        return tuple(
            share
            for translation, rotation in moves
            for share in (translation / pace.translation, rotation / pace.rotation)
        )

    def info(self) -> dict[str, bool]:
        """Whether each robot's clamps hold its device: `driven`, and `catheter_driven` with two; empty without one."""
        return {name: robot.driven for name, robot in zip(("driven", "catheter_driven"), self.robots, strict=False)}

    def state(self) -> list[dict[str, Any]]:
        """Of the robots, to be pickled; for `restore`."""
        return [robot.state() for robot in self.robots]

    def restore(self, state: list[dict[str, Any]]) -> None:
        """Returns to a state of feeders with the same drive."""
        for robot, one in zip(self.robots, state, strict=True):
            robot.restore(one)
