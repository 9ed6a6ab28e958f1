"""The simulation of one case: a device in a vessel, with the deviations of a member of an ensemble."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import TypeVar

from cathsim.anatomy import Phantom, SignedDistanceGrid
from cathsim.devices.catheter import Catheter
from cathsim.devices.pair import DevicePair
from cathsim.devices.simulation import DualSimulation
from cathsim.guidewire import Guidewire
from cathsim.lifetime_cache import kept_with_owner
from cathsim.presets import Accuracy
from cathsim.simulation import Simulation
from cathsim.statics.uncertainty import Deviation

# The devices of one's own may slide more easily; friction this high keeps the device at the observed shape.
LEAST_FRICTION = 0.1

Device = TypeVar("Device", Guidewire, Catheter)


def simulated_device(
    phantom: Phantom,
    device: Guidewire | DevicePair,
    numerics: Accuracy,
    entry: str,
    friction: float | None,
    deviation: Deviation,
) -> Simulation:
    """Builds the simulation of a case.

    Args:
        device: of a pair, both devices deviate alike.
        friction: nominal coefficient; None: the device's, or `LEAST_FRICTION` where that is more.

    Raises:
        ValueError: something else than a guidewire or a pair, or no such entry.
    """
    vessel = deviating_phantom(phantom, deviation)
    if not isinstance(device, Guidewire | DevicePair):
        raise ValueError(f"device must be a Guidewire or a DevicePair, got {type(device).__name__}")
    case = changed_device(
        device,
        deviation.stiffness,
        lambda own: (max(own, LEAST_FRICTION) if friction is None else friction) * deviation.friction,
    )
    if isinstance(case, DevicePair):
        return DualSimulation(vessel, case, numerics, entry=entry)
    return Simulation(vessel, case, numerics, entry=entry)


def changed_device(
    device: Guidewire | DevicePair, stiffness: float, friction: Callable[[float], float] = float
) -> Guidewire | DevicePair:
    """A wire, or both devices of a pair, with the bending stiffness multiplied and the friction coefficient mapped."""
    if isinstance(device, Guidewire):
        return _changed(device, stiffness, friction)
    return dataclasses.replace(
        device,
        wire=None if device.wire is None else _changed(device.wire, stiffness, friction),
        catheter=None if device.catheter is None else _changed(device.catheter, stiffness, friction),
    )


def _changed(device: Device, stiffness: float, friction: Callable[[float], float]) -> Device:
    return dataclasses.replace(
        device,
        shaft_stiffness_nmm2=device.shaft_stiffness_nmm2 * stiffness,
        tip_stiffness_nmm2=device.tip_stiffness_nmm2 * stiffness,
        friction=friction(device.friction),
    )


def deviating_phantom(phantom: Phantom, deviation: Deviation) -> Phantom:
    """The phantom with its lumen shifted and widened; its entries stay where they are.

    The widened grid is kept as long as the phantom's, for further members of the same lumen.
    """
    if deviation.lumen == 0 and not any(deviation.shift):
        return phantom
    grid = _widened(phantom.grid, deviation.lumen) if deviation.lumen else phantom.grid
    return with_lumen(phantom, grid.moved(deviation.shift))


def with_lumen(phantom: Phantom, grid: SignedDistanceGrid) -> Phantom:
    """The phantom with other distances to the wall; its entries stay."""
    return Phantom(phantom.name, phantom.hash, None, phantom.tree, grid, phantom.targets, phantom.entries)


@kept_with_owner
def _widened(grid: SignedDistanceGrid, lumen: float) -> SignedDistanceGrid:
    return grid.offset(lumen)
