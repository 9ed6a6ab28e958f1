"""Linear attenuation from Hounsfield units.

A voxel below zero is taken for a mixture of water and air, one above for water and cortical bone: two straight lines.
Bone's excess over water is larger at the beam's energy than at the CT's, so the upper line is the steeper one.

Sources: Bai et al., "A generalized model for the conversion from CT numbers to linear attenuation coefficients", IEEE
Transactions on Nuclear Science 50, 2003 (both lines); Kinahan, Hasegawa and Beyer, Seminars in Nuclear Medicine 33,
2003 (a CT's effective energy of about 70 keV); NIST's tables of cortical bone (ICRU-44, 1,920 kg/m^3) and water.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cathsim.fluoroscopy.materials import ATTENUATION

WATER = ATTENUATION["water"]  # 1/m at 60 keV, the beam's effective energy
# Mass attenuation (m^2/kg) at 60 and 80 keV, and the bone's density (kg/m^3).
_BONE, _WATER = (0.03148, 0.02229), (0.02059, 0.01837)
_BONE_DENSITY, _WATER_DENSITY = 1920.0, 1000.0
_CT_ENERGY = 70.0  # keV


def _at_ct_energy(pair: tuple[float, float]) -> float:
    """A coefficient between 60 and 80 keV, by a straight line of logarithms."""
    share = np.log(_CT_ENERGY / 60.0) / np.log(80.0 / 60.0)
    return float(pair[0] * (pair[1] / pair[0]) ** share)


def _excess(bone: float, water: float) -> float:
    return bone * _BONE_DENSITY / (water * _WATER_DENSITY) - 1.0


# How much more bone's excess over water counts in the beam than in the CT: 1.21.
BONE_FACTOR = _excess(_BONE[0], _WATER[0]) / _excess(_at_ct_energy(_BONE), _at_ct_energy(_WATER))


def attenuation(hounsfield: ArrayLike) -> NDArray[np.float64]:
    """Linear attenuation (1/m) at the beam's effective energy, of any shape, never negative."""
    excess = np.asarray(hounsfield, dtype=np.float64) / 1000.0
    share: NDArray[np.float64] = 1.0 + np.where(excess > 0, BONE_FACTOR * excess, excess)
    return WATER * np.maximum(share, 0.0)
