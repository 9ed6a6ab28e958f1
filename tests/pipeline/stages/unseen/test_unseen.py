"""The unseen stage: its plan, and its jobs at the smallest size, also after an interruption."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cathsim import load_phantom
from enn.imitation.image_policy import ImagePolicy
from enn.policy import Policy
from enn.shipped import weight_files
from guide3d.random_fluoroscopy.settings import FluoroscopySettings
from pipeline.anatomies.take_offs import set_back_mm
from pipeline.jobs.worker import Report
from pipeline.recording.trials import Origin
from pipeline.report.learning.tables import tables_from_logs
from pipeline.seeds import unseen_arches, validation_arches
from pipeline.stages.unseen import arches
from pipeline.stages.unseen.image_policy import ImagePolicyJob, train_image_policy
from pipeline.stages.unseen.jobs import (
    AnatomiesJob,
    RoadmapJob,
    build_anatomies,
    train_roadmap,
)
from pipeline.stages.unseen.plan import plan
from pipeline.stages.unseen.roadmap_training import training_settings
from pipeline.stages.unseen.settings import UnseenSettings
from pipeline.stages.unseen.stage import check_unseen
from pipeline.stages.unseen.starts import StartsJob, lay_starts, read_starts
from pipeline.stages.unseen.tables import curve, registration
from pipeline.stages.unseen.task import UnseenTask, training_arch
from pipeline.stages.unseen.trials import HeldOutSet
from pipeline.store.errors import ConfigurationError
from pipeline.task import Task

TASK = UnseenTask(("lcca",), Task(wire_length_mm=312.0, image_size_px=96, max_steps=16))
TESTS = (HeldOutSet("unseen", (1,)),)


@pytest.fixture(autouse=True)
def own_cache(anatomy_cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CATHSIM_CACHE", str(anatomy_cache))


def settings(**changed) -> UnseenSettings:
    values = {"curve": [1, 4], "anatomies": 8, "image_anatomies": 20, "phantoms": ["type_1"], "wires": ["softer"]}
    return UnseenSettings(**{**values, **changed})


def test_plan_never_trains_on_what_it_tests(tmp_path: Path) -> None:
    jobs = {job.key: job for job in plan(settings(), tmp_path, 3, "smoke")}
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
    tested = [("random", seed) for seed in unseen_arches(50)]
    validated = [training_arch(seed) for seed in validation_arches(16)]
    kinds = ("random", "random_wide", "random", "random_scan", "random_scan")
    trained = [(kinds[seed % 5], seed) for seed in range(3000, 3020)]
    assert built == [*trained, *validated, *tested]
    assert jobs["roadmap"].given.validated == tuple(seed for _, seed in validated)
    without = {job.key for job in plan(settings(image=False, xray=False), tmp_path, 3, "smoke")}
    assert not without & {"image_true_mask", "xray"}


def test_a_policy_of_x_ray_images_observes_no_mask(tmp_path: Path) -> None:
    jobs = {job.key: job.given for job in plan(settings(), tmp_path, 0, "desk")}
    assert jobs["image_true_mask"].observations() == ("image", "mask", "goal_image")
    assert jobs["xray"].observations() == ("goal_image",)
    seen = jobs["xray"].seen(TASK.test_environment("type_1", "lcca", "default", jobs["xray"].observations()))
    assert set(seen.reset(seed=0)[0]) == {"goal_image", "image", "plain", "contrast"}


def test_clutter_is_a_test_of_the_x_ray_policy_alone(tmp_path: Path) -> None:
    wanted = settings(image=True, clutter=0.5, clutter_anatomies=1)
    jobs = {job.key: job.given for job in plan(wanted, tmp_path, 0, "desk")}
    (among,) = [test for test in jobs["xray"].tests if test.name == "unseen clutter"]
    (usual,) = [test for test in jobs["xray"].tests if test.name == "unseen"]
    assert (among.clutter, usual.clutter, among.phantoms) == (0.5, 0.0, usual.phantoms[:1])
    for row in ("image_true_mask", "roadmap tests"):
        assert "unseen clutter" not in {test.name for test in jobs[row].tests}
    clean = {job.key: job.given for job in plan(settings(clutter=0.0), tmp_path, 0, "desk")}
    assert "unseen clutter" not in {test.name for test in clean["xray"].tests}


def test_clutter_in_larger_images_than_it_is_drawn_for_is_refused() -> None:
    large = Task(image_size_px=1025)
    with pytest.raises(ConfigurationError, match="clutter is drawn in images of at most 1024 px, got"):
        settings(clutter=1.0, task=large)
    assert settings(clutter=0.0, task=large).task.image_size_px == 1025
    assert FluoroscopySettings().image_px == 1024


def test_points_of_the_curve_have_equally_many_decisions(tmp_path: Path) -> None:
    jobs = {job.key: job for job in plan(settings(), tmp_path, 0, "desk")}
    sizes = {key: job.given.settings.decisions for key, job in jobs.items() if isinstance(job.given, RoadmapJob)}
    assert sizes == {"roadmap": 16_000, "roadmap tests": 16_000, **{f"roadmap {k}": 8_000 for k in (1, 4, 8)}}
    every = {key: jobs[key].given.settings.evaluate_every for key in sizes}
    assert every == {key: decisions // (2 if key[-1].isdigit() else 5) for key, decisions in sizes.items()}
    assert {"roadmap", "xray", "image_true_mask"} <= set(
        jobs["roadmap 8"].after
    )  # two of them with as many arches would not fit the memory
    assert not [key for key in (job.key for job in plan(settings(curve=[]), tmp_path, 0, "desk")) if "roadmap " in key
                and key != "roadmap tests"]  # fmt: skip


def test_registrations_are_tried_on_the_same_arches_and_starts(tmp_path: Path) -> None:
    wanted = settings(registration_noise_mm=[0.0, 1.5, 4.0], test_anatomies=3)
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
    jobs = {job.key: job for job in plan(settings(demonstrations=5), tmp_path, 1, "desk")}
    shown = [jobs["demonstrations/0"].given, jobs["demonstrations/1"].given]
    assert sorted(seed for given in shown for seed in given.shown) == list(range(1000, 1005))
    assert {"demonstrations/0", "demonstrations/1"} <= set(jobs["roadmap 4"].after)
    assert jobs["roadmap 4"].given.settings.reset_bank_cases == 12
    none = plan(settings(demonstrations=0), tmp_path, 1, "desk")
    assert not [job.key for job in none if job.key.startswith("demonstrations")]
    assert jobs["roadmap"].given.demonstrated
    assert not next(job for job in none if job.key == "roadmap").given.demonstrated


def test_plan_lays_starts_in_every_training_anatomy(tmp_path: Path) -> None:
    jobs = {job.key: job for job in plan(settings(anatomies=20), tmp_path, 1, "desk")}
    laid = [job for job in jobs.values() if isinstance(job.given, StartsJob)]
    assert [seed for job in laid for seed in job.given.anatomies] == list(range(1000, 1020))
    assert {job.key for job in laid} <= set(jobs["roadmap 1"].after)
    assert [job.after for job in laid] == [("training/1000",), ("training/1016",)]
    assert jobs["roadmap"].given.laid


def test_laid_starts_lie_before_the_target_and_are_laid_once(tmp_path: Path) -> None:
    job = StartsJob(tmp_path / "starts", TASK, (5,), seed=0)
    laid = lay_starts(job, Report())
    assert laid["anatomies"] == 1
    assert laid["states"] >= 8
    written = (job.folder / "5.npz").stat().st_mtime_ns
    assert lay_starts(job, Report()) == laid
    assert (job.folder / "5.npz").stat().st_mtime_ns == written

    (starts,) = read_starts(job.folder, (5,), TASK.targets)
    assert len(starts) == laid["states"]
    assert (starts[:, -1] == 0).all()
    environment = TASK.training_environment((5,), ("tip",))
    begun = environment.start_state()
    remaining = []
    for start in starts:
        environment.reset(options={"start": start})
        remaining.append(environment.task.remaining(environment.phantom, environment.simulation.tip))
    environment.reset(seed=0)
    whole = environment.task.remaining(environment.phantom, environment.simulation.tip)
    assert starts.shape[1] == len(begun)
    assert TASK.task.success_radius < min(remaining) < 0.03
    assert max(remaining) < 0.7 * whole


def test_wires_of_the_tests() -> None:
    task = UnseenTask(("bca",), Task(wire_length_mm=312.0))
    default, softer, stiffer, thesis = (task.wire(kind) for kind in ("default", "softer", "stiffer", "thesis"))
    assert default.links == softer.links
    assert stiffer.tip_stiffness_nmm2 == pytest.approx(4 * softer.tip_stiffness_nmm2)
    assert stiffer.shaft_stiffness_nmm2 == pytest.approx(2 * default.shaft_stiffness_nmm2)
    assert {round(1e3 * wire.length) for wire in (default, softer, stiffer, thesis)} == {312}


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
        check_unseen(settings(**changed))


def test_only_a_roadmap_policy_with_critics_starts_a_training(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"stage\.policy=missing\.pt is no file"):
        settings(policy="missing.pt")
    (damaged := tmp_path / "damaged.pt").write_bytes(b"nothing")
    with pytest.raises(ConfigurationError, match=r"damaged\.pt can't be read"):
        check_unseen(settings(policy=str(damaged)))
    acting = tmp_path / "acting.pt"
    Policy.load(next(file for file in weight_files() if file.stem == "generalist")).save(acting)
    with pytest.raises(ConfigurationError, match="is no policy by a roadmap that was saved with critics"):
        check_unseen(settings(policy=str(acting)))


def test_a_roadmap_policy_is_taken_as_it_is(tmp_path: Path) -> None:
    file = next(file for file in weight_files() if file.stem == "arch_variety")  # without critics
    with pytest.raises(ConfigurationError, match=r"stage\.decisions=0 takes a policy by a roadmap as it is: name its"):
        settings(decisions=0)
    with pytest.raises(
        ConfigurationError, match=r"was trained with stage\.task\.wire=arch_variety, .*: give the stage"
    ):
        check_unseen(settings(decisions=0, policy=str(file)))
    task = Task(**Policy.load(file).metadata["task"])
    wanted = settings(decisions=0, policy=str(file), curve=[], task=task)
    check_unseen(wanted)
    jobs = {job.key: job.given for job in plan(wanted, tmp_path, 0, "desk")}
    assert not [key for key in jobs if key.startswith(("starts", "demonstrations"))]
    assert (jobs["roadmap"].settings, jobs["roadmap"].start, jobs["roadmap"].tests) == (None, file, ())
    assert train_roadmap(replace(jobs["roadmap"], folder=tmp_path), Report()) == {"training_s": 0.0, "tests": []}
    taken = tmp_path / "roadmap" / "seed0" / "policy.pt"
    assert taken.read_bytes() == file.read_bytes()
    with pytest.raises(ConfigurationError, match="is no policy by a roadmap: give such a one"):
        check_unseen(settings(decisions=0, policy=str(file.with_name("type_1_bca.pt"))))


def test_impossible_sizes_are_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"stage\.advised_episodes must be 1 or more, got 0"):
        settings(advised_episodes=0)
    with pytest.raises(ConfigurationError, match="seed 20 has no training arches of its own, only seeds 0 to 19"):
        plan(settings(), tmp_path, 20, "desk")
    with pytest.raises(ConfigurationError, match="a seed has 1000 training arches of its own, got 1001: choose fewer"):
        plan(settings(anatomies=1001), tmp_path, 0, "desk")


def test_a_missing_mesh_is_left_out(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    jobs = plan(settings(curve=[], mesh=str(tmp_path / "aorta.stl")), tmp_path, 0, "desk")
    assert "the test on a scanned anatomy is left out" in caplog.text
    assert "real_mesh" not in [test.name for test in jobs[-1].given.tests]
    (tmp_path / "aorta.stl").touch()
    jobs = plan(settings(curve=[], mesh=str(tmp_path / "aorta.stl")), tmp_path, 0, "desk")
    assert "real_mesh" in [test.name for test in jobs[-1].given.tests]


def image_job(folder: Path, rounds: int, row: str = "image_true_mask") -> ImagePolicyJob:
    small = {"segmenter_epochs": 1, "rounds": rounds, "advised_episodes": 2, "epochs": 1, "wire_epochs": 1}
    return ImagePolicyJob(
        folder=folder / "unseen",
        origin=Origin("unseen", row, 0, "desk"),
        task=TASK,
        anatomies=(0,),
        tests=TESTS,
        settings=settings(**small),
    )


def test_jobs_leave_policies_logs_and_tables(tmp_path: Path) -> None:
    assert build_anatomies(AnatomiesJob((training_arch(0),), ("lcca",)), Report()) == {"anatomies": 1}
    assert lay_starts(StartsJob(tmp_path / "unseen" / "starts", TASK, (0,), seed=0), Report())["states"] > 0
    tiny = replace(
        training_settings(settings(targets=["lcca"], anatomies=1, validation_episodes=1, hidden=16), 1, 160),
        learning_starts=32,
        n_envs=4,
    )
    teacher = RoadmapJob(
        folder=tmp_path / "unseen",
        origin=Origin("unseen", "roadmap", 0, "desk"),
        task=TASK,
        anatomies=(0,),
        tests=TESTS,
        settings=replace(tiny, evaluate_every=160),
        validated=(2,),
    )
    by_roadmap = train_roadmap(teacher, Report())
    assert by_roadmap["tests"][0]["n"] == 1
    log = teacher.own_folder / "evaluation" / "unseen" / "lcca" / "deterministic" / "random_1" / "000.mcap"
    written = log.stat().st_mtime_ns
    again = train_roadmap(teacher, Report())
    assert again["tests"] == by_roadmap["tests"]
    assert log.stat().st_mtime_ns == written

    started = teacher.own_folder / "policy.pt"
    given = settings(targets=["lcca"], anatomies=1, curve=[1], policy=str(started), training={"learning_starts": 32})
    check_unseen(given)
    main, of_curve = (job.given for job in plan(given, tmp_path, 0, "desk") if job.key in ("roadmap", "roadmap 1"))
    assert (main.start, of_curve.start) == (started, None)
    assert (main.settings.hidden, of_curve.settings.hidden) == ((16, 16), (256, 256))
    assert main.settings.learning_rate == 0.2 * of_curve.settings.learning_rate
    further = replace(teacher, start=started, origin=replace(teacher.origin, training_seed=1), tests=())
    train_roadmap(replace(further, settings=replace(tiny, hidden=(16, 16), learning_rate=1e-12)), Report())
    assert np.allclose(*(Policy.load(job.own_folder / "policy.pt").module.state_dict()["actor.mu.weight"]
                         for job in (teacher, further)), atol=1e-6)  # fmt: skip

    # stopped after its first round, then gone on with: the same policy as without the stop
    class Stopped(Report):
        def __call__(self, fraction: float, text: str = "") -> None:
            if text.startswith("training round 2"):
                raise KeyboardInterrupt

    job = image_job(tmp_path, rounds=2)
    with pytest.raises(KeyboardInterrupt):
        train_image_policy(job, Stopped())
    assert (job.own_folder / "advised_episodes" / "round0.npz").is_file()
    outcome = train_image_policy(job, Report())
    whole = replace(job, folder=tmp_path / "other", tests=())
    shutil.copytree(teacher.own_folder, whole.folder / "roadmap" / "seed0")
    train_image_policy(whole, Report())
    weights = [np.frombuffer(_weights(folder), np.uint8) for folder in (job.own_folder, whole.own_folder)]
    np.testing.assert_array_equal(*weights)
    record = json.loads((job.own_folder / "training.json").read_text())
    assert [row["round"] for row in record["rounds"]] == [0, 1]
    assert not (job.own_folder / "advised_episodes").exists()

    one = image_job(tmp_path, 1, "xray")
    two = replace(one, settings=replace(one.settings, views=["frontal", "lao_45"]))
    by_xray = train_image_policy(two, Report())
    assert ImagePolicy.load(two.own_folder / "image_policy.pt").cameras == ("frontal", "lao_45")

    tables = tables_from_logs(tmp_path / "unseen")
    names = ("roadmap", "image_true_mask", "xray")
    assert set(tables["generalisation"]) == {f"{name}/lcca/unseen" for name in names}
    wanted = ("roadmap tests", *names[1:])
    jobs = [job for job in plan(settings(targets=["lcca"], curve=[]), tmp_path, 0, "desk") if job.key in wanted]
    rows = curve(jobs, dict(zip(wanted, (by_roadmap, outcome, by_xray), strict=True)))
    assert rows["roadmap/8"]["success_lcca_pct"] == by_roadmap["tests"][0]["success_pct"]
    assert rows["roadmap/8"]["decisions"] == 16_000
    assert list(rows) == ["roadmap/8", "image_true_mask/20", "xray/20"]


def _weights(folder: Path) -> bytes:
    from enn.imitation.recurrent_policy import RecurrentPolicy

    state = RecurrentPolicy.load(folder / "image_policy.pt").network.state_dict()
    return b"".join(value.numpy().tobytes() for value in state.values())


def test_with_a_catheter_both_devices_are_steered_in_training_and_tests() -> None:
    both = replace(TASK, task=replace(TASK.task, catheter="simmons2", wire_length_mm=360.0))
    for environment in (
        both.training_environment((1,), ("roadmap", "history")),
        both.test_environment("type_1", "lcca", "default", ("roadmap", "history")),
    ):
        assert environment.action_space.shape == (4,)
        environment.close()


def test_by_x_ray_images_a_catheter_is_steered_too(tmp_path: Path) -> None:
    teacher = next(file for file in weight_files() if file.stem == "generalist_simmons2")
    task = replace(TASK, task=replace(TASK.task, catheter="simmons2"))
    job = replace(image_job(tmp_path, 1, "xray"), task=task, tests=())
    taken = tmp_path / "unseen" / "roadmap" / "seed0" / "policy.pt"
    taken.parent.mkdir(parents=True)
    shutil.copyfile(teacher, taken)
    assert train_image_policy(job, Report())["tests"] == []
    learnt = ImagePolicy.load(job.own_folder / "image_policy.pt")
    assert (learnt.policy.settings.actions, learnt.perception.catheter is None) == (4, False)
    environment = job.seen(task.test_environment(1, "lcca", "default", job.observations()))
    seen, _ = environment.reset(seed=0)
    assert learnt.controller()(seen).shape == environment.action_space.shape == (4,)


def test_arches_with_a_steep_take_off_are_chosen_in_order(monkeypatch: pytest.MonkeyPatch) -> None:
    backs = {seed: float(seed % 7) for seed in range(100)}
    monkeypatch.setattr("cathsim.load_phantom", lambda kind, seed, resolution: seed)
    monkeypatch.setattr(arches, "set_back_mm", lambda phantom, target: backs[phantom] if target == "lcca" else 0.0)
    assert arches.with_steep_take_off(range(100), ("bca", "lcca"), 5.0, 4) == [5, 6, 12, 13]
    with pytest.raises(ConfigurationError, match=r"only 2 of the arches have a target set back by 6 mm, 3 are wanted"):
        arches.with_steep_take_off(range(20), ("lcca",), 6.0, 3)


def test_steep_arches_are_trained_in_and_chosen_by(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def every_tenth(seeds: Iterable[int], targets: Sequence[str], least_mm: float, count: int, kind: str) -> list[int]:
        assert (list(targets), least_mm, kind) == (["bca", "lcca", "lsa"], 13.0, "random")
        return list(seeds)[::10][:count]

    monkeypatch.setattr("pipeline.stages.unseen.arches.with_steep_take_off", every_tenth)
    wanted = settings(least_set_back_mm=13.0, image=False, xray=False, curve=[], test_anatomies=5)
    jobs = {job.key: job.given for job in plan(wanted, tmp_path, 1, "desk")}
    assert jobs["roadmap"].anatomies == tuple(range(1000, 1080, 10))
    assert jobs["roadmap"].validated == tuple(range(32_000, 32_320, 20))
    assert jobs["roadmap tests"].tests[0].phantoms == tuple(unseen_arches(5))
    built = {seed for job in jobs.values() if isinstance(job, AnatomiesJob) for _, seed in job.arches}
    assert built >= {*jobs["roadmap"].anatomies, *jobs["roadmap"].validated}


def variety(**changed) -> UnseenSettings:
    values = {"arches": "arch_variety", "phantoms": [], "wires": [], "anatomies": 8, "validation_anatomies": 6}
    task = Task(wire="arch_variety", pace="arch_variety", max_steps=8, success_radius_mm=5.0)
    return UnseenSettings(**{**values, "task": task, "points": 2, "image": False, "xray": False, **changed})


def test_plan_in_arch_variety_has_all_types_and_points_of_each_arch(tmp_path: Path) -> None:
    jobs = {job.key: job for job in plan(variety(), tmp_path, 1, "smoke")}
    built = [arch for job in jobs.values() if isinstance(job.given, AnatomiesJob) for arch in job.given.arches]
    assert {kind for kind, seed in built if 32_000 <= seed < 32_006} == {
        f"arch_variety_{kind}" for kind in ("I", "II", "IV", "V", "VI", "VII")
    }
    assert {seed for _, seed in built} == {*range(1000, 1008), *range(32_000, 32_006), *unseen_arches(50)}
    assert not any(job.given.targets for job in jobs.values() if isinstance(job.given, AnatomiesJob))
    given = jobs["roadmap"].given
    assert given.task.targets == ("point_1", "point_2")
    assert (given.settings.action_repeat, given.settings.reset_bank_cases) == (2, 16)  # 0.3 s; arches times points


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


@pytest.mark.parametrize("changed", [{"phantoms": ["type_1"]}, {"mesh": "aorta.stl"}])
def test_arch_variety_takes_no_other_anatomies(changed: dict[str, object]) -> None:
    with pytest.raises(ConfigurationError, match=r"give stage\.phantoms=\[\] stage\.mesh=null"):
        variety(**changed)
