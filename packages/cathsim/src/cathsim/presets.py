"""Numerical presets: how finely the physics is stepped."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Accuracy:
    """Time stepping of a simulation.

    Attributes:
        timestep: of a substep, s.
        refinement: a substep that ends with the wire deep in the wall is repeated in so many shorter ones; 1: never.
        tolerance: penetration that calls for it, m.
        rise: ... if the penetration also grew by this much in the substep, m.
        mass_scale: factor on the wire's mass.
    """

    timestep: float
    refinement: int
    tolerance: float = 3e-4
    rise: float = 1e-4
    mass_scale: float = 1.0


# The motion is quasi-static, so more than the wire's mass changes forces little and keeps contacts stiff at long steps.
ACCURACY: dict[str, Accuracy] = {
    "reference": Accuracy(timestep=0.001, refinement=4),
    "accurate": Accuracy(timestep=0.010, refinement=8, tolerance=2e-4, rise=5e-5, mass_scale=10.0),
    "fast": Accuracy(timestep=0.020, refinement=4, tolerance=5e-4, rise=3e-4, mass_scale=30.0),
}


def accuracy(name: str) -> Accuracy:
    """The preset of that name.

    Raises:
        ValueError: there is none.
    """
    if name not in ACCURACY:
        raise ValueError(f"unknown accuracy '{name}'; there are {', '.join(ACCURACY)}")
    return ACCURACY[name]
