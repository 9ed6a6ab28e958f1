"""What the operator starts with: anatomy, target, devices, time stepping."""

from __future__ import annotations

from dataclasses import field
from typing import Annotated, Any

from annotated_types import Interval

from cathsim.anatomy import Phantom
from cathsim.console.setup.force_limit import ForceLimit
from cathsim.environment import NavigateEnv
from cathsim.navigation import NavigationTask
from cathsim.validation import Count, Seed, Unit, settings

LARGEST_RADIUS = 0.05  # m: a target that is reached from further away is none


@settings
class Setup:
    """What the operator starts with."""

    phantom: str = "type_1"  # name of the phantom
    target: str = "bca"  # name of the target
    wire: str = "default"  # preset of the guidewire
    catheter: str | None = None  # a preset, or the path of a YAML file; None: the bare wire
    accuracy: str = "accurate"  # preset of the time stepping
    max_steps: Count = NavigationTask.max_steps  # a procedure ends after so many control steps
    seed: Seed = 0  # of the first procedure; each further one has the next
    # the target is reached within this distance of the tip, m
    success_radius: Annotated[float, Interval(ge=0.001, le=LARGEST_RADIUS), Unit("m")] = NavigationTask.success_radius
    force_limit: ForceLimit = field(default_factory=ForceLimit)

    def environment(self, phantom: Phantom, target: str, catheter: str | None) -> NavigateEnv:
        """The environment of a procedure; its image is that of other recorded episodes.

        Raises:
            ValueError: an unknown device, devices that do not fit, or a target out of their reach.
        """
        return NavigateEnv(
            phantom,
            target,
            wire=self.wire,
            catheter=catheter,
            accuracy=self.accuracy,
            observation="tip",
            max_steps=self.max_steps,
            success_radius=self.success_radius,
        )

    def task(self, phantom: str, target: str, catheter: str | None) -> dict[str, Any]:
        """What the sampling expert is asked to do beside a procedure, from the first start, as plain values."""
        return {
            "phantom": phantom, "target": target, "wire": self.wire, "catheter": catheter, "accuracy": self.accuracy,
            "max_steps": self.max_steps, "seed": self.seed, "success_radius": self.success_radius,
            "most_force": self.force_limit.force if self.force_limit.ends else None,
        }  # fmt: skip
