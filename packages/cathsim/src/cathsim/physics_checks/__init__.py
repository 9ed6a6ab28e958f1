"""The simulated wire against the theory of rods: elastica, Euler buckling, capstan, helix in a tube.

Every case runs the package's own wire, contact code and integrator. Sources: Timoshenko and Gere, Theory of Elastic
Stability (elastica, columns); the capstan equation; Lubinski, Althouse and Logan 1962 (helix).
"""

from __future__ import annotations

from collections.abc import Callable

from cathsim.physics_checks.contact import capstan_cases, helix_cases
from cathsim.physics_checks.rig import TheoryCheck
from cathsim.physics_checks.statics import buckling_cases, elastica_cases

LAWS: dict[str, Callable[[bool], list[TheoryCheck]]] = {
    "elastica": lambda quick: elastica_cases(),
    "buckling": lambda quick: buckling_cases(),
    "capstan": capstan_cases,
    "helix": helix_cases,
}
AIM_PCT = {"elastica": 1.0, "buckling": 3.0, "capstan": 5.0, "helix": 10.0}


def worst_error_pct(cases: list[TheoryCheck]) -> float:
    """The largest error of any case, without its sign, %."""
    return round(max(abs(case.error_pct) for case in cases), 3)


__all__ = ["AIM_PCT", "LAWS", "TheoryCheck", "worst_error_pct"]
