"""Cases of a claim of forces: a wire at rest in a drawn arch each, whose forces are found from its disturbed curve."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from pipeline.protocol.claims import Forces
from pipeline.seeds import protocol_arches

_PUSH, _TURN, _REST = 0.002, 0.26, 20  # of a control step, m and rad; control steps before the truth is read
_LEAST_RESULTANT = 0.03  # N: of less a relative error means little


def cases(claim: Forces, seed: int) -> Iterator[dict[str, Any]]:
    """Each case: the arch, whose seed also draws pushes, noise and errors."""
    for arch in protocol_arches(claim.first, seed, claim.count):
        yield {"anatomy": f"random_{arch}", "seed": arch}


def play(claim: Forces, case: dict[str, Any]) -> dict[str, Any]:
    """Moves a wire at random, lets it rest, and finds the forces on it from its curve and its feeder.

    Curve, insertion, rotation, lumen and stiffness are as wrong as `cathsim.statics.Uncertainty` says.

    Returns:
        `success` (whether the interval holds the resultant), `resultant_n` (the true one), `resultant_error_pct`,
        `sum_error_pct` (of the normal forces), and `place_mm` of the largest contact.
    """
    from cathsim.anatomy import load_phantom
    from cathsim.guidewire import Guidewire
    from cathsim.presets import ACCURACY
    from cathsim.simulation import Simulation
    from cathsim.statics import ContactForceEstimator, Uncertainty, drawn_errors, inserted_curve, noisy_curve
    from cathsim.statics.ensemble_summary import resting_contacts
    from cathsim.statics.observed_curve import observed_curve

    phantom, wire = load_phantom(case["anatomy"]), Guidewire().scaled(0.36)
    links = tuple(link / claim.pieces for link in wire.links for _ in range(claim.pieces))
    simulation = Simulation(phantom, replace(wire, links=links), ACCURACY[claim.accuracy])
    generator = np.random.default_rng(case["seed"])
    resultant = 0.0
    while not (simulation.valid and resultant >= _LEAST_RESULTANT):
        _move(simulation, generator)
        curve = inserted_curve(simulation)
        truth = resting_contacts(simulation, observed_curve(curve, phantom, "descending", simulation.max_insertion))
        resultant = float(np.linalg.norm(truth.resultant))
    errors = drawn_errors(phantom, wire, Uncertainty(), np.random.default_rng(case["seed"]))
    estimator = ContactForceEstimator(errors.phantom, errors.device, members=claim.members)
    disturbed = noisy_curve(curve, 1e-3 * claim.noise_mm, np.random.default_rng(case["seed"]))
    insertion = min(max(simulation.insertion + errors.insertion, 0.0), simulation.max_insertion)
    estimate = estimator.update(disturbed, insertion, simulation.rotation + errors.rotation)
    largest = estimate.points[np.argmax(estimate.normal_forces)] - truth.points[np.argmax(truth.normal_forces)]
    return {
        "success": bool(estimate.resultant.low <= resultant <= estimate.resultant.high),
        "resultant_n": round(resultant, 4),
        "resultant_error_pct": _error_pct(estimate.resultant.value, resultant),
        "sum_error_pct": _error_pct(estimate.normal_sum.value, truth.normal_sum),
        "place_mm": round(1e3 * float(np.linalg.norm(largest)), 2),
    }


def _move(simulation: Any, generator: np.random.Generator) -> None:
    """Begins anew: the wire is pushed in, pushed and turned at random, and rests."""
    simulation.reset(0.0, generator.uniform(-np.pi, np.pi))
    goal, turn = generator.uniform(0.10, 0.30), generator.uniform(-0.5, 0.5)
    moves = [(generator.normal(0.7, 0.4), turn + generator.normal(0.0, 0.35)) for _ in range(250)]
    lean, turn = generator.uniform(-1, 1, 2)
    count = int(generator.integers(5, 20))
    last = [(lean + generator.normal(0.0, 0.4), turn + generator.normal(0.0, 0.7)) for _ in range(count)]
    for push, rotation in moves:
        if simulation.insertion > goal - 0.001:
            break
        simulation.advance(_PUSH * float(np.clip(push, -1, 1)), _TURN * float(np.clip(rotation, -1, 1)))
    for push, rotation in [*last, *[(0.0, 0.0)] * _REST]:
        simulation.advance(_PUSH * float(np.clip(push, -1, 1)), _TURN * float(np.clip(rotation, -1, 1)))


def _error_pct(estimate: float, true: float) -> float:
    return round(100 * abs(estimate - true) / true, 2)
