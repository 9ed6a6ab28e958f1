"""The composite rod of a wire in a catheter: tables of both devices, and the native struct that rewrites a chain."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from cathsim.contact.native import library
from cathsim.devices.arena import ROTATE
from cathsim.devices.catheter import Catheter
from cathsim.devices.pair import DevicePair
from cathsim.guidewire import LINK_NAME, Guidewire
from cathsim.presets import Accuracy

Array = NDArray[np.float64]
Device = Guidewire | Catheter

WIRE, CATHETER, DEVICES = 0, 1, 2
_AT_REST = 1e-10  # rad: change of the twist in an iteration at which it rests
SPACING = 0.5e-3  # between nodes of a device's tables, m
_SMOOTHING = 1.0e-3  # of the unloaded curvature, to both sides, m
_CELL_NUMBERS = 10  # of struct Cell

_pointer, _number, _whole = ctypes.c_void_p, ctypes.c_double, ctypes.c_int


class DeviceStruct(ctypes.Structure):
    """A device (struct Device of rod.h)."""

    _fields_ = (
        ("count", _whole),
        ("spacing", _number),
        *((name, _pointer) for name in ("bending", "torsion", "curvature")),
        *((name, _number) for name in ("length", "radius", "friction", "mass", "relaxation")),
    )


class RodStruct(ctypes.Structure):
    """A composite rod (struct Rod of rod.h)."""

    _fields_ = (
        ("model", _pointer),
        ("device", _pointer * DEVICES),
        *(
            (name, _whole)
            for name in ("joints", "links", "first_joint", "first_geom", "first_body", "rotation", "rigid")
        ),
        *((name, _pointer) for name in ("from_end", "before", "after", "lengths", "inverse_weight", "cells")),
        ("twist", _pointer * DEVICES),
        ("workspace", _pointer),
        ("lead_from", _number),
        ("lead_to", _number),
        ("hub_from", _number * DEVICES),
        ("hub_to", _number * DEVICES),
        ("lead", _number),
        ("hub", _number * DEVICES),
        ("shown", _number),
        ("feeder_force", _number * DEVICES),
        ("hub_torque", _number * DEVICES),
    )


class DeviceTable:
    """A device sampled along its length, for the native code."""

    def __init__(self, device: Device, *, mass_scale: float = 1.0) -> None:
        if isinstance(device, Guidewire):
            end, length, diameter = max(device.taper[1], device.tip_length), device.working_length, device.diameter
        else:
            bends = [bend[1] for bend in device.shape]
            end, length, diameter = max(device.taper[1], *bends, 0.0), device.length, device.outer_diameter
        at = SPACING * np.arange(math.ceil((end + _SMOOTHING) / SPACING - 1e-9) + 2, dtype=np.float64)
        # a mean over some distance: a wire's bend ends in a step, which no sum of samples could integrate
        fine = at[:, None] + _SMOOTHING * (np.arange(-19.5, 20) / 20)[None, :]
        curvature = device.rest_curvature(np.abs(fine)).mean(axis=1)
        self.bending = np.ascontiguousarray(device.stiffness(at), np.float64)
        self.torsion = np.ascontiguousarray(device.torsional_stiffness(at), np.float64)
        self.curvature = np.ascontiguousarray(np.stack((curvature.real, curvature.imag), axis=1))
        self.linear_density = device.density * math.pi / 4 * diameter**2  # kg/m
        self.struct = DeviceStruct(
            count=len(at),
            spacing=SPACING,
            bending=self.bending.ctypes.data,
            torsion=self.torsion.ctypes.data,
            curvature=self.curvature.ctypes.data,
            length=length,
            radius=diameter / 2,
            friction=device.friction,
            mass=self.linear_density * mass_scale,
            relaxation=device.relaxation,
        )


def device_tables(pair: DevicePair, numerics: Accuracy | None = None) -> tuple[DeviceTable | None, DeviceTable | None]:
    """Tables of wire and catheter, None of an absent one; their mass is scaled as the time stepping has it."""
    scale = numerics.mass_scale if numerics else 1.0
    wire, catheter = (DeviceTable(one, mass_scale=scale) if one else None for one in (pair.wire, pair.catheter))
    return wire, catheter


class Rod:
    """Rewrites a chain's model as one device slides and turns along the other.

    The joint between two half links has the stiffness 1 / integral(ds / EI) with EI = EI_wire + EI_catheter where both
    are, and the rest angle integral((EI_wire kappa_wire + EI_catheter kappa_catheter) / EI ds), so that both change
    continuously with the lead. Twist of each device along the chain is balanced between its torsion and the bending
    energy. What two hinges in a row turn a link about its own axis is taken into account.

    Args:
        model: of the chain, used by nobody else; it must live as long as this object.
        tables: of wire and catheter; None: absent.
        lengths: of the chain's links from the proximal end, m.
        inverse_weight: `body_invweight0` of the links of a bare and of a covered chain. Shape (2, links, 2).
        twist: array for the twist of both devices at each joint, rad, which the caller owns. Shape (2, joints).
        rigid: the devices do not twist.
        clamped: the first link is held by a joint of its own.
        chain: what the names of the chain's parts begin with in the model.
        rotation: name of the joint that turns the whole chain.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        tables: tuple[DeviceTable | None, DeviceTable | None],
        lengths: Sequence[float],
        inverse_weight: Array,
        twist: Array,
        *,
        rigid: bool,
        clamped: bool = False,
        chain: str = "",
        rotation: str = ROTATE,
    ) -> None:
        links = np.array(lengths, np.float64)
        halves = links / 2
        first = 0 if clamped else 1
        from_end = np.cumsum(links[::-1])[::-1][first:].copy()
        before = np.concatenate(([0.0], halves[:-1]))[first:].copy()
        after = halves[first:].copy()
        joints = len(from_end)
        cells, workspace = np.zeros((joints, _CELL_NUMBERS)), np.zeros((8, joints))
        weight = np.ascontiguousarray(inverse_weight, np.float64)
        if twist.shape != (DEVICES, joints) or weight.shape != (2, len(links), 2):
            raise ValueError(
                f"a chain of {joints} joints needs twist of shape (2, {joints}) and weights of (2, {len(links)}, 2), "
                f"got {twist.shape} and {weight.shape}"
            )
        self._references = (model, tables, links, from_end, before, after, cells, workspace, weight, twist)
        geom = model.geom(chain + LINK_NAME.format(0)).id
        self.struct = RodStruct(
            model=model._address,
            device=(ctypes.c_void_p * DEVICES)(*(ctypes.addressof(one.struct) if one else None for one in tables)),
            joints=joints,
            links=len(links),
            first_joint=model.joint(f"{chain}{LINK_NAME.format(first)}x").id,
            first_geom=geom,
            first_body=int(model.geom_bodyid[geom]),
            rotation=-1 if clamped else int(model.jnt_qposadr[model.joint(rotation).id]),
            rigid=int(rigid),
            from_end=from_end.ctypes.data,
            before=before.ctypes.data,
            after=after.ctypes.data,
            lengths=links.ctypes.data,
            inverse_weight=weight.ctypes.data,
            cells=cells.ctypes.data,
            twist=(ctypes.c_void_p * DEVICES)(*(row.ctypes.data for row in twist)),
            workspace=workspace.ctypes.data,
            shown=math.nan,
        )

    @property
    def address(self) -> int:
        """Of the native struct; valid as long as this object."""
        return ctypes.addressof(self.struct)

    def place(self, lead: float, angles: Sequence[float]) -> None:
        """Sets how far the wire is ahead (m) and both hubs' angles (rad), at once."""
        self.move(lead, lead, angles, angles)
        self.struct.lead = lead
        self.struct.hub[:] = angles

    def move(self, lead_from: float, lead_to: float, from_: Sequence[float], to: Sequence[float]) -> None:
        """Sets leads (m) and hub angles (rad) at the begin and the end of the next control step."""
        struct = self.struct
        struct.lead_from, struct.lead_to = lead_from, lead_to
        struct.hub_from[:], struct.hub_to[:] = from_, to

    def update(self, data: mujoco.MjData, share: float = 1.0) -> None:
        """Brings the model to a share (0 to 1) of the control step's movement, for the bends of `data`."""
        library().rod_update(ctypes.byref(self.struct), ctypes.c_void_p(data._address), ctypes.c_double(share))

    def untwist(self, data: mujoco.MjData, *, most: int = 10_000) -> int:
        """Lets the devices' twist come to rest at fixed bends; returns the number of iterations."""
        return int(
            library().rod_untwist(
                ctypes.byref(self.struct), ctypes.c_void_p(data._address), most, ctypes.c_double(_AT_REST)
            )
        )

    def energy(self, data: mujoco.MjData, lead: float) -> float:
        """Energy of bending, N m, at another lead (m), bends and twists as they are."""
        energy = library().rod_energy
        energy.restype = ctypes.c_double
        return float(energy(ctypes.byref(self.struct), ctypes.c_void_p(data._address), ctypes.c_double(lead)))


def twin(model: mujoco.MjModel, timestep: float) -> ctypes.Array[ctypes.c_char]:
    """A structure with the arrays of a model and a timestep (s) of its own; it must not outlive the model."""
    buffer = ctypes.create_string_buffer(library().cathsim_model_size())
    library().cathsim_model_twin(ctypes.c_void_p(model._address), ctypes.c_double(timestep), buffer)
    return buffer
