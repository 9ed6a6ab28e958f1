"""Jobs of the stage `unseen` at the smallest size, also after an interruption."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from enn.imitation.images.egocentric import VIEW_SIZE
from enn.imitation.images.policy import ImagePolicy
from enn.imitation.images.stereo_view import STEREO_SIZE
from enn.imitation.recurrent_policy import RecurrentPolicy
from enn.policy import Policy
from enn.shipped import weight_files
from pipeline.evaluations.tables import tables_from_logs
from pipeline.jobs.worker import Report
from pipeline.recording.trials import Origin
from pipeline.stages.unseen import roadmap
from pipeline.stages.unseen.image_policy import train_image_policy
from pipeline.stages.unseen.stage import check_unseen, curve, plan
from pipeline.stages.unseen.task import UnseenTask
from pipeline.task import Task
from tests.pipeline.stages.unseen.small_unseen import TASK, TESTS, image_job, small_settings


def test_a_policy_of_x_ray_images_observes_no_mask(tmp_path: Path) -> None:
    jobs = {job.key: job.given for job in plan(small_settings(), tmp_path, 0, "desk")}
    assert jobs["image_true_mask"].observations() == ("image", "mask", "goal_image")
    assert jobs["xray"].observations() == ("goal_image",)
    seen = jobs["xray"].seen(TASK.test_environment("type_1", "lcca", "default", jobs["xray"].observations()))
    assert set(seen.reset(seed=0)[0]) == {"goal_image", "image", "plain", "contrast"}


def test_inserted_starts_lie_before_the_target_and_are_inserted_once(tmp_path: Path) -> None:
    job = roadmap.StartsJob(tmp_path / "starts", TASK, (5,), seed=0)
    inserted = roadmap.insert_starts(job, Report())
    assert inserted["anatomies"] == 1
    assert inserted["states"] >= 8
    written = (job.folder / "5.npz").stat().st_mtime_ns
    assert roadmap.insert_starts(job, Report()) == inserted
    assert (job.folder / "5.npz").stat().st_mtime_ns == written

    (starts,) = roadmap.read_starts(job.folder, (5,), TASK.targets)
    assert len(starts) == inserted["states"]
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


def test_wires_of_the_tests_and_with_a_catheter_both_devices_are_steered() -> None:
    task = UnseenTask(("bca",), Task(wire_length_mm=312.0))
    default, softer, stiffer, thesis = (task.wire(kind) for kind in ("default", "softer", "stiffer", "thesis"))
    assert default.links == softer.links
    assert stiffer.tip_stiffness_nmm2 == pytest.approx(4 * softer.tip_stiffness_nmm2)
    assert stiffer.shaft_stiffness_nmm2 == pytest.approx(2 * default.shaft_stiffness_nmm2)
    assert {round(1e3 * wire.length) for wire in (default, softer, stiffer, thesis)} == {312}
    both = replace(TASK, task=replace(TASK.task, catheter="simmons2", wire_length_mm=360.0))
    for environment in (
        both.training_environment((1,), ("roadmap", "history")),
        both.test_environment("type_1", "lcca", "default", ("roadmap", "history")),
    ):
        assert environment.action_space.shape == (4,)
        environment.close()


def test_jobs_leave_policies_logs_and_tables(tmp_path: Path) -> None:
    starts = roadmap.StartsJob(tmp_path / "unseen" / "starts", TASK, (0,), seed=0)
    assert roadmap.insert_starts(starts, Report())["states"] > 0
    small = small_settings(targets=["lcca"], anatomies=1, validation_episodes=1, hidden=16)
    tiny = replace(roadmap.training_settings(small, 1, 96), learning_starts=32, n_envs=4)
    teacher = roadmap.RoadmapJob(
        folder=tmp_path / "unseen",
        origin=Origin("unseen", "roadmap", 0, "desk"),
        task=TASK,
        anatomies=(0,),
        tests=TESTS,
        settings=replace(tiny, evaluate_every=96),
        validated=(2,),
    )
    by_roadmap = roadmap.train_roadmap(teacher, Report())
    assert by_roadmap["tests"][0]["n"] == 1
    log = teacher.own_folder / "evaluation" / "unseen" / "lcca" / "deterministic" / "random_1" / "000.mcap"
    written = log.stat().st_mtime_ns
    again = roadmap.train_roadmap(teacher, Report())
    assert again["tests"] == by_roadmap["tests"]
    assert log.stat().st_mtime_ns == written

    started = teacher.own_folder / "policy.pt"
    first = {"policy": str(started), "training": {"learning_starts": 32}}
    given = small_settings(targets=["lcca"], anatomies=1, curve=[1], **first)
    check_unseen(given)
    main, of_curve = (job.given for job in plan(given, tmp_path, 0, "desk") if job.key in ("roadmap", "roadmap 1"))
    assert (main.start, of_curve.start) == (started, None)
    assert (main.settings.hidden, of_curve.settings.hidden) == ((16, 16), (256, 256))
    assert main.settings.learning_rate == 0.2 * of_curve.settings.learning_rate
    further = replace(teacher, start=started, origin=replace(teacher.origin, training_seed=1), tests=())
    roadmap.train_roadmap(replace(further, settings=replace(tiny, hidden=(16, 16), learning_rate=1e-12)), Report())
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
    files = [one.own_folder / "image_policy.pt" for one in (job, whole)]
    weights = [RecurrentPolicy.load(file).network.state_dict() for file in files]
    assert weights[0].keys() == weights[1].keys()
    assert all(torch.equal(weights[0][name], weights[1][name]) for name in weights[1])
    record = json.loads((job.own_folder / "training.json").read_text())
    assert [row["round"] for row in record["rounds"]] == [0, 1]
    assert not (job.own_folder / "advised_episodes").exists()

    one = image_job(tmp_path, 1, "xray")
    two = replace(one, settings=replace(one.settings, views=["frontal", "lao_45"], field_mm=180.0))
    by_xray = train_image_policy(two, Report())
    learnt = ImagePolicy.load(two.own_folder / "image_policy.pt")
    assert learnt.imaging == {"views": ("frontal", "lao_45"), "field": 0.18}
    assert learnt.perception.voxels is not None  # what both views show together
    assert learnt.policy.settings.features == 2 * VIEW_SIZE + STEREO_SIZE

    tables = tables_from_logs(tmp_path)
    names = ("roadmap", "image_true_mask", "xray")
    assert set(tables["generalisation"]) == {f"{name}/lcca/unseen" for name in names}
    wanted = ("roadmap tests", *names[1:])
    jobs = [job for job in plan(small_settings(targets=["lcca"], curve=[]), tmp_path, 0, "desk") if job.key in wanted]
    rows = curve(jobs, dict(zip(wanted, (by_roadmap, outcome, by_xray), strict=True)))
    assert rows["roadmap/8"]["success_lcca_pct"] == by_roadmap["tests"][0]["success_pct"]
    assert rows["roadmap/8"]["decisions"] == 16_000
    assert list(rows) == ["roadmap/8", "image_true_mask/20", "xray/20"]


@pytest.mark.parametrize(("accuracy", "substeps"), [("fast", 5), ("accurate", 10)])
def test_the_physics_of_training_can_be_chosen(tmp_path: Path, accuracy: str, substeps: int) -> None:
    jobs = {job.key: job.given for job in plan(small_settings(accuracy=accuracy), tmp_path, 0, "desk")}
    task = jobs["roadmap"].task
    assert jobs["xray"].task == task
    assert task.training_environment((1,), ("tip",)).simulation.substeps == substeps
    assert task.test_environment("type_1", "lcca", "default", ("tip",)).simulation.substeps == 10


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
