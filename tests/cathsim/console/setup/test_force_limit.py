"""The force limit: each rise to it is one warning, and it may end the procedure."""

from __future__ import annotations

import pytest

from cathsim.console.setup.operator_setup import ForceLimit, ForceWatch


def test_each_rise_to_the_limit_is_one_warning() -> None:
    watch = ForceWatch(ForceLimit(2.0))
    assert [watch.see(force) for force in (0.5, 2.0, 3.0, 1.9, 2.5)] == [False, True, False, False, True]
    assert (watch.warnings, watch.ends) == (2, False)


def test_it_ends_the_procedure_where_that_is_chosen() -> None:
    watch = ForceWatch(ForceLimit(1.0, ends=True))
    watch.see(0.9)
    assert not watch.ends
    watch.see(1.0)
    assert watch.ends


@pytest.mark.parametrize("wrong", [0.0, -1.0, 101.0, float("nan"), float("inf")])
def test_impossible_limits_are_refused(wrong: float) -> None:
    with pytest.raises(ValueError, match="force must"):
        ForceLimit(wrong)
