"""The navigation: scenes, failure modes, a tiny run of the stage with everything it leaves, and bad settings."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import torch
from PIL import Image

from cathsim import NavigateEnv, load_phantom
from pipeline.episodes import EpisodeReader
from pipeline.jobs.worker import Report
from pipeline.stages.navigation import frames as navigation_frames
from pipeline.stages.navigation import stage as navigation
from pipeline.stages.navigation.demonstrations import episode_of_log, read_lessons, write_episodes
from pipeline.stages.navigation.failures import (
    ABORTED,
    OVERSHOOT,
    STUCK,
    WRONG_BRANCH,
    count_failures,
    failure_mode,
    places,
)
from pipeline.stages.navigation.film import SIDE_PX, NavigationFilm
from pipeline.stages.navigation.frames import frames_in
from pipeline.stages.navigation.jobs import NAVIGATOR, navigate, success_of
from pipeline.stages.navigation.perception import ReaderJob, load_reader
from pipeline.stages.navigation.scene import Rig, Scene, images_of_shape, scene_environment, with_shaft
from pipeline.stages.navigation.settings import NavigationSettings
from pipeline.stages.navigation.task import Rules
from pipeline.store.errors import ConfigurationError, StageError
from pipeline.task import TASK as KEY
from pipeline.task import Task
from splineformer.build import build, size_of
from splineformer.navigation.cloning import Episode
from splineformer.navigation.navigator import NavigatorSettings
from splineformer.navigation.perception import Reader
from splineformer.predictor import Predictor
from tests.pipeline.stages.small_expert import TASK, context, in_this_process, write_expert

READS = ("expert", "enn", "unseen", "splineformer")
SETTINGS = NavigationSettings(
    cameras=["a", "b"],
    image_size_px=256,
    phantoms=["type_1"],
    targets=["bca"],
    episodes=[1, 3],
    epochs=2,
    updates=0,
    dagger_rounds=1,
    dagger_lessons=1,
    dagger_epochs=1,
    arches=1,
    arch_rounds=1,
    arch_lessons=1,
    arch_epochs=1,
    test_arches=1,
    trials=1,
    reader_arches=0,
    reader_frames=4,
    reader_epochs=1,
    hidden=8,
    task=TASK.task,
    arch_task=Task(wire_length_mm=312.0, max_steps=9),
    arch_hidden=12,
)
RIG = Rig(("a",), 256)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run whose earlier stages left an expert, a teacher and a SplineFormer, none of them trained."""
    from enn.networks.network import NetworkSettings, build_network
    from enn.policy import Policy

    folder = tmp_path_factory.mktemp("run")
    write_expert(folder / "enn", episodes=2)
    (folder / "expert").mkdir()
    torch.manual_seed(0)
    predictor = Predictor(build(size_of("ordered", "smoke")))
    predictor.save(folder / "splineformer" / "ordered" / "predictor.pt")
    environment = NavigateEnv("type_1", "bca", observation=("roadmap",))
    settings, actions = NetworkSettings(keys=("roadmap",), hidden=(8,)), environment.action_space
    assert isinstance(actions, gymnasium.spaces.Box)
    network = build_network(settings, environment.observation_space, actions)
    told = {KEY: asdict(SETTINGS.arch_task)}
    teacher = Policy(settings, network, environment.observation_space, actions, metadata=told)
    teacher.save(folder / "unseen" / "roadmap" / "seed0" / "policy.pt")
    return folder


@pytest.fixture(scope="module")
def results(run: Path) -> dict:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(navigation, "run_jobs", in_this_process)
        patch.setattr(navigation, "training_arch", lambda seed: ("random", 3))
        patch.setattr(navigation, "unseen_arches", lambda count: range(3, 3 + count))
        patch.setattr(navigation_frames, "_BETWEEN", 3)
        navigation.run_navigation(SETTINGS, context(run, "navigation", reads=READS))
    return json.loads((run / "navigation" / "results.json").read_text())


def test_images_of_a_logged_shape_are_those_of_the_environment() -> None:
    phantom = load_phantom("type_1")
    scene = Scene(scene_environment(phantom, "bca", RIG, ("tip",)), RIG)
    scene.environment.reset(seed=3)
    for _ in range(20):
        scene.environment.step(np.array([1.0, 0.3]))
    seen = scene.images()[0].astype(float)
    simulation = scene.environment.simulation
    nodes = with_shaft(simulation.wire_points(), simulation.vessel.direction)
    drawn = images_of_shape(phantom, RIG, nodes, 5)[0].astype(float)
    empty = images_of_shape(phantom, RIG, np.empty((0, 3)), 5)[0].astype(float)
    wire = empty - drawn > 8  # the same noise in both
    assert wire.sum() > 50
    assert np.abs((drawn - seen)[wire].mean()) < 2
    assert (empty - seen)[wire].mean() > 8
    vessels = scene.vessels["a"]
    assert vessels.sample(scene.marks["a"]) > 0.5
    assert (vessels.sample(vessels.way(np.array([0.3, 0.78]))) > 0.5).mean() > 0.9


