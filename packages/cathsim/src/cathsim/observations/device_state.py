"""What is known of the devices outside the patient: insertions, rotations, forces and torques at the hubs."""

from __future__ import annotations

import numpy as np

from cathsim.devices.simulation import DualSimulation
from cathsim.simulation import Simulation

DEVICES_SHAPE = (2, 5)


def feeder_size(simulation: Simulation) -> int:
    """How many numbers `feeder` gives."""
    return 7 if isinstance(simulation, DualSimulation) and simulation.pair.both else 3


def feeder(simulation: Simulation) -> np.ndarray:
    """Insertion (m), cosine and sine of the rotation of the hub; of two devices, wire first, then the lead (m).

    Returns:
        Shape (3,), with two devices (7,), float32.
    """
    rotation = simulation.rotation
    wire = (simulation.insertion, np.cos(rotation), np.sin(rotation))
    if not (isinstance(simulation, DualSimulation) and simulation.pair.both):
        return np.array(wire, np.float32)
    inserted, turned = simulation.catheter_place()
    catheter = (inserted, np.cos(turned), np.sin(turned))
    return np.array((*wire, *catheter, simulation.device_lead), np.float32)


def devices(simulation: DualSimulation) -> np.ndarray:
    """Insertion (m), angles of hub and tip (rad), force of the feeder (N) and torque at the hub (N m) of each device.

    Returns:
        Shape (2, 5), float32, the wire's row first; zeros of an absent device.
    """
    rows = np.array(
        (
            simulation.device_insertions(),
            simulation.device_rotations(),
            simulation.tip_rotations(),
            simulation.feeder_forces(),
            simulation.hub_torques(),
        )
    ).T
    present = [simulation.pair.wire is not None, simulation.pair.catheter is not None]
    return np.where(np.array(present)[:, None], rows, 0.0).astype(np.float32)


def with_catheter(simulation: Simulation) -> DualSimulation:
    """The simulation as one with a catheter.

    Raises:
        ValueError: it is one of a bare wire.
    """
    if not isinstance(simulation, DualSimulation):
        raise ValueError("observation 'devices' needs a catheter: pass catheter='vertebral' or another")
    return simulation
