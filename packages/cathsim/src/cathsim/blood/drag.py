"""Drag of the blood on a wire: the resistance of a thin cylinder across and along its axis."""

from __future__ import annotations

import ctypes
import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cathsim.contact.native import DragStruct, address, library

if TYPE_CHECKING:
    from cathsim.blood.field import BloodField
    from cathsim.guidewire import Guidewire

Array = NDArray[np.float64]

LINK_PART = 8e-3  # m: longer links are cut for the drag


class Drag:
    """Drag of the blood on a wire: a cylinder's resistance across and along its axis.

    Across, for each metre, with the relative velocity u and the wire's diameter d, length L and radius a:
    4 pi mu / (ln(L/a) + 0.193) u, the slender body's at low Reynolds number, plus Taylor's
    1/2 rho d (u + 4 sqrt(nu/d) sqrt(u)) u. Along: 2 pi mu / (ln(L/a) - 0.807) v plus Taylor's
    1/2 rho d 5.4 sqrt(nu/d) sqrt(u) v, the boundary layer of the flow across. Across, the sum lies within
    5 % of White's fit of measurements, 1 + 10 Re^(-2/3), from Re = 60 to 1000, and up to 22 % below it down to Re = 1.

    Source: Cox (1970), Journal of Fluid Mechanics 44, 791-810 (slender body); Taylor (1952), Proceedings of the Royal
        Society A 214, 158-183 (oblique cylinder, Re 20 to 10^5); White (2006), Viscous Fluid Flow (fit).
    """

    def __init__(self, field: BloodField, wire: Guidewire) -> None:
        self.field = field  # the struct points into its arrays
        density, viscosity, diameter = field.flow.density, field.flow.viscosity, wire.diameter
        slenderness = max(math.log(wire.length / wire.radius), 1.0)
        layer = math.sqrt(viscosity / density / diameter)
        self.struct = DragStruct(
            blood=ctypes.addressof(field.struct),
            across_viscous=4 * math.pi * viscosity / (slenderness + 0.193),
            along_viscous=2 * math.pi * viscosity / (slenderness - 0.807),
            across_layer=0.5 * density * diameter * 4.0 * layer,
            along_layer=0.5 * density * diameter * 5.4 * layer,
            across_inertial=0.5 * density * diameter,
            spacing=LINK_PART,
        )

    @property
    def address(self) -> int:
        """Of the native struct; valid as long as this object."""
        return ctypes.addressof(self.struct)

    def force(self, velocity: ArrayLike, axis: ArrayLike, *, most: float = math.inf) -> Array:
        """Force (3,) N/m on a metre of the wire.

        Args:
            velocity: of the blood relative to the wire, m/s. Shape (3,).
            axis: unit vector along the wire. Shape (3,).
            most: largest coefficient of the velocity, N s/m^2; in a simulation it is the mass of a metre over a
                substep, beyond which an explicit step would throw the wire back.
        """
        relative, direction = (np.ascontiguousarray(one, dtype=np.float64) for one in (velocity, axis))
        if relative.shape != (3,) or direction.shape != (3,):
            raise ValueError(f"velocity and axis must have shape (3,), got {relative.shape} and {direction.shape}")
        force = np.empty(3)
        library().cathsim_blood_cylinder(
            ctypes.byref(self.struct), address(direction), address(relative), ctypes.c_double(most), address(force)
        )
        return force
