"""Settings of the stage `unseen`, and the sentences by which it refuses wrong ones."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from enn.policy import Policy
from enn.shipped import weight_files
from guide3d.random_fluoroscopy.settings import FluoroscopySettings
from pipeline.jobs.worker import Report
from pipeline.stages.unseen.plan import plan
from pipeline.stages.unseen.roadmap import (
    train_roadmap,
)
from pipeline.stages.unseen.stage import check_unseen
from pipeline.store.errors import ConfigurationError
from pipeline.task import Task
from tests.pipeline.stages.unseen.small_unseen import small_settings, variety


def test_clutter_in_larger_images_than_it_is_drawn_for_is_refused() -> None:
    large = Task(image_size_px=1025)
    with pytest.raises(ConfigurationError, match="clutter is drawn in images of at most 1024 px, got"):
        small_settings(clutter=1.0, task=large)
    assert small_settings(clutter=0.0, task=large).task.image_size_px == 1025
    assert FluoroscopySettings().image_px == 1024


def test_a_field_that_targets_lie_outside_of_is_refused() -> None:
    with pytest.raises(ConfigurationError, match=r"field_mm=100 would leave targets out .*: give 160 or more, or 0"):
        small_settings(field_mm=100.0)
    with pytest.raises(ConfigurationError, match=r"field_mm=180 would leave targets out .*: give 200 or more, or 0"):
        small_settings(targets=["bca", "rsa"], field_mm=180.0)
    assert small_settings(field_mm=180.0).field() == pytest.approx(0.18)
    assert small_settings(targets=["bca", "rsa"], field_mm=200.0).field() == pytest.approx(0.2)
    assert small_settings().field() is None


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"targets": ["aorta"]}, "unknown target 'aorta': choose from bca, lcca, lsa"),
        ({"phantoms": ["type_9"]}, "unknown phantom 'type_9': choose from type_1"),
        ({"wires": ["rope"]}, "unknown wire 'rope': choose from default"),
        ({"views": ["above"]}, "unknown view 'above': choose from frontal, lateral, lao_45"),
    ],
)
def test_unknown_names_are_one_sentence(changed: dict, sentence: str) -> None:
    with pytest.raises(ConfigurationError, match=sentence):
        check_unseen(small_settings(**changed))


def test_only_a_roadmap_policy_with_critics_starts_a_training(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"stage\.policy=missing\.pt is no file"):
        small_settings(policy="missing.pt")
    (damaged := tmp_path / "damaged.pt").write_bytes(b"nothing")
    with pytest.raises(ConfigurationError, match=r"damaged\.pt can't be read"):
        check_unseen(small_settings(policy=str(damaged)))
    acting = tmp_path / "acting.pt"
    Policy.load(next(file for file in weight_files() if file.stem == "generalist")).save(acting)
    with pytest.raises(ConfigurationError, match="is no policy by a roadmap that was saved with critics"):
        check_unseen(small_settings(policy=str(acting)))


def test_a_roadmap_policy_is_taken_as_it_is(tmp_path: Path) -> None:
    file = next(file for file in weight_files() if file.stem == "arch_variety")  # without critics
    with pytest.raises(ConfigurationError, match=r"stage\.decisions=0 takes a policy by a roadmap as it is: name its"):
        small_settings(decisions=0)
    with pytest.raises(
        ConfigurationError, match=r"was trained with stage\.task\.wire=arch_variety, .*: give the stage"
    ):
        check_unseen(small_settings(decisions=0, policy=str(file)))
    task = Task(**Policy.load(file).metadata["task"])
    wanted = small_settings(decisions=0, policy=str(file), curve=[], task=task)
    check_unseen(wanted)
    jobs = {job.key: job.given for job in plan(wanted, tmp_path, 0, "desk")}
    assert not [key for key in jobs if key.startswith(("starts", "demonstrations"))]
    assert (jobs["roadmap"].settings, jobs["roadmap"].start, jobs["roadmap"].tests) == (None, file, ())
    assert train_roadmap(replace(jobs["roadmap"], folder=tmp_path), Report()) == {"training_s": 0.0, "tests": []}
    taken = tmp_path / "roadmap" / "seed0" / "policy.pt"
    assert taken.read_bytes() == file.read_bytes()
    with pytest.raises(ConfigurationError, match="is no policy by a roadmap: give such a one"):
        check_unseen(small_settings(decisions=0, policy=str(file.with_name("type_1_bca.pt"))))


def test_impossible_sizes_are_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"stage\.advised_episodes must be 1 or more, got 0"):
        small_settings(advised_episodes=0)
    with pytest.raises(ConfigurationError, match="seed 20 has no training arches of its own, only seeds 0 to 19"):
        plan(small_settings(), tmp_path, 20, "desk")
    with pytest.raises(ConfigurationError, match="a seed has 1000 training arches of its own, got 1001: choose fewer"):
        plan(small_settings(anatomies=1001), tmp_path, 0, "desk")


@pytest.mark.parametrize("changed", [{"phantoms": ["type_1"]}, {"mesh": "aorta.stl"}])
def test_arch_variety_takes_no_other_anatomies(changed: dict[str, object]) -> None:
    with pytest.raises(ConfigurationError, match=r"give stage\.phantoms=\[\] stage\.mesh=null"):
        variety(**changed)
