"""Training settings: the thesis's tables, and contradictions that are refused."""

from __future__ import annotations

import dataclasses

import pytest

from enn.reinforcement.training import (
    THESIS_PPO,
    THESIS_SAC,
)


def test_the_thesis_presets_are_its_tables() -> None:
    table = {
        "learning_rate": 3e-4,
        "buffer_size": 1_000_000,
        "batch_size": 256,
        "tau": 0.005,
        "gamma": 0.99,
        "gradient_steps": 1,
        "ent_coef": "auto_1.0",  # its 1, where the learning starts
        "target_entropy": None,  # its -2, for two actions
    }
    assert {name: getattr(THESIS_SAC, name) for name in table} == table
    assert THESIS_SAC.decisions == THESIS_PPO.decisions == 600_000
    assert THESIS_PPO.learning_rate == 3e-4
    assert THESIS_PPO.variant == THESIS_SAC.variant == "thesis"


def test_settings_that_contradict_each_other_are_refused() -> None:
    with pytest.raises(ValueError, match=r"a fixed ent_coef of 1\.0 aims at no entropy"):
        dataclasses.replace(THESIS_SAC, ent_coef=1.0, target_entropy=-2.0)
    for odd in ("auto_0", "auto_-1", "auto_x", "fixed", "auto_nan"):
        with pytest.raises(ValueError, match="ent_coef must be a number, auto, or auto_ and the positive number"):
            dataclasses.replace(THESIS_SAC, ent_coef=odd)
    with pytest.raises(ValueError, match="SacSettings has no n_steps"):
        dataclasses.replace(THESIS_SAC, n_steps=128)
    for name, value in {"target_entropy": -2.0, "buffer_size": 9, "tau": 0.5, "gradient_steps": 2.0}.items():
        with pytest.raises(ValueError, match=f"PpoSettings has no {name}"):
            dataclasses.replace(THESIS_PPO, **{name: value})


def test_a_smaller_budget_makes_smaller_what_has_no_room_in_it() -> None:
    small = THESIS_SAC.sized(48, 2, tensorboard=True)
    assert (small.decisions, small.buffer_size, small.learning_starts, small.tensorboard) == (48, 48, 12, True)
    assert (small.evaluate_every, small.evaluation_episodes, small.curve_every) == (48, 2, 48)
    assert THESIS_PPO.sized(1024, 30).n_steps == 512
    assert THESIS_PPO.sized(1, 30).n_steps == 16
    assert THESIS_SAC.sized(THESIS_SAC.decisions, 30) == dataclasses.replace(THESIS_SAC, buffer_size=600_000)
