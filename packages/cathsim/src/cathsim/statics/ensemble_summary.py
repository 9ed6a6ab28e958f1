"""Contacts of a simulated device at rest, and those of an ensemble as one estimate: medians and 90 % intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cathsim.simulation import Simulation
from cathsim.statics.laying import distance_to
from cathsim.statics.observed_curve import ObservedCurve

Array = NDArray[np.float64]

QUANTILES = (0.05, 0.95)
WIDENING = 1.1  # of the interval's half widths, in logarithms: from 40 states in 20 random arches
MATCH = 0.015  # m along the device within which contacts of two members are the same
_LEAST_FORCE = 1e-4  # N: smaller forces are none
# Members further from the curve than the nearest one count less, by the excess of their squared distance: for the value
# by a factor e with 1.6 mm, for the interval with 3.5 mm. More weight makes intervals too narrow.
_VALUE_DISTANCE, _INTERVAL_DISTANCE = 1.6e-3, 3.5e-3


@dataclass(frozen=True, eq=False)
class RestingContacts:
    """Contacts of one simulated device."""

    points: Array  # on the wall, m, world frame. Shape (k, 3).
    forces: Array  # of the wall on the device, friction included, N, world frame. Shape (k, 3).
    normal_forces: Array  # part of each force along the wall's inward normal, N. Shape (k,).
    from_tip: Array  # distance of each contact from the tip along the device, m. Shape (k,).
    shape_error: float  # root mean square distance between the device and the observed curve, m

    @property
    def resultant(self) -> Array:
        """Sum of the forces, N. Shape (3,)."""
        return np.asarray(self.forces.sum(axis=0))

    @property
    def normal_sum(self) -> float:
        """Sum of the normal forces, N."""
        return float(self.normal_forces.sum())

    @property
    def largest(self) -> float:
        """Largest normal force of a contact, N; 0 without contacts."""
        return float(self.normal_forces.max(initial=0.0))


def resting_contacts(simulation: Simulation, curve: ObservedCurve) -> RestingContacts:
    """Reads the contacts of the last control step."""
    contacts = simulation.contacts()
    normals = wall_normals(simulation, contacts.points)
    return RestingContacts(
        contacts.points,
        contacts.forces,
        np.maximum((contacts.forces * normals).sum(axis=1), 0.0),
        _from_tip(simulation, contacts.points),
        distance_to(simulation, curve),
    )


def wall_normals(simulation: Simulation, points: Array) -> Array:
    """Unit normals of the wall, into the lumen, at points (k, 3) m near it. Shape (k, 3)."""
    if len(points) == 0:
        return np.empty((0, 3))
    gradient = simulation.vessel.distance(points)[1]
    return np.asarray(gradient / np.maximum(np.linalg.norm(gradient, axis=1, keepdims=True), 1e-9))


def _from_tip(simulation: Simulation, points: Array) -> Array:
    """Distance along the device from the tip to the place nearest to each point (k, 3) m. Shape (k,)."""
    nodes = simulation.inserted_points()
    starts, steps = nodes[:-1], np.diff(nodes, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    before = np.concatenate(([0.0], np.cumsum(lengths)[:-1]))
    offsets = points[:, None] - starts
    share = np.clip((offsets * steps).sum(axis=2) / lengths**2, 0.0, 1.0)
    nearest = np.argmin(np.linalg.norm(offsets - share[:, :, None] * steps, axis=2), axis=1)
    rows = np.arange(len(points))
    return np.asarray(before[nearest] + share[rows, nearest] * lengths[nearest])


@dataclass(frozen=True)
class Estimate:
    """A number with its 90 % interval; without an ensemble both ends are the number itself."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class ContactForces:
    """Contact forces of a device at rest along a curve. Lengths in m, forces in N, world frame.

    Contacts are those of the member nearest to the medians of the sums, from the tip on; their intervals are over the
    contacts of the other members at the same place along the device (`MATCH`) and on the same side.
    """

    points: Array  # on the wall, m. Shape (k, 3).
    forces: Array  # of the wall on the device, friction included, N. Shape (k, 3).
    normal_forces: Array  # N. Shape (k,).
    normal_forces_90: Array  # ends of the 90 % intervals, N. Shape (k, 2).
    from_tip: Array  # distance from the tip along the device, m. Shape (k,).
    from_tip_90: Array  # ends of the 90 % intervals, m. Shape (k, 2).
    presence: Array  # share of the members with a contact there. Shape (k,).
    normal_sum: Estimate  # sum of the normal forces, N
    resultant: Estimate  # magnitude of the sum of all forces, N
    resultant_vector: Array  # sum of `forces`, N. Shape (3,).
    largest: Estimate  # largest normal force of a contact, N
    insertion: float  # of the feeder, m: as given, or found
    rotation: float  # of the feeder, rad: as given, or found
    shape_error: float  # root mean square distance between the resting device and the curve, m; median of the members
    members: int  # that came to rest


