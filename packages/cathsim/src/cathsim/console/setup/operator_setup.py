"""What the operator starts with: anatomy, target, devices, time stepping."""

from __future__ import annotations

from dataclasses import field
from typing import Annotated, Any

from annotated_types import Interval

from cathsim.anatomy import PHANTOMS, Phantom
from cathsim.environment import NavigateEnv
from cathsim.metrics import FORCE_LIMIT
from cathsim.navigation import NavigationTask
from cathsim.validation import Count, Seed, Unit, settings

Newtons = Annotated[float, Interval(gt=0, le=100), Unit("N")]


LARGEST_RADIUS = 0.05  # m: a target that is reached from further away is none


@settings
class ForceLimit:
    """From which contact force on the operator is warned, or the procedure ends."""

    force: Newtons = FORCE_LIMIT  # largest resultant contact force of a step
    ends: bool = False  # the procedure ends with the first step that reaches it


class ForceWatch:
    """Counts how often the contact force rises to a limit in a procedure.

    Attributes:
        warnings: so far; steps at or above the limit that follow each other are one.
    """

    def __init__(self, limit: ForceLimit) -> None:
        self.limit, self.warnings, self._above = limit, 0, False

    def see(self, force: float) -> bool:
        """Whether a step's largest contact force (N) is a new warning."""
        above = force >= self.limit.force
        new, self._above = above and not self._above, above
        self.warnings += new
        return new

    @property
    def ends(self) -> bool:
        """Whether the procedure ends with the step that was seen last."""
        return self.limit.ends and self._above


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
            success=_rule(phantom.name),
        )

    def task(self, phantom: str, target: str, catheter: str | None) -> dict[str, Any]:
        """What the sampling expert is asked to do beside a procedure, from the first start, as plain values."""
        return {
            "phantom": phantom, "target": target, "wire": self.wire, "catheter": catheter, "accuracy": self.accuracy,
            "max_steps": self.max_steps, "seed": self.seed, "success_radius": self.success_radius,
            "success": _rule(phantom),
            "most_force": self.force_limit.force if self.force_limit.ends else None,
        }  # fmt: skip


def _rule(phantom: str) -> str:
    """The rule of success in a phantom of a name: in named ones the thesis's, so that people compare with its rows."""
    return "straight" if phantom in PHANTOMS else NavigationTask.success
