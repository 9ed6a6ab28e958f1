"""Oscillating flow in a straight round tube: the heartbeat's flow waveform and the Womersley velocity profile."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

HARMONICS = 16  # of the heartbeat that are kept
SYSTOLE = 0.33  # share of the beat in which the ventricle ejects
BACKFLOW, CLOSURE = 0.08, 0.07  # share of the peak flow that runs back while the valve closes; that part of the beat
_QUASI_STEADY = 1e-3  # Womersley number below which the profile is the parabola to machine precision

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


def ejection(phase: ArrayLike) -> Array:
    """Flow out of the left ventricle over its peak: a steep rise, a slower fall, a short backflow, rest.

    The shape is an idealisation of aortic flow curves, not a measured one.

    Args:
        phase: (...,) of the heartbeat; 0 is the opening of the aortic valve, 1 the next one.
    """
    phase = np.mod(np.asarray(phase, dtype=np.float64), 1.0)
    forward = np.sin(np.pi * np.clip(phase / SYSTOLE, 0.0, 1.0) ** 0.8) ** 2
    back = np.sin(np.pi * np.clip((phase - SYSTOLE) / CLOSURE, 0.0, 1.0)) ** 2
    return forward - BACKFLOW * back


def heartbeat_coefficients() -> ComplexArray:
    """Fourier coefficients (n + 1,) of `ejection`, the mean first: flow = Re(sum of c_k exp(2 pi i k phase))."""
    samples = 1024
    spectrum = np.fft.rfft(ejection(np.arange(samples) / samples)) / samples
    coefficients = spectrum[: HARMONICS + 1].copy()
    coefficients[1:] *= 2.0
    return coefficients


def womersley_number(
    radius: ArrayLike, frequency: float, *, density: float = 1060.0, viscosity: float = 0.004
) -> Array:
    """Radius (...,) m over the thickness of the oscillating boundary layer, R sqrt(omega rho / mu).

    Args:
        frequency: Hz.
        density: kg/m^3.
        viscosity: Pa s.

    Source: Womersley (1955), Journal of Physiology 127, 553-563.
    """
    return np.asarray(radius, dtype=np.float64) * np.sqrt(2 * np.pi * frequency * density / viscosity)


def velocity_profile(alpha: float, squared_radius: ArrayLike) -> ComplexArray:
    """Complex amplitude (n,) of the axial velocity in a tube whose mean velocity oscillates with amplitude 1.

    Args:
        alpha: Womersley number; 0 gives the parabola of Poiseuille.
        squared_radius: (n,) square of the distance from the axis over the tube's radius, 0 to 1.

    Raises:
        ValueError: for a negative Womersley number.

    Source: Womersley (1955), written for a given flow rate instead of a given pressure gradient.
    """
    squared_radius = np.asarray(squared_radius, dtype=np.float64)
    if not alpha >= 0:
        raise ValueError(f"the Womersley number must not be negative, got {alpha}")
    if alpha < _QUASI_STEADY:
        return (2.0 * (1.0 - squared_radius)).astype(np.complex128)
    from scipy.special import jve  # scaled by exp(-|Im z|): J itself overflows from alpha = 1000 on

    wave = alpha * np.exp(0.75j * np.pi)
    at = wave * np.sqrt(squared_radius)
    ratio = jve(0, at) / jve(0, wave) * np.exp(np.abs(at.imag) - abs(wave.imag))
    return (1.0 - ratio) / (1.0 - 2.0 * jve(1, wave) / (wave * jve(0, wave)))


def profile_table(
    radii: ArrayLike, phases: int, columns: int, *, frequency: float, density: float, viscosity: float, womersley: bool
) -> Array:
    """Velocity in tubes of several radii that carry the flow of a heartbeat with peak 1.

    Args:
        radii: (m,) m.
        phases: moments of the beat, equally spaced from 0.
        columns: points from axis to wall, equally spaced in the squared radius: twice as dense at the wall, where the
            profile is steep, and exact for the parabola.
        frequency: of the heartbeat, Hz.
        density: kg/m^3.
        viscosity: Pa s.
        womersley: with the profile of each harmonic; otherwise the parabola throughout.

    Returns:
        (phases, m, columns) velocity over the peak of the mean velocity; the trapezoidal mean of every profile over
        its columns is the flow of its phase.
    """
    radii = np.atleast_1d(np.asarray(radii, dtype=np.float64))
    squared = np.linspace(0.0, 1.0, columns)
    coefficients = heartbeat_coefficients()
    turns = np.exp(2j * np.pi * np.outer(np.arange(phases) / phases, np.arange(len(coefficients))))
    table = np.empty((phases, len(radii), columns))
    for row, radius in enumerate(radii):
        profiles = []
        for harmonic in range(len(coefficients)):
            alpha = float(womersley_number(radius, harmonic * frequency, density=density, viscosity=viscosity))
            profile = velocity_profile(alpha if womersley else 0.0, squared)
            profile[-1] = 0.0
            # read with linear interpolation, the table carries exactly this much
            profiles.append(profile / np.trapezoid(profile, squared))
        table[:, row] = ((turns * coefficients) @ np.array(profiles)).real
    return table