def test_eye_learns_from_laid_and_from_steered_wires(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(navigation_frames, "_BETWEEN", 3)
    settings = replace(SETTINGS, reader_frames=5)
    job = navigation.plan(settings, context(run, "navigation", reads=READS))[0].given
    assert isinstance(job, ReaderJob)
    job = replace(job, rules=Rules(replace(job.rules.task, max_steps=30)))
    frames = frames_in(("type_1", -1), job, 64)
    assert len(frames) == 5  # two laid ones first
    for pictures, curves in frames:
        assert pictures.shape == (2, 64, 64)
        assert ((curves > -1e-9) & (curves < 1 + 1e-9)).all()  # cut at the border, but for rounding
        places = np.clip((curves * 64).astype(int), 0, 63)
        on_wire = [picture[place[:, 1], place[:, 0]].mean() for picture, place in zip(pictures, places, strict=True)]
        beside = [picture[place[:, 1] - 4, place[:, 0]].mean() for picture, place in zip(pictures, places, strict=True)]
        assert np.mean(on_wire) < np.mean(beside)
    again = frames_in(("type_1", -1), job, 64)
    assert all(np.array_equal(a[0], b[0]) for a, b in zip(frames, again, strict=True))
    untaught = frames_in(("type_1", -1), replace(job, teacher=None), 64)
    assert len(untaught) == 5
    assert np.array_equal(untaught[0][0], frames[0][0])
    assert not np.array_equal(untaught[3][0], frames[3][0])


def test_map_in_space_leads_through_the_lumen() -> None:
    phantom, rig = load_phantom("type_1"), Rig(("a", "b"), 256)
    scene = Scene(scene_environment(phantom, "lcca", rig, ("tip",)), rig)
    scene.environment.reset(seed=3)
    tip = scene.environment.simulation.tip
    space = scene.space
    assert space is not None
    assert np.allclose(space.target, 1e3 * phantom.target("lcca").position, atol=1e-3)
    way = space.way(1e3 * tip)
    assert np.allclose(way[[0, -1]], (1e3 * tip, space.target), atol=1e-6)
    depth = 1e3 * phantom.grid.sample(way / 1e3)  # mm inside the wall
    assert np.quantile(depth, 0.1) > -2.0
    assert np.median(depth) > 2.0
    assert Scene(scene.environment, Rig(("a",), 256)).space is None
    scene.environment.close()


def test_failure_modes() -> None:
    phantom = load_phantom("type_1")
    tree = {branch.name: branch for branch in phantom.tree.branches}
    aorta, steps = tree["aorta"], 60

    def mode(end: np.ndarray, target: str = "lcca") -> str:
        way = np.concatenate((aorta.points[:20], np.repeat(end[None], steps - 19, axis=0)))
        return failure_mode(phantom, target, way, steps_allowed=steps, entry="descending")

    assert places(phantom, tree["lsa"].point_at([0.05]))[0] == ["lsa"]
    assert mode(tree["lsa"].point_at(0.05)) == WRONG_BRANCH
    assert mode(tree["bca"].point_at(0.045)) == WRONG_BRANCH
    assert mode(tree["lcca"].point_at(0.04)) == STUCK
    assert mode(tree["rsa"].point_at(0.02), "bca") == WRONG_BRANCH
    take_off = tree["lcca"].parent_arc
    assert mode(aorta.point_at(take_off - 0.03)) == STUCK
    assert mode(aorta.point_at(take_off + 0.005)) == STUCK
    assert mode(aorta.point_at(take_off + 0.03)) == OVERSHOOT
    short = failure_mode(phantom, "lcca", aorta.points[:30], steps_allowed=steps, entry="descending")
    assert short == ABORTED


def test_tables(results: dict) -> None:
    table = results["navigation"]
    rows = ["splineformer", "splineformer_3", "splineformer_dagger", "splineformer_arches"]
    assert set(table) == {*rows, "behaviour_cloning", "enn_expert"}
    for row in (*rows, "behaviour_cloning"):
        assert 0 <= table[row]["bca_success_pct"] <= 100
        assert table[row]["setup"] == "autonomous"
        assert set(table[row]) == {"setup", "explainable", "bca_success_pct", "bca_time_s"}
    assert set(results["navigation_trials"]) == {
        *(f"{row}/type_1" for row in rows),
        *(f"{row}/unseen_arches" for row in rows[2:]),
    }
    for cells in results["navigation_trials"].values():
        failed = sum(cells[f"bca_{mode}"] for mode in (WRONG_BRANCH, OVERSHOOT, STUCK, ABORTED))
        assert failed == cells["n"] - round(cells["bca_success_pct"] / 100 * cells["n"])
    assert list(results["navigation_episodes"]) == ["1 trials", "3 trials"]
    assert results["navigation_reader"]["images"]["value"] == 8  # of two cameras


def test_what_a_run_leaves(run: Path, results: dict) -> None:
    folder = run / "navigation"
    titles = [figure["file"] for figure in json.loads((folder / "figures.json").read_text())]
    assert titles == ["curve.png", "failures.png", "films/failure.gif"]
    assert len(read_lessons(folder / "episodes" / "type_1" / "bca.npz")) == 3  # one more than there are logs
    record = json.loads((folder / "splineformer_dagger" / "training.json").read_text())
    assert record["episodes"] == 2
    assert not (folder / "splineformer_dagger" / "lessons").exists()
    logs = sorted((folder / "splineformer" / "evaluation").glob("type_1/bca/type_1/*.mcap"))
    assert len(logs) == 1
    with EpisodeReader(logs[0]) as told:
        assert told.info.configuration["row"] == "splineformer"
        actions = told.load_arrays(pictures=False)["action"][1:]
    assert np.array_equal(actions[0], actions[2])
    assert count_failures(logs, load_phantom("type_1"))[STUCK] == 1


def test_finished_navigator_is_not_trained_again(run: Path, results: dict) -> None:
    jobs = {job.key: job for job in navigation.plan(SETTINGS, context(run, "navigation", reads=READS))}
    job = jobs["splineformer"].given
    before = (job.folder / NAVIGATOR).stat().st_mtime_ns
    told = navigate(replace(job, tests=()), Report())
    assert (job.folder / NAVIGATOR).stat().st_mtime_ns == before
    assert told["tests"] == []


def test_episode_of_a_log_has_a_look_a_decision(run: Path, results: dict) -> None:
    eye = load_reader(run / "navigation" / "reader")
    log = sorted((run / "enn" / TASK.name / "I+V+M" / "seed0" / "expert").glob("*.mcap"))[0]
    settings = NavigatorSettings(tokens=eye.tokens, memory=eye.memory, action_repeat=3)
    episode = episode_of_log(log, RIG, eye, settings)
    with EpisodeReader(log) as told:
        actions = told.load_arrays(pictures=False)["action"][1:]
    assert episode.looks.shape == (-(-len(actions) // 3), settings.size)
    assert np.allclose(episode.actions[1], actions[3:6].mean(axis=0), atol=1e-6)
    assert np.allclose(episode.looks[1, -4:-2], episode.actions[0], atol=1e-6)  # what was done before is seen
    again = episode_of_log(log, RIG, eye, settings)
    assert np.array_equal(episode.looks, again.looks)


def test_lessons_come_back_with_their_targets(tmp_path: Path) -> None:
    episodes = [
        Episode(np.full((n, 4), n, np.float32), np.zeros((n, 2), np.float32), np.zeros((n, 0), np.float32), n > 1, name)
        for n, name in ((1, "bca"), (3, "lcca"))
    ]
    write_episodes(tmp_path / "lessons.npz", episodes)
    back = read_lessons(tmp_path / "lessons.npz")
    assert [(len(one.looks), one.success, one.target) for one in back] == [(1, False, "bca"), (3, True, "lcca")]
    assert np.array_equal(back[1].looks, episodes[1].looks)
    assert success_of([*back, back[0]]) == {"bca": 0.0, "lcca": 100.0}


def test_a_film_shows_every_camera(run: Path) -> None:
    rig = Rig(("a", "b"), 256)
    scene = Scene(scene_environment(load_phantom("type_1"), "bca", rig, ("tip",)), rig)
    scene.environment.reset(seed=0)
    film = NavigationFilm(scene, Reader(Predictor.load(run / "splineformer" / "ordered" / "predictor.pt")))
    film.add(scene.environment)
    film.write(run / "both.gif")
    scene.environment.close()
    with Image.open(run / "both.gif") as picture:
        assert picture.size == (2 * SIDE_PX, 2 * SIDE_PX)
        halves = np.asarray(picture.convert("RGB")).astype(int)
    assert np.abs(halves[:SIDE_PX, :SIDE_PX] - halves[SIDE_PX:, :SIDE_PX]).mean() > 1  # two views, not one twice


def test_missing_teacher_is_told_before_any_work(run: Path, tmp_path: Path) -> None:
    given = context(run, "navigation", reads=READS)
    given.inputs["unseen"] = tmp_path
    with pytest.raises(StageError, match="run stage=unseen"):
        navigation.plan(SETTINGS, given)
    given = context(run, "navigation", reads=READS)
    given.inputs["enn"] = tmp_path
    with pytest.raises(StageError, match="run stage=enn"):
        navigation.plan(SETTINGS, given)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"cameras": ["c"]}, "stage.cameras has no 'c'"),
        ({"episodes": [100, 20]}, "must rise"),
        ({"transfer_phantoms": ["type_1"]}, "which is learnt in"),
        ({"splineformer": "unet"}, "stage.splineformer has no 'unet'"),
        ({"trials": 0}, "stage.trials must be 1 or more"),
        ({"dagger_rounds": -1}, "must be 0 or more"),
    ],
)
def test_bad_settings_are_refused(changed: dict, words: str) -> None:
    with pytest.raises(ConfigurationError, match=words):
        replace(SETTINGS, **changed)


def test_unknown_target_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="choose from bca"):
        navigation.check_navigation(replace(SETTINGS, targets=["aorta"]))
