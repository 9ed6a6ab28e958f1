"""The simulation of one case: a device in a vessel, with the deviations of a member of an ensemble."""

from __future__ import annotations

import dataclasses
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

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
    if isinstance(device, DevicePair):
        pair = dataclasses.replace(
            device,
            wire=None if device.wire is None else _deviating_device(device.wire, friction, deviation),
            catheter=None if device.catheter is None else _deviating_device(device.catheter, friction, deviation),
        )
        return DualSimulation(vessel, pair, numerics, entry=entry)
    if not isinstance(device, Guidewire):
        raise ValueError(f"device must be a Guidewire or a DevicePair, got {type(device).__name__}")
    return Simulation(vessel, _deviating_device(device, friction, deviation), numerics, entry=entry)


def _deviating_device(device: Device, friction: float | None, deviation: Deviation) -> Device:
    """A device of another stiffness and friction."""
    nominal = max(device.friction, LEAST_FRICTION) if friction is None else friction
    return dataclasses.replace(
        device,
        shaft_stiffness_nmm2=device.shaft_stiffness_nmm2 * deviation.stiffness,
        tip_stiffness_nmm2=device.tip_stiffness_nmm2 * deviation.stiffness,
        friction=nominal * deviation.friction,
    )


def deviating_phantom(phantom: Phantom, deviation: Deviation) -> Phantom:
    """The phantom with its lumen shifted and widened; its entries stay where they are.

    The widened grid is kept as long as the phantom's, for further members of the same lumen.
    """
    if deviation.lumen == 0 and not any(deviation.shift):
        return phantom
    values = _widened(phantom.grid, deviation.lumen) if deviation.lumen else phantom.grid.values
    return with_lumen(phantom, values, deviation.shift)


def with_lumen(phantom: Phantom, values: NDArray[np.float32], shift: tuple[float, float, float]) -> Phantom:
    """The phantom with other distances to the wall (m) on its lattice, which is shifted (m); its entries stay."""
    grid = SignedDistanceGrid(values, phantom.grid.origin + np.array(shift), phantom.grid.spacing)
    return Phantom(phantom.name, phantom.hash, None, phantom.tree, grid, phantom.targets, phantom.entries)


@kept_with_owner
def _widened(grid: SignedDistanceGrid, lumen: float) -> NDArray[np.float32]:
    return grid.values + np.float32(lumen)
