"""The devices of an environment: found from names, files or descriptions, and simulated."""

from __future__ import annotations

from typing import Any, get_args

from cathsim.anatomy import Phantom
from cathsim.blood.flow import FLOWS, BloodFlow
from cathsim.contact.breathing import Breathing
from cathsim.contact.hulls import Decomposition, decomposition
from cathsim.devices.catheter import Catheter
from cathsim.devices.pair import DevicePair, Torsion
from cathsim.devices.shelf import load_catheter
from cathsim.devices.simulation import DualSimulation
from cathsim.guidewire import Guidewire, load_guidewire
from cathsim.presets import ACCURACY, PACES, Accuracy, Pace
from cathsim.registration.description import resolve_argument
from cathsim.simulation import Simulation

TORSIONS: tuple[str, ...] = get_args(Torsion)


def resolve_wire(wire: Any) -> Guidewire | None:
    """A wire from a preset's name, the path of a YAML file, a `Guidewire` or its description; None: no wire."""
    return None if wire is None else resolve_argument("wire", wire, Guidewire, load_guidewire)


def resolve_catheter(catheter: Any) -> Catheter | None:
    """A catheter from a preset's name, the path of a YAML file, a `Catheter` or its description; None: no catheter."""
    return None if catheter is None else resolve_argument("catheter", catheter, Catheter, load_catheter)


def device_pair(wire: Guidewire | None, catheter: Catheter | None, torsion: str = "elastic") -> DevicePair | None:
    """The devices as a pair; None: a bare wire, which needs none.

    Raises:
        ValueError: neither device, devices that do not fit, or an unknown torsion.
    """
    if torsion not in TORSIONS:
        raise ValueError(f"unknown torsion '{torsion}'; there are {', '.join(TORSIONS)}")
    if catheter is None and wire is not None:
        return None
    return DevicePair(wire, catheter, torsion)  # type: ignore[arg-type]


def simulation_of(
    phantom: Phantom,
    wire: Any,
    catheter: Any,
    accuracy: Any,
    *,
    torsion: str = "elastic",
    contact: Any = "sdf",
    blood: Any = None,
    pace: Any = "usual",
    breathing: Any = None,
    **arguments: Any,
) -> Simulation:
    """The simulation of a bare wire, of a wire in a catheter, or of a catheter alone.

    Args:
        wire, catheter, accuracy, contact, blood, pace, breathing: names, objects or their descriptions, as of
            `NavigateEnv`.
        torsion: of devices with a catheter, "elastic" or "rigid"; the bare wire's is rigid.
        arguments: of `Simulation`.

    Raises:
        ValueError: an argument is none of these, neither device, devices that do not fit, or an unknown torsion.
    """
    guidewire, outer = resolve_wire(wire), resolve_catheter(catheter)
    numerics = resolve_argument("accuracy", accuracy, Accuracy, ACCURACY)
    if not isinstance(contact, str):
        contact = resolve_argument("contact", contact, Decomposition, decomposition)
    arguments |= {
        "contact": contact,
        "blood": None if blood is None else resolve_argument("blood", blood, BloodFlow, FLOWS),
        "pace": resolve_argument("pace", pace, Pace, PACES),
        "breathing": None if breathing is None else resolve_argument("breathing", breathing, Breathing),
    }
    pair = device_pair(guidewire, outer, torsion)
    if pair is not None:
        return DualSimulation(phantom, pair, numerics, **arguments)
    assert guidewire is not None
    return Simulation(phantom, guidewire, numerics, **arguments)
