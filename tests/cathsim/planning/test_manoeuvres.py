"""Tests of the manoeuvres that leave a local minimum."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from cathsim.planning.manoeuvres import (
    OUT,
    Ending,
    Manoeuvre,
    manoeuvre,
    parameter_limits,
    retreat,
    search_manoeuvres,
)
from cathsim.robot.pace import PACES

PACE = PACES["usual"]


def moved(plan: np.ndarray) -> np.ndarray:
    """What a plan moves in all: m and rad of each device."""
    return plan.sum(axis=0) * np.resize([PACE.translation, PACE.rotation], plan.shape[1])


@pytest.mark.parametrize("actions", [2, 4])
def test_plans_keep_to_the_pace_and_feed_the_wire_last(actions: int) -> None:
    low, high = parameter_limits(actions)
    assert (low < high).all()
    for parameters in np.random.default_rng(0).uniform(low, high, (50, len(low))):
        made = manoeuvre(parameters, PACE, lead=0.02)
        assert made.plan.shape[1] == actions
        assert np.abs(made.plan).max() <= 1.0 + 1e-12
        assert 0 < made.fed_from < len(made.plan)
        assert (made.plan[made.fed_from :, 0] == 1.0).all()


def test_phases_move_what_the_parameters_say() -> None:
    parameters = np.array([-0.05, 0.03, 1.0, 0.02, -0.5, 0.5, 0.0])
    made = manoeuvre(parameters, PACE, lead=0.02)
    wire, turn, catheter, turned = moved(made.plan[: made.fed_from])
    assert 0.02 + wire - catheter == pytest.approx(-0.05)
    assert catheter == pytest.approx(0.03 - 0.02)
    assert (turn, turned) == pytest.approx((0.5, 0.5))
    assert 0.02 + moved(made.plan)[0] - moved(made.plan)[2] == pytest.approx(OUT, abs=PACE.translation)


def test_a_wire_is_drawn_back_and_fed_beyond_where_it_was() -> None:
    made = manoeuvre(np.array([0.04, -2.0, 1.0]), PACE)
    assert moved(made.plan[: made.fed_from]) == pytest.approx((-0.04, -2.0))
    assert moved(made.plan)[0] == pytest.approx(OUT, abs=PACE.translation)


def test_search_finds_a_better_manoeuvre_than_it_draws_at_first() -> None:
    low, high = parameter_limits(4)
    aim = low + 0.3 * (high - low)
    first: list[float] = []

    def evaluate(tried: Sequence[Manoeuvre]) -> list[Ending]:
        costs = [float(np.abs((one.parameters - aim) / (high - low)).sum()) for one in tried]
        first.append(min(costs))
        return [(cost, 5) for cost in costs]

    found = search_manoeuvres(evaluate, np.random.default_rng(0), 4, PACE)
    costs = [cost for (cost, _), _ in found]
    assert costs == sorted(costs)
    assert costs[0] < first[0]


def test_search_ends_where_the_target_is_reached() -> None:
    rounds = []

    def evaluate(tried: Sequence[Manoeuvre]) -> list[Ending]:
        rounds.append(len(tried))
        return [(-0.9, 3)] * len(tried)

    search_manoeuvres(evaluate, np.random.default_rng(0), 2, PACE)
    assert len(rounds) == 1


@pytest.mark.parametrize("lead", [-0.03, 0.0, 0.05])
def test_a_retreat_draws_the_foremost_tip_back(lead: float) -> None:
    wire, _, catheter, _ = moved(retreat(np.random.default_rng(1), 4, PACE, lead=lead))
    foremost = max(lead + wire, catheter)  # before the catheter's tip at the start
    assert -0.10 <= foremost - max(lead, 0.0) <= -0.03
    assert 0.0 <= lead + wire - catheter <= 0.05
    alone = moved(retreat(np.random.default_rng(1), 2, PACE))
    assert -0.10 <= alone[0] <= -0.03
