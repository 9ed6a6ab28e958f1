"""A compliant wall: its stiffness in N/mm, which timesteps resolve it, and the contact parameters that make it so."""

from __future__ import annotations

from typing import Annotated

import mujoco
from annotated_types import Interval

from cathsim.guidewire import LINK_NAME
from cathsim.presets import Accuracy
from cathsim.validation import Unit, quantity

N_PER_MM = 1000.0  # one N/mm in N/m
# N s/m: a stiffer wall chatters at the timestep; below, forces at rest are stiffness times depth within 1 % (median).
MOST_WALL_IMPULSE = 10.0
_IMPEDANCE = 0.9  # of a contact until the native step knows better

_WallStiffness = Annotated[float, Interval(ge=0.1, le=100), Unit("N/mm")]


def stiffest_wall(numerics: Accuracy) -> float:
    """The largest `wall_stiffness` (N/mm) that a timestep resolves."""
    return MOST_WALL_IMPULSE / numerics.timestep / N_PER_MM


def checked_wall_stiffness(stiffness: float, numerics: Accuracy) -> float:
    """Returns a wall's stiffness, N/mm.

    Raises:
        ValueError: it lies outside its range, or the timestep is too long for it.
    """
    checked = float(quantity("wall_stiffness", stiffness, _WallStiffness))
    if checked > stiffest_wall(numerics) * (1 + 1e-9):
        raise ValueError(
            f"a timestep of {numerics.timestep:g} s resolves walls of at most {stiffest_wall(numerics):g} N/mm, got "
            f"wall_stiffness {checked:g}: take accuracy='reference', or an Accuracy with a timestep of at most "
            f"{MOST_WALL_IMPULSE / checked / N_PER_MM:g} s"
        )
    return checked


def soften_contacts(model: mujoco.MjModel, links: int) -> None:
    """Gives a wire's contacts with the wall a reference acceleration of r / h^2 + v / h, h being the timestep.

    A spring with that reference is integrated by the implicit Euler method; its stiffness is a matter of the contact's
    regularisation, see step.c.
    """
    first, step = model.geom(LINK_NAME.format(0)).id, model.opt.timestep
    model.geom_solref[first : first + links] = -_IMPEDANCE / step**2, -_IMPEDANCE / step
    model.geom_solimp[first : first + links, :2] = _IMPEDANCE
