"""The simulation of one case: a device in a vessel, with the deviations of a member of an ensemble."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy import Phantom, SignedDistanceGrid
from cathsim.guidewire import Guidewire
from cathsim.lifetime_cache import kept_with_owner
from cathsim.presets import Accuracy
from cathsim.simulation import Simulation
from cathsim.statics.uncertainty import Deviation

# The devices of one's own may slide more easily; friction this high keeps the device at the observed shape.
LEAST_FRICTION = 0.1


def simulated_device(
    phantom: Phantom, device: Guidewire, numerics: Accuracy, entry: str, friction: float | None, deviation: Deviation
) -> Simulation:
    """Builds the simulation of a case.

    Args:
        friction: nominal coefficient; None: the device's, or `LEAST_FRICTION` where that is more.

    Raises:
        ValueError: something else than a guidewire, or no such entry.
    """
    if not isinstance(device, Guidewire):
        raise ValueError(f"device must be a Guidewire, got {type(device).__name__}")
    nominal = max(device.friction, LEAST_FRICTION) if friction is None else friction
    wire = dataclasses.replace(
        device,
        shaft_stiffness_nmm2=device.shaft_stiffness_nmm2 * deviation.stiffness,
        tip_stiffness_nmm2=device.tip_stiffness_nmm2 * deviation.stiffness,
        friction=nominal * deviation.friction,
    )
    return Simulation(deviating_phantom(phantom, deviation), wire, numerics, entry=entry)


def deviating_phantom(phantom: Phantom, deviation: Deviation) -> Phantom:
    """The phantom with its lumen shifted and widened; its entries stay where they are."""
    if deviation.lumen == 0 and not any(deviation.shift):
        return phantom
    grid = phantom.grid
    values = _widened(grid, deviation.lumen) if deviation.lumen else grid.values
    moved = SignedDistanceGrid(values, grid.origin + np.array(deviation.shift), grid.spacing)
    return Phantom(phantom.name, phantom.hash, None, phantom.tree, moved, phantom.targets, phantom.entries)


@kept_with_owner
def _widened(grid: SignedDistanceGrid, lumen: float) -> NDArray[np.float32]:
    return grid.values + np.float32(lumen)
