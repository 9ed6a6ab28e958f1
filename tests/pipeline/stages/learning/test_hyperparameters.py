"""Hyper-parameters from the command line: taken, and refused in one sentence."""

from __future__ import annotations

from typing import Any

import pytest

from enn.reinforcement import DESK_PPO, DESK_SAC
from pipeline.stages.baselines import training_settings as of_baselines
from pipeline.stages.enn import training_settings as of_enn
from pipeline.stages.learning.settings import BaselinesSettings, EnnSettings, with_hyperparameters
from pipeline.stages.unseen.roadmap import training_settings as of_unseen
from pipeline.stages.unseen.settings import UnseenSettings
from pipeline.store.errors import ConfigurationError
from tests.pipeline.composed import composed

PLACE = {"phantoms": ["type_1"], "targets": ["bca"]}
CHANGES = {"learning_rate": 3e-4, "n_envs": 4, "hidden": [32, 32]}


def test_every_learning_stage_takes_them() -> None:
    made = [
        of_baselines(BaselinesSettings(**PLACE, training=CHANGES), "ppo", "internal"),
        of_enn(EnnSettings(**PLACE, training=CHANGES), 500),
        of_enn(EnnSettings(**PLACE, training=CHANGES, algorithm="ppo"), 500),
        of_unseen(UnseenSettings(training=CHANGES), 4, 1000),
    ]
    assert [one.algorithm for one in made] == ["ppo", "sac", "ppo", "sac"]
    for training in made:
        assert (training.learning_rate, training.n_envs, training.hidden) == (3e-4, 4, (32, 32))


def test_without_any_nothing_changes() -> None:
    assert with_hyperparameters(DESK_SAC, None) is with_hyperparameters(DESK_SAC, {}) is DESK_SAC
    with pytest.raises(ConfigurationError, match=r"stage\.training must be a mapping"):
        EnnSettings(**PLACE, training=[1])


@pytest.mark.parametrize("stage", ["baselines", "enn", "unseen", "rehearsal"])
def test_the_command_line_takes_them(stage: str) -> None:
    words = [f"stage={stage}", "stage.training={learning_rate: 3e-4, hidden: [32, 32]}"]
    config = composed(*words)
    assert config.stage.training == {"learning_rate": 3e-4, "hidden": [32, 32]}


@pytest.mark.parametrize(
    ("preset", "changes", "message"),
    [
        (DESK_SAC, {"lerning_rate": 1e-3}, "stage.training has no 'lerning_rate': choose from .*learning_rate"),
        (DESK_SAC, {"decisions": 5}, "stage.training has no 'decisions'"),
        (DESK_SAC, {"gamma": 2.0}, "stage.training: .*gamma"),
        (DESK_PPO, {"tau": 0.1}, "stage.training has no 'tau': choose from .*gae_lambda"),
    ],
)
def test_what_cannot_be_is_one_sentence(preset: Any, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        with_hyperparameters(preset, changes)