def summarise(members: Sequence[RestingContacts], insertion: float, rotation: float) -> ContactForces:
    """The estimate of an ensemble, the nominal member first.

    Args:
        members: one at least.
        insertion: nominal, m.
        rotation: nominal, rad.
    """
    errors = np.array([member.shape_error for member in members])
    weights = _weights(errors, _VALUE_DISTANCE), _weights(errors, _INTERVAL_DISTANCE)
    sums = {
        "normal_sum": np.array([member.normal_sum for member in members]),
        "resultant": np.array([float(np.linalg.norm(member.resultant)) for member in members]),
        "largest": np.array([member.largest for member in members]),
    }
    estimates = {name: _estimate(values, *weights) for name, values in sums.items()}
    away = sum(np.abs(_log(sums[name]) - _log(estimates[name].value)) for name in ("normal_sum", "resultant"))
    exemplar = members[int(np.argmin(away))]
    order = np.argsort(exemplar.from_tip)
    force_90, place_90, presence = _contact_intervals(exemplar, members, *weights)
    return ContactForces(
        points=exemplar.points[order],
        forces=exemplar.forces[order],
        normal_forces=exemplar.normal_forces[order],
        normal_forces_90=force_90[order],
        from_tip=exemplar.from_tip[order],
        from_tip_90=place_90[order],
        presence=presence[order],
        resultant_vector=exemplar.resultant,
        insertion=insertion,
        rotation=rotation,
        shape_error=float(np.median([member.shape_error for member in members])),
        members=len(members),
        **estimates,
    )


def weighted_quantiles(values: Array, weights: Array, at: Sequence[float]) -> Array:
    """Quantiles of weighted values (n,), linear between them; weights of less than 1 % of the largest are left out.

    Returns:
        Shape (len(at),).
    """
    counted = weights > 0.01 * weights.max()
    values, weights = values[counted], weights[counted]
    order = np.argsort(values)
    share = np.cumsum(weights[order]) - 0.5 * weights[order]
    return np.asarray(np.interp(at, share / weights.sum(), values[order]))


def _weights(shape_errors: Array, distance: float) -> Array:
    return np.asarray(np.exp((shape_errors.min() ** 2 - shape_errors**2) / distance**2))


def _log(values: Array | float) -> Array:
    return np.log(np.maximum(values, _LEAST_FORCE))


def _estimate(values: Array, weights: Array, interval_weights: Array) -> Estimate:
    (middle,) = weighted_quantiles(_log(values), weights, (0.5,))
    low, high = weighted_quantiles(_log(values), interval_weights, QUANTILES)
    low, high = middle + WIDENING * min(low - middle, 0.0), middle + WIDENING * max(high - middle, 0.0)
    none = np.log(_LEAST_FORCE)
    return Estimate(*(float(np.exp(end)) if end > none else 0.0 for end in (middle, low, high)))


def _contact_intervals(
    exemplar: RestingContacts, members: Sequence[RestingContacts], weights: Array, interval_weights: Array
) -> tuple[Array, Array, Array]:
    """Intervals of normal force (k, 2) N and place (k, 2) m of the exemplar's contacts, and their presence (k,)."""
    count = len(exemplar.from_tip)
    forces, places = np.zeros((len(members), count)), np.full((len(members), count), np.nan)
    for row, member in enumerate(members):
        if count == 0 or len(member.from_tip) == 0:
            continue
        gap = np.abs(member.from_tip[:, None] - exemplar.from_tip)
        gap[member.forces @ exemplar.forces.T < 0] = np.inf
        nearest = gap.argmin(axis=1)
        matched = gap[np.arange(len(gap)), nearest] < MATCH
        np.add.at(forces[row], nearest[matched], member.normal_forces[matched])
        moment = np.zeros(count)
        np.add.at(moment, nearest[matched], (member.normal_forces * member.from_tip)[matched])
        present = forces[row] > 0
        places[row, present] = moment[present] / forces[row, present]
    force_90, place_90 = np.empty((count, 2)), np.empty((count, 2))
    for contact in range(count):
        estimate = _estimate(forces[:, contact], weights, interval_weights)
        own = exemplar.normal_forces[contact]
        force_90[contact] = min(estimate.low, own), max(estimate.high, own)
        present = np.isfinite(places[:, contact])
        place_90[contact] = exemplar.from_tip[contact]
        if present.any():
            ends = weighted_quantiles(places[present, contact], interval_weights[present], QUANTILES)
            place_90[contact] = min(ends[0], exemplar.from_tip[contact]), max(ends[1], exemplar.from_tip[contact])
    return force_90, place_90, (forces > 0).mean(axis=0)
