"""Settings: NaN, infinity, slips of sign and size, and texts are refused by the field's name, everywhere."""

from __future__ import annotations

import dataclasses
import importlib
import json
import pkgutil
from typing import Any

import enn
from enn.fitting import EpisodeFitSettings
from enn.force.prediction import ForceNetworkSettings, ForcePredictionSettings
from enn.imitation.behaviour_cloning import BehaviourCloningSettings
from enn.imitation.cloned_policy import CloningNetworkSettings
from enn.imitation.dagger import DaggerSettings, DisturbanceSettings
from enn.imitation.path_following import PathFollowerSettings
from enn.imitation.recurrent_policy import RecurrentPolicySettings
from enn.imitation.sequence_cloning import SequenceCloningSettings
from enn.networks.encoder_network import EncoderSettings
from enn.networks.image_network import ImageSettings
from enn.networks.network import NetworkSettings
from enn.reinforcement.training.settings import DESK_PPO, SacSettings, TrainingSettings
from tests.number_fields import accepted, parametrised

# settings to the bad numbers that are good ones there
EVERYTHING: dict[Any, str] = {
    SacSettings(): "reset_bank_cases=0 reset_bank_share=0 checkpoint_seconds=0 demonstrations_in_replay=0 "
    "ent_coef=0 evaluate_every=0 gradient_steps=0 learning_starts=0 stop_after=0 target_entropy=-1 target_entropy=0 "
    "cloning_weight=0",
    DESK_PPO: "reset_bank_cases=0 reset_bank_share=0 checkpoint_seconds=0 ent_coef=0 "
    "evaluate_every=0 gae_lambda=0 learning_starts=0 stop_after=0 cloning_weight=0 log_std_init=-1 log_std_init=0 "
    "log_std_final=-1 log_std_final=0",
    NetworkSettings(): "",
    EncoderSettings(keys=("joints",), shapes=((4,),), channels=(4,)): "epochs=0 seed=0 weight_decay=0",
    EpisodeFitSettings(): "checkpoint_seconds=0 patience=0 validation_share=0 weight_decay=0",
    PathFollowerSettings(): "",
    DaggerSettings(): "expert_share=0",
    DisturbanceSettings(): "noise=0 push=-1 push=0 spell_chance=0",
    CloningNetworkSettings(): "expert_features=0",
    BehaviourCloningSettings(): "entropy=0 feature_matching=0 l2=0 noise=0 shift_px=0",
    ImageSettings(): "",
    ForceNetworkSettings(vector=3): "image_shape=0 matched=0 vector=0",
    ForcePredictionSettings(): "feature_weight=0",
    RecurrentPolicySettings(features=8): "dropout=0 hints=0",
    SequenceCloningSettings(): "hint_weight=0 noise=0 updates=0 weight_decay=0",
}


@parametrised(EVERYTHING)
def test_numbers_that_cannot_be_meant_are_refused_by_name(settings: Any, legal: set[str]) -> None:
    assert accepted(settings) == legal


def test_no_settings_are_left_out() -> None:
    names = [module.name for module in pkgutil.walk_packages(enn.__path__, "enn.")]
    found = {
        value
        for name in names
        for key, value in vars(importlib.import_module(name)).items()
        if key.endswith("Settings") and dataclasses.is_dataclass(value)
    }
    assert found - {TrainingSettings} == {type(one) for one in EVERYTHING}


def test_settings_come_back_from_a_file() -> None:
    for one in EVERYTHING:
        assert type(one)(**json.loads(json.dumps(dataclasses.asdict(one)))) == one
