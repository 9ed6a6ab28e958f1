"""The plan of the stage `unseen`: what is trained, tested and waits for what, also in arches that are not usual."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cathsim import load_phantom
from cathsim.planning import demonstration
from cathsim.planning.demonstration import demonstrate
from enn.imitation.images.policy import ImagePolicy
from enn.policy import Policy
from enn.shipped import weight_files
from guide3d.random_fluoroscopy.settings import FluoroscopySettings
from pipeline.anatomies.devices import set_back_mm
from pipeline.jobs.worker import Report
from pipeline.seeds import unseen_arches, validation_arches
from pipeline.stages.unseen import roadmap
from pipeline.stages.unseen import task as arches
from pipeline.stages.unseen.image_policy import train_image_policy
from pipeline.stages.unseen.settings import UnseenSettings
from pipeline.stages.unseen.stage import check_unseen, plan, registration
from pipeline.stages.unseen.task import ROADMAP_KEYS, UnseenTask, training_arch
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
    kinds = ("random", "random_wide", "random", "random_scan", "random_scan")
    assert [training_arch(seed) for seed in range(3000, 3020)] == [
        (kinds[seed % 5], seed) for seed in range(3000, 3020)
    ]
    assert jobs["roadmap"].given.tests == ()
    assert jobs["roadmap tests"].given.tests[0].phantoms == tuple(unseen_arches(20))
    assert jobs["roadmap"].given.validated == tuple(validation_arches(16))
    without = {job.key for job in plan(small_settings(image=False, xray=False), tmp_path, 3, "smoke")}
    assert not without & {"image_true_mask", "xray"}
    with pytest.raises(ConfigurationError, match="a seed has 1000 training arches of its own"):
        plan(small_settings(anatomies=1001), tmp_path, 0, "desk")


def test_clutter_is_a_test_of_the_x_ray_policy_alone(tmp_path: Path) -> None:
    wanted = small_settings(image=True, clutter=0.5, clutter_anatomies=1)
    jobs = {job.key: job.given for job in plan(wanted, tmp_path, 0, "desk")}
    (among,) = [test for test in jobs["xray"].tests if test.name == "unseen clutter"]
    (usual,) = [test for test in jobs["xray"].tests if test.name == "unseen"]
    assert (among.clutter, usual.clutter, among.phantoms) == (0.5, 0.0, usual.phantoms[:1])
    clean = {job.key: job.given for job in plan(small_settings(clutter=0.0), tmp_path, 0, "desk")}
    for given in (jobs["image_true_mask"], jobs["roadmap tests"], clean["xray"]):
        assert "unseen clutter" not in {test.name for test in given.tests}
    with pytest.raises(ConfigurationError, match="clutter is drawn in images of at most 1024 px"):
        small_settings(clutter=1.0, task=Task(image_size_px=1025))
    assert small_settings(clutter=0.0, task=Task(image_size_px=1025)).task.image_size_px == 1025
    assert FluoroscopySettings().image_px == 1024


def test_points_of_the_curve_have_equally_many_decisions(tmp_path: Path) -> None:
    jobs = {job.key: job for job in plan(small_settings(), tmp_path, 0, "desk")}
    trained = {key: job.given for key, job in jobs.items() if isinstance(job.given, roadmap.RoadmapJob)}
    sizes = {key: given.settings.decisions for key, given in trained.items()}
    assert sizes == {"roadmap": 16_000, "roadmap tests": 16_000, **{f"roadmap {k}": 8_000 for k in (1, 4, 8)}}
    every = {key: given.settings.evaluate_every for key, given in trained.items()}
    assert every == {key: decisions // (2 if key[-1].isdigit() else 5) for key, decisions in sizes.items()}
    # two of them with as many arches would not fit the memory
    assert {"roadmap", "xray", "image_true_mask"} <= set(jobs["roadmap 8"].after)
    without = [job.key for job in plan(small_settings(curve=[]), tmp_path, 0, "desk")]
    assert [key for key in without if "roadmap " in key] == ["roadmap tests"]


def test_registrations_are_tried_on_the_same_arches_and_starts(tmp_path: Path) -> None:
    wanted = small_settings(registration_noise_mm=[0.0, 1.5, 4.0], test_anatomies=3)
    jobs = {job.key: job.given for job in plan(wanted, tmp_path, 0, "desk")}
    tests = {test.name: test for test in jobs["roadmap tests"].tests}
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


def test_plan_demonstrates_and_lays_starts_in_training_anatomies(tmp_path: Path) -> None:
    jobs = {job.key: job for job in plan(small_settings(anatomies=20, demonstrations=5), tmp_path, 1, "desk")}
    parts = [jobs["demonstrations/0"].given, jobs["demonstrations/1"].given]
    assert sorted(seed for given in parts for seed in given.demonstrated) == list(range(1000, 1005))
    inserted = [job for job in jobs.values() if isinstance(job.given, roadmap.StartsJob)]
    assert [seed for job in inserted for seed in job.given.anatomies] == list(range(1000, 1020))
    assert [len(job.given.anatomies) for job in inserted] == [16, 4]
    waited = set(jobs["roadmap 4"].after)
    assert {"demonstrations/0", "demonstrations/1", *(job.key for job in inserted)} <= waited
    assert jobs["roadmap 4"].given.settings.start_state_buffer_cases == 12
    none = {job.key: job.given for job in plan(small_settings(demonstrations=0), tmp_path, 1, "desk")}
    assert not [key for key in none if key.startswith("demonstrations")]


def test_a_field_that_targets_lie_outside_of_is_refused() -> None:
    wide = ["bca", "rsa"]
    for targets, field, least in ((["bca"], 100.0, 160), (wide, 180.0, 200)):
        with pytest.raises(ConfigurationError, match=rf"field_mm={field:g} .*: give {least} or more"):
            small_settings(targets=targets, field_mm=field)
    assert small_settings(field_mm=180.0).field() == pytest.approx(0.18)
    assert small_settings(targets=wide, field_mm=200.0).field() == pytest.approx(0.2)
    assert small_settings().field() is None


@pytest.mark.parametrize("changed", [{"targets": ["aorta"]}, {"phantoms": ["x"]}, {"wires": ["x"]}, {"views": ["x"]}])
def test_unknown_names_are_refused(changed: dict[str, list[str]]) -> None:
    ((setting, (name,)),) = changed.items()
    with pytest.raises(ConfigurationError, match=f"unknown {setting[:-1]} '{name}': choose from"):
        check_unseen(small_settings(**changed))


def test_only_a_roadmap_policy_with_critics_starts_a_training(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"stage\.policy=missing\.pt is no file"):
        small_settings(policy="missing.pt")
    (damaged := tmp_path / "damaged.pt").write_bytes(b"nothing")
    with pytest.raises(ConfigurationError, match=r"damaged\.pt can't be read"):
        check_unseen(small_settings(policy=str(damaged)))
    acting = tmp_path / "acting.pt"
    Policy.load(next(file for file in weight_files() if file.stem == "generalist")).save(acting)
    with pytest.raises(ConfigurationError, match="critics"):
        check_unseen(small_settings(policy=str(acting)))


def test_a_roadmap_policy_is_taken_as_it_is(tmp_path: Path) -> None:
    file = next(file for file in weight_files() if file.stem == "arch_variety")  # without critics
    with pytest.raises(ConfigurationError, match=r"stage\.decisions=0 takes a policy"):
        small_settings(decisions=0)
    with pytest.raises(ConfigurationError, match=r"was trained with stage\.task\.wire=arch_variety"):
        check_unseen(small_settings(decisions=0, policy=str(file)))
    task = Task(**Policy.load(file).metadata["task"])
    wanted = small_settings(decisions=0, policy=str(file), curve=[], task=task)
    check_unseen(wanted)
    jobs = {job.key: job.given for job in plan(wanted, tmp_path, 0, "desk")}
    assert not [key for key in jobs if key.startswith(("starts", "demonstrations"))]
    assert (jobs["roadmap"].settings, jobs["roadmap"].start, jobs["roadmap"].tests) == (None, file, ())
    outcome = roadmap.train_roadmap(replace(jobs["roadmap"], folder=tmp_path), Report())
    assert outcome == {"training_s": 0.0, "tests": []}
    taken = tmp_path / "roadmap" / "seed0" / "policy.pt"
    assert taken.read_bytes() == file.read_bytes()
    with pytest.raises(ConfigurationError, match="is no policy by a roadmap"):
        check_unseen(small_settings(decisions=0, policy=str(file.with_name("type_1_bca.pt"))))


def test_shipped_policies_are_tested_in_place_of_trainings(tmp_path: Path) -> None:
    wanted = composed("stage=unseen", "pretrained=true").stage
    check_unseen(wanted)
    jobs = {job.key: job.given for job in plan(wanted, tmp_path, 0, "desk")}
    assert set(jobs) == {"roadmap", "xray", "roadmap tests"}
    navigator = ImagePolicy.load(jobs["xray"].start)
    assert navigator.imaging == {"views": jobs["xray"].views, "field": jobs["xray"].field}
    assert {len(jobs[key].anatomies) for key in ("roadmap", "xray")} == {150}
    assert differences(wanted.task, Task(**navigator.metadata["task"])) == []
    taken = {"roadmap": (roadmap.train_roadmap, "policy.pt"), "xray": (train_image_policy, "image_policy.pt")}
    for key, (train, name) in taken.items():
        job = replace(jobs[key], folder=tmp_path, tests=())
        assert train(job, Report()) == {"training_s": 0.0, "tests": []}
        assert (job.own_folder / name).read_bytes() == job.start.read_bytes()
    assert not composed("stage=unseen").stage.shipped
    assert wanted.navigator_sha256 == hash_file(jobs["xray"].start)


def test_shipped_policies_take_the_place_of_nothing_that_was_asked_for() -> None:
    asked = {"policy": "mine.pt", "views": ["lateral"], "least_set_back_mm": 20.0, "curve": [2]}
    for name, value in (asked | {"training": {"gamma": 0.9}}).items():
        with pytest.raises(ConfigurationError, match=rf"shipped=true takes .* and no stage\.{name}"):
            UnseenSettings(shipped=True, **{name: value})
    with pytest.raises(ConfigurationError, match=r"and no stage\.task\.image_size_px"):
        composed("stage=unseen", "pretrained=1", "stage.task.image_size_px=128")


def test_arch_variety_takes_no_other_anatomies() -> None:
    with pytest.raises(ConfigurationError, match=r"give stage\.phantoms=\[\]"):
        variety(phantoms=["type_1"])


def test_arches_with_a_steep_take_off_are_chosen_in_order(monkeypatch: pytest.MonkeyPatch) -> None:
    backs = {seed: float(seed % 7) for seed in range(100)}
    monkeypatch.setattr("cathsim.load_phantom", lambda kind, seed, resolution: seed)
    monkeypatch.setattr(arches, "set_back_mm", lambda phantom, target: backs[phantom] if target == "lcca" else 0.0)
    assert arches.with_steep_take_off(range(100), ("bca", "lcca"), 5.0, 4) == [5, 6, 12, 13]
    with pytest.raises(ConfigurationError, match=r"only 2 of the arches .* 3 are wanted"):
        arches.with_steep_take_off(range(20), ("lcca",), 6.0, 3)


def test_steep_arches_are_trained_in_and_chosen_by(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def every_tenth(seeds: Iterable[int], targets: Sequence[str], least_mm: float, count: int, kind: str) -> list[int]:
        assert (list(targets), least_mm, kind) == (["bca", "lcca", "lsa"], 13.0, "random")
        return list(seeds)[::10][:count]

    monkeypatch.setattr("pipeline.stages.unseen.stage.with_steep_take_off", every_tenth)
    wanted = small_settings(least_set_back_mm=13.0, image=False, xray=False, curve=[], test_anatomies=5)
    jobs = {job.key: job.given for job in plan(wanted, tmp_path, 1, "desk")}
    assert jobs["roadmap"].anatomies == tuple(range(1000, 1080, 10))
    assert jobs["roadmap"].validated == tuple(range(32_000, 32_320, 20))
    assert jobs["roadmap tests"].tests[0].phantoms == tuple(unseen_arches(5))


def test_plan_in_arch_variety_has_all_types_and_points_of_each_arch(tmp_path: Path) -> None:
    jobs = {job.key: job for job in plan(variety(), tmp_path, 1, "smoke")}
    given = jobs["roadmap"].given
    assert {training_arch(seed, given.task.arches)[0] for seed in given.validated[:6]} == {
        f"arch_variety_{kind}" for kind in ("I", "II", "IV", "V", "VI", "VII")
    }
    assert given.anatomies == tuple(range(1000, 1008))
    assert given.validated[:6] == tuple(range(32_000, 32_006))
    assert given.task.targets == ("point_1", "point_2")
    assert given.settings.action_repeat == 2  # 0.3 s
    assert given.settings.start_state_buffer_cases == 16  # arches times points


def test_arches_of_arch_variety_with_a_steep_point_are_found() -> None:
    chosen = arches.with_steep_take_off(range(40), ("point_1", "point_2"), 8.0, 2, "arch_variety")
    for seed in range(chosen[-1] + 1):
        kind, own = training_arch(seed, "arch_variety")
        phantom = load_phantom(kind, seed=own, resolution=1e-3)
        steep = max(set_back_mm(phantom, target) for target in ("point_1", "point_2")) >= 8.0
        assert steep == (seed in chosen)


def test_environments_of_arch_variety_have_its_pace_and_points() -> None:
    task = UnseenTask(("point_1", "point_2"), variety().task, arches="arch_variety")
    for environment in (
        task.test_environment(40_003, "point_2", "arch_variety", ("tip",)),
        task.training_environment((40_003,), ("tip",)),
    ):
        environment.reset(seed=0, options={"case": 1} if hasattr(environment, "case") else None)
        assert environment.phantom.name == "arch_variety_II_40003"
        assert environment.task.target_name == "point_2"
        assert environment.simulation.pace.interval == pytest.approx(1 / 7.5)
        assert environment.task.success_radius == pytest.approx(0.005)
        environment.close()


TWO_TARGETS = UnseenTask(("bca", "lcca"), Task(wire_length_mm=312.0, max_steps=24))


def test_what_is_demonstrated_is_what_the_training_reads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    environment = TWO_TARGETS.training_environment((0,), ROADMAP_KEYS)
    made = demonstrate(environment, 1, ROADMAP_KEYS, hold=4, seed=3)

    tries = []
    made_well = {**made, "terminated": np.array(True)}
    monkeypatch.setattr(demonstration, "demonstrate", lambda *_, **__: tries.append(1) or made_well)
    job = roadmap.DemonstrationsJob(tmp_path, TWO_TARGETS, (0,), (0,), "lcca", hold=4, seed=3)
    assert roadmap.record_demonstrations(job, Report()) == {"shown": 1, "reached": 1}
    assert roadmap.record_demonstrations(job, Report()) == {"shown": 1, "reached": 1}
    assert len(tries) == 1  # what is there is not made again
    (read,) = roadmap.read_demonstrations(tmp_path, (0, 7))
    np.testing.assert_array_equal(read.observations["roadmap"], made["roadmap"])
    np.testing.assert_array_equal(read.simulation_states, made["states"])
    assert roadmap.read_demonstrations(tmp_path, (7,)) == []


def test_failures_are_kept_but_not_learnt_from(tmp_path: Path) -> None:
    short = replace(TWO_TARGETS, task=replace(TWO_TARGETS.task, max_steps=8))
    job = roadmap.DemonstrationsJob(tmp_path, short, (0,), (0,), "bca", hold=4, seed=0)
    assert roadmap.record_demonstrations(job, Report()) == {"shown": 1, "reached": 0}
    assert [path.name for path in tmp_path.iterdir()] == ["bca_0.npz"]
    assert roadmap.read_demonstrations(tmp_path, (0,)) == []
