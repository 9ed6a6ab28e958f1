"""What is not known when forces are read from a shape: the ensemble of cases for it, and the simulation of a case."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, TypeVar

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray
from scipy.special import ndtri

from cathsim.anatomy import Phantom, SignedDistanceGrid
from cathsim.devices.catheter import Catheter
from cathsim.devices.pair import DevicePair
from cathsim.devices.simulation import DualSimulation
from cathsim.guidewire import Guidewire
from cathsim.lifetime_cache import kept_with_owner
from cathsim.presets import Accuracy
from cathsim.simulation import Simulation
from cathsim.validation import Unit, settings

_Length = Annotated[float, Interval(ge=0, le=0.05), Unit("m")]
_Relative = Annotated[float, Interval(ge=0, le=1)]
_LUMENS = 4  # different lumens in an ensemble: each has a distance grid of its own
# The devices of one's own may slide more easily; friction this high keeps the device at the observed shape.
LEAST_FRICTION = 0.1
Device = TypeVar("Device", Guidewire, Catheter)


@settings
class Uncertainty:
    """Standard deviations of what is not known; all independent of each other and normal.

    Attributes:
        stiffness: of the logarithm of the device's bending stiffness.
        insertion: of the feeder's position, m.
        rotation: of the feeder's angle, rad.
        registration: of the lumen's place along each axis, m, the sheath and the curve staying where they are.
        lumen: of the lumen's radius, m.
        friction: of the logarithm of the friction coefficient.
        curve: of the curve's points along each axis, m; the error is smooth over `curve_width`.
        curve_width: m along the curve.
    """

    stiffness: _Relative = 0.1
    insertion: _Length = 1.0e-3
    rotation: Annotated[float, Interval(ge=0, le=3.2), Unit("rad")] = 0.2
    registration: _Length = 0.5e-3
    lumen: _Length = 0.2e-3
    friction: _Relative = 0.4
    curve: _Length = 0.5e-3
    curve_width: Annotated[float, Interval(ge=1e-3, le=0.1), Unit("m")] = 0.010


@dataclass(frozen=True)
class Deviation:
    """How one member of an ensemble differs from the nominal case."""

    stiffness: float = 1.0  # factor
    insertion: float = 0.0  # m
    rotation: float = 0.0  # rad
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)  # of the lumen, m
    lumen: float = 0.0  # added to the radius, m
    friction: float = 1.0  # factor
    curve_seed: int | None = None  # of the noise added to the curve; None: none


def deviations(count: int, uncertainty: Uncertainty, seed: int) -> list[Deviation]:
    """An ensemble: the nominal case, then cases stratified in every quantity (Latin hypercube).

    Args:
        count: of members, 1 or more.

    Returns:
        The same for the same arguments.
    """
    generator = np.random.default_rng(seed)
    strata = np.arange(count - 1)
    unit = np.empty((count - 1, 7))
    for column in range(7):
        unit[:, column] = ndtri((generator.permutation(strata) + 0.5) / max(count - 1, 1))
    levels = ndtri((np.arange(_LUMENS) + 0.5) / _LUMENS)
    levels /= levels.std()
    few = levels[np.floor((generator.permutation(strata) + 0.5) / max(count - 1, 1) * _LUMENS).astype(int)]
    members = [Deviation()]
    for z, lumen in zip(unit, few, strict=True):
        x, y, depth = (uncertainty.registration * float(value) for value in z[3:6])
        members.append(
            Deviation(
                stiffness=float(np.exp(uncertainty.stiffness * z[0])),
                insertion=uncertainty.insertion * float(z[1]),
                rotation=uncertainty.rotation * float(z[2]),
                shift=(x, y, depth),
                lumen=uncertainty.lumen * float(lumen),
                friction=float(np.exp(uncertainty.friction * z[6])),
                curve_seed=int(generator.integers(2**31)),
            )
        )
    return members


def smooth_noise(count: int, step: float, width: float, generator: np.random.Generator) -> NDArray[np.float64]:
    """Noise of deviation 1 along each axis, smooth over a width (m), at points `step` (m) apart. Shape (count, 3)."""
    from scipy.ndimage import gaussian_filter1d

    deviation = width / step
    reach = int(np.ceil(4 * deviation))
    white = generator.standard_normal((count + 2 * reach, 3))
    noise: NDArray[np.float64] = gaussian_filter1d(white, deviation, axis=0)[reach : reach + count]
    return noise * np.sqrt(2 * np.sqrt(np.pi) * deviation)


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
