"""Films of a training: every so many evaluations, of the policy of the moment, where the run asks for them."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import pytest

import enn
from cathsim.arch_variety import ArchVarietyEnv
from pipeline.config import RunConfig
from pipeline.execution import observation_of_trainings
from pipeline.jobs.engines.local import variables_set
from pipeline.recording.training_films import training_films


def test_every_second_evaluation_is_filmed(tmp_path: Path) -> None:
    from PIL import Image

    policy = enn.load("arch_variety")
    make = partial(ArchVarietyEnv, ("I",), (3,), observation=policy.keys, max_steps=6)
    assert training_films(tmp_path, make, 5) is None
    with variables_set(observation_of_trainings(RunConfig(stage=None, name="a", films=2))):
        films = training_films(tmp_path, make, 5)
    assert films is not None
    for decisions in (100, 200, 300):
        films(policy, decisions)
    assert sorted(path.name for path in (tmp_path / "films").iterdir()) == ["00000100.gif", "00000300.gif"]
    with Image.open(tmp_path / "films" / "00000100.gif") as film:
        assert film.n_frames >= 4
        assert film.size == (700, 400)


def test_what_a_run_was_told_ends_with_it(monkeypatch: pytest.MonkeyPatch) -> None:
    from enn.curves import chosen_logger

    monkeypatch.delenv("ENN_LOGGER", raising=False)
    with variables_set(observation_of_trainings(RunConfig(stage=None, name="a", logger="none"))):
        assert chosen_logger() == "none"
    assert chosen_logger() == "tensorboard"
