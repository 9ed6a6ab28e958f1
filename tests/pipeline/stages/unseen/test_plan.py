"""The plan of the stage `unseen`: what is trained, tested and waits for what."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from enn.imitation.images.policy import ImagePolicy
from enn.policy import Policy
from enn.shipped import weight_files
from guide3d.random_fluoroscopy.settings import FluoroscopySettings
from pipeline.jobs.worker import Report
from pipeline.seeds import unseen_arches, validation_arches
from pipeline.stages.unseen.image_policy import train_image_policy
from pipeline.stages.unseen.roadmap import AnatomiesJob, RoadmapJob, StartsJob, train_roadmap
from pipeline.stages.unseen.settings import UnseenSettings
from pipeline.stages.unseen.stage import check_unseen, plan, registration
from pipeline.stages.unseen.task import training_arch
from pipeline.store.errors import ConfigurationError
from pipeline.store.provenance import hash_file
from pipeline.task import Task, differences
from tests.pipeline.composed import composed
from tests.pipeline.stages.unseen.small_unseen import TASK, small_settings, variety


def test_plan_never_trains_on_what_it_tests(tmp_path: Path) -> None:
    jobs = {job.key: job for job in plan(small_settings(), tmp_path, 3, "smoke")}
    policies = ["roadmap", "xray", "image_true_mask", "roadmap 1", "roadmap 4", "roadmap 8"]
    assert [key for key in jobs if "/" not in key] == [*policies[:3], "roadmap tests", *policies[3:]]
    assert jobs["roadmap tests"].given == replace(jobs["roadmap"].given, tests=jobs["roadmap tests"].given.tests)
    for key in (*policies, "roadmap tests"):
        given = jobs[key].given
        assert given.anatomies == tuple(range(3000, 3000 + len(given.anatomies)))
        tested = {phantom for test in given.tests for phantom in test.phantoms}
        assert not tested & set(given.anatomies)
        assert given.origin.variant == "smoke"
    assert [len(jobs[key].given.anatomies) for key in policies] == [8, 20, 20, 1, 4, 8]
    by_image = [jobs["image_true_mask"], jobs["xray"]]
    assert [test.name for test in by_image[0].given.tests] == ["unseen", "type_1", "unseen softer"]
    assert by_image[0].given.tests == by_image[1].given.tests
    assert [job.given.xray for job in by_image] == [False, True]
    assert [test.name for test in jobs["roadmap 4"].given.tests] == ["unseen"]
    assert by_image[0].after == by_image[1].after == ("roadmap",)
    built = [arch for job in jobs.values() if isinstance(job.given, AnatomiesJob) for arch in job.given.arches]
    tested = [("random", seed) for seed in unseen_arches(20)]
    validated = [training_arch(seed) for seed in validation_arches(16)]
    kinds = ("random", "random_wide", "random", "random_scan", "random_scan")
    trained = [(kinds[seed % 5], seed) for seed in range(3000, 3020)]
    assert built == [*trained, *validated, *tested]
    assert jobs["roadmap"].given.validated == tuple(seed for _, seed in validated)
    without = {job.key for job in plan(small_settings(image=False, xray=False), tmp_path, 3, "smoke")}
    assert not without & {"image_true_mask", "xray"}


def test_clutter_is_a_test_of_the_x_ray_policy_alone(tmp_path: Path) -> None:
    wanted = small_settings(image=True, clutter=0.5, clutter_anatomies=1)
    jobs = {job.key: job.given for job in plan(wanted, tmp_path, 0, "desk")}
    (among,) = [test for test in jobs["xray"].tests if test.name == "unseen clutter"]
    (usual,) = [test for test in jobs["xray"].tests if test.name == "unseen"]
    assert (among.clutter, usual.clutter, among.phantoms) == (0.5, 0.0, usual.phantoms[:1])
    for row in ("image_true_mask", "roadmap tests"):
        assert "unseen clutter" not in {test.name for test in jobs[row].tests}
    clean = {job.key: job.given for job in plan(small_settings(clutter=0.0), tmp_path, 0, "desk")}
    assert "unseen clutter" not in {test.name for test in clean["xray"].tests}


def test_points_of_the_curve_have_equally_many_decisions(tmp_path: Path) -> None:
    jobs = {job.key: job for job in plan(small_settings(), tmp_path, 0, "desk")}
    sizes = {key: job.given.settings.decisions for key, job in jobs.items() if isinstance(job.given, RoadmapJob)}
    assert sizes == {"roadmap": 16_000, "roadmap tests": 16_000, **{f"roadmap {k}": 8_000 for k in (1, 4, 8)}}
    every = {key: jobs[key].given.settings.evaluate_every for key in sizes}
    assert every == {key: decisions // (2 if key[-1].isdigit() else 5) for key, decisions in sizes.items()}
    assert {"roadmap", "xray", "image_true_mask"} <= set(
        jobs["roadmap 8"].after
    )  # two of them with as many arches would not fit the memory
    without = [job.key for job in plan(small_settings(curve=[]), tmp_path, 0, "desk")]
    assert [key for key in without if "roadmap " in key] == ["roadmap tests"]


def test_registrations_are_tried_on_the_same_arches_and_starts(tmp_path: Path) -> None:
    wanted = small_settings(registration_noise_mm=[0.0, 1.5, 4.0], test_anatomies=3)
    tests = {test.name: test for test in next(job for job in plan(wanted, tmp_path, 0, "desk")
                                              if job.key == "roadmap tests").given.tests}  # fmt: skip
    noisy = [tests["misregistered 1.5 mm"], tests["misregistered 4 mm"]]
    assert [test.registration_noise for test in noisy] == [1.5e-3, 4e-3]
    assert {test.phantoms for test in noisy} == {tests["unseen"].phantoms}
    tests_done = [
        {"test_set": name, "mode": mode, "target": target, "success_pct": success, "n": 3}
        for name, success in (("unseen", 100.0), ("misregistered 1.5 mm", 50.0), ("misregistered 4 mm", 0.0))
        for mode, target in (("deterministic", "bca"), ("deterministic", "lcca"), ("stochastic", "bca"))
    ]
    table = registration(wanted, tests_done)
    assert {row: cells["success_pct"] for row, cells in table.items()} == {"0 mm": 100, "1.5 mm": 50, "4 mm": 0}
    assert table["4 mm"]["n"] == 6
    # the noise moves the roadmap and leaves the start as it is
    starts = []
    for noise in (0.0, 4e-3):
        env = TASK.test_environment("type_1", "lcca", "default", ("roadmap", "history", "tip"), noise)
        starts.append(env.reset(seed=5)[0])
    np.testing.assert_array_equal(starts[0]["tip"], starts[1]["tip"])
    assert np.abs(starts[0]["roadmap"] - starts[1]["roadmap"]).max() > 0.01


def test_plan_demonstrates_in_training_anatomies(tmp_path: Path) -> None:
    jobs = {job.key: job for job in plan(small_settings(demonstrations=5), tmp_path, 1, "desk")}
    shown = [jobs["demonstrations/0"].given, jobs["demonstrations/1"].given]
    assert sorted(seed for given in shown for seed in given.shown) == list(range(1000, 1005))
    assert {"demonstrations/0", "demonstrations/1"} <= set(jobs["roadmap 4"].after)
    assert jobs["roadmap 4"].given.settings.reset_bank_cases == 12
    none = plan(small_settings(demonstrations=0), tmp_path, 1, "desk")
    assert not [job.key for job in none if job.key.startswith("demonstrations")]
    assert jobs["roadmap"].given.demonstrated
    assert not next(job for job in none if job.key == "roadmap").given.demonstrated


def test_plan_lays_starts_in_every_training_anatomy(tmp_path: Path) -> None:
    jobs = {job.key: job for job in plan(small_settings(anatomies=20), tmp_path, 1, "desk")}
    laid = [job for job in jobs.values() if isinstance(job.given, StartsJob)]
    assert [seed for job in laid for seed in job.given.anatomies] == list(range(1000, 1020))
    assert {job.key for job in laid} <= set(jobs["roadmap 1"].after)
    assert [job.after for job in laid] == [("training/1000",), ("training/1016",)]
    assert jobs["roadmap"].given.laid


def test_a_missing_mesh_is_left_out(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    jobs = plan(small_settings(curve=[], mesh=str(tmp_path / "aorta.stl")), tmp_path, 0, "desk")
    assert "the test on a scanned anatomy is left out" in caplog.text
    assert "real_mesh" not in [test.name for test in jobs[-1].given.tests]
    (tmp_path / "aorta.stl").touch()
    jobs = plan(small_settings(curve=[], mesh=str(tmp_path / "aorta.stl")), tmp_path, 0, "desk")
    assert "real_mesh" in [test.name for test in jobs[-1].given.tests]


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


def test_shipped_policies_are_tested_in_place_of_trainings(tmp_path: Path) -> None:
    wanted = composed("stage=unseen", "pretrained=true").stage
    check_unseen(wanted)
    jobs = {job.key: job.given for job in plan(wanted, tmp_path, 0, "desk")}
    assert {key.partition("/")[0] for key in jobs} == {"test", "roadmap", "xray", "roadmap tests"}
    navigator = ImagePolicy.load(jobs["xray"].start)
    assert navigator.imaging == {"views": jobs["xray"].views, "field": jobs["xray"].field}
    assert {len(jobs[key].anatomies) for key in ("roadmap", "xray")} == {150}
    assert differences(wanted.task, Task(**navigator.metadata["task"])) == []
    for key, train, name in (("roadmap", train_roadmap, "policy.pt"), ("xray", train_image_policy, "image_policy.pt")):
        job = replace(jobs[key], folder=tmp_path, tests=())
        assert train(job, Report()) == {"training_s": 0.0, "tests": []}
        assert (job.own_folder / name).read_bytes() == job.start.read_bytes()
    assert not composed("stage=unseen").stage.shipped
    assert wanted.navigator_sha256 == hash_file(jobs["xray"].start)


def test_shipped_policies_take_the_place_of_nothing_that_was_asked_for() -> None:
    asked = {
        "policy": "mine.pt",
        "views": ["lateral"],
        "least_set_back_mm": 20.0,
        "curve": [2],
        "training": {"gamma": 0.9},
    }
    for name, value in asked.items():
        with pytest.raises(ConfigurationError, match=rf"shipped=true takes .* and no stage\.{name}: .* PRETRAINED=0"):
            UnseenSettings(shipped=True, **{name: value})
    with pytest.raises(ConfigurationError, match=r"and no stage\.task\.image_size_px: train your own"):
        composed("stage=unseen", "pretrained=1", "stage.task.image_size_px=128")


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
