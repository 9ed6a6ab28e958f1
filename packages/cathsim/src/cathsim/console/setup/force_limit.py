"""The force limit that the operator chooses: steps beyond it are warned of and counted, or end the procedure."""

from __future__ import annotations

from typing import Annotated

from annotated_types import Interval

from cathsim.metrics import FORCE_LIMIT
from cathsim.validation import Unit, settings

Newtons = Annotated[float, Interval(gt=0, le=100), Unit("N")]


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
