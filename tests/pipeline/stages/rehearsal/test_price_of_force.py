"""What a newton costs in the training of a rehearsal."""

from __future__ import annotations

import pytest

from enn.device_trials import Tried
from pipeline.stages.rehearsal.settings import RehearsalSettings
from pipeline.task import Task


def test_a_newton_costs_more_with_two_devices_unless_the_settings_say() -> None:
    task, both = Task(), Task(catheter="jb2")
    assert [RehearsalSettings().price_of_force(one) for one in (task, both)] == [0.1, 0.3]
    assert [RehearsalSettings(force_penalty=0.0).price_of_force(one) for one in (task, both)] == [0.0, 0.0]


@pytest.mark.parametrize(
    ("tried", "price"),
    [(Tried(4, 4, 60.0, 0.5), 1.0), (Tried(4, 4, 60.0, 0.2), 0.1), (Tried(3, 4, 60.0, 0.5), 0.1), (None, 0.1)],
    ids=["presses", "presses little", "does not always arrive", "not tried"],
)
def test_a_newton_costs_more_where_the_wire_alone_always_arrives_and_presses(tried: Tried | None, price: float) -> None:
    settings = RehearsalSettings()
    assert settings.price_of_force(Task(), tried) == price
    assert settings.price_of_force(Task(catheter="jb2"), tried) == 0.3
    assert RehearsalSettings(force_penalty=0.2).price_of_force(Task(), tried) == 0.2
