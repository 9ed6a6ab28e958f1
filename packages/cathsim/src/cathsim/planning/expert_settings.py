"""Settings of the sampling expert, and those that two devices need."""

from __future__ import annotations

from typing import Annotated

from annotated_types import Interval

from cathsim.validation import Count, Unit, settings

_Steps = Annotated[int, Interval(ge=1, le=10_000)]


@settings
class ExpertSettings:
    """How the expert searches."""

    horizon: _Steps = 18  # length of a plan, control steps
    hold: _Steps = 3  # steps for which a sampled action is held
    execute: _Steps = 6  # steps of a plan that are carried out before it is looked at again
    samples: Count = 24  # plans a round
    elites: Count = 5  # best plans, to which the sampling distribution is fitted
    rounds: Annotated[int, Interval(ge=0, le=1000)] = 3  # of sampling at most
    # cost of a newton of contact force above `free_force`, in metres of distance to the target
    force_cost: Annotated[float, Interval(ge=0, le=1000), Unit("m/N")] = 0.004
    free_force: Annotated[float, Interval(ge=0, le=1000), Unit("N")] = 0.15  # N
    # contact force beyond which a plan costs a metre a newton, and a manoeuvre ends; the default is no limit
    most_force: Annotated[float, Interval(gt=0, le=1000), Unit("N")] = 1000.0
    # lead of the wire before the catheter beyond which a plan costs a metre a metre: a wire far ahead strays
    most_lead: Annotated[float, Interval(ge=0, le=10), Unit("m")] = 0.08
    primitives: bool = False  # tries the motions of an operator first, and samples around the best of them
    # plans said to reach the target, a search, that the environment's own time stepping has to confirm; 0: none
    confirm: Annotated[int, Interval(ge=0, le=1000)] = 0
    # decisions without progress after which a manoeuvre, or a retreat, leaves the local minimum; 0: never
    patience: Annotated[int, Interval(ge=0, le=10_000)] = 0

    def __post_init__(self) -> None:
        if self.elites > self.samples:
            raise ValueError(f"elites must lie in 1 to samples ({self.samples}), got {self.elites}")
        if self.hold > self.horizon or self.execute > self.horizon:
            raise ValueError(f"hold and execute must lie in 1 to the horizon ({self.horizon})")


TWO_DEVICES = ExpertSettings(samples=32, elites=6, primitives=True, confirm=4, patience=4, most_force=2.0)
