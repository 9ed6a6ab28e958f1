"""The thesis's matching, for comparison: each sample of A takes the first crossing of its epiline with B's curve.

Crossings are looked for from the last one on; samples whose epiline meets nothing are filled in by PCHIP. Nothing
keeps a crossing from belonging to another branch: on loops, and where the wire runs along the epilines, it goes wrong
unnoticed, for its pairs lie exactly on each other's epilines.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import PchipInterpolator

from guide3d.geometry.epipolar import EpipolarGeometry, epilines, fundamental_matrix
from guide3d.geometry.polyline import Array
from guide3d.reconstruction.matching import Match

REACH_PX = 60.0  # how far beyond the last crossing the next one is looked for, beside the step in A
TIP_PX = 0.01
STEP = 4  # samples of A that are skipped between epilines


def match_greedily(geometry: EpipolarGeometry, curve_a: Array, curve_b: Array, sample_px: float) -> Match:
    """Matches two images of one curve by first crossings.

    Args:
        curve_a, curve_b: (n, 2) and (m, 2) px every `sample_px`, tip first.

    Returns:
        The match; `measured` tells crossings from what PCHIP fills in.

    Source:
        Altingövde et al., 3D reconstruction of curvilinear structures (2022), for the monotone completion.
    """
    rows = np.arange(0, len(curve_a), STEP)
    lines = epilines(fundamental_matrix(*geometry.cameras), curve_a[rows])
    crossings = np.full(len(rows), np.nan)
    last, since = 0.0, 0
    for k, line in enumerate(lines):
        first = int(last)
        since += 1  # the further A has gone without a crossing, the further on B may cross next
        until = min(len(curve_b), first + int(REACH_PX / sample_px) + 2 * STEP * since + 1)
        side = curve_b[first:until] @ line[:2] + line[2]
        if k == 0 and abs(side[0]) < TIP_PX:
            crossings[0] = 0.0  # a tip that lies on its epiline, but for rounding
            continue
        changes = np.flatnonzero(side[1:] * side[:-1] <= 0.0)
        for j in changes:
            step = side[j] - side[j + 1]
            place = first + j + (side[j] / step if step else 0.0)
            if place > last or k == 0:
                crossings[k] = last = float(place)
                since = 0
                break
    known = ~np.isnan(crossings)
    known[known] &= np.concatenate([[True], np.diff(crossings[known]) > 1e-6])
    if known.sum() < 2:
        empty = np.zeros((0, 2))
        return Match(*(np.zeros(0),) * 2, empty, empty, np.zeros(0), np.zeros(0, bool), 0.0, 0.0, np.inf)
    inside = slice(np.flatnonzero(known)[0], np.flatnonzero(known)[-1] + 1)
    filled = PchipInterpolator(rows[known], crossings[known])(rows[inside])
    index = np.arange(len(curve_b))
    points_b = np.stack([np.interp(filled, index, column) for column in curve_b.T], axis=-1)
    points_a = curve_a[rows[inside]]
    distance = geometry.signed_distance(points_a, points_b)
    return Match(
        along_a=np.asarray(rows[inside] * sample_px, dtype=np.float64),
        along_b=filled * sample_px,
        points_a=points_a,
        points_b=points_b,
        distance_px=distance,
        measured=known[inside],
        length_a=(len(curve_a) - 1) * sample_px,
        length_b=(len(curve_b) - 1) * sample_px,
        residual_px=float(np.sqrt((distance**2).mean())),
    )
