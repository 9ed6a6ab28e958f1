"""An anatomy of a file in every stage that learns or tests: from the expert to navigation, replay, film and report."""

import importlib
import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from cathsim import load_phantom
from cathsim.anatomy import import_anatomy
from pipeline.anatomies.anatomy_file import AnatomyFile
from pipeline.episodes import EpisodeReader
from pipeline.episodes.records import EpisodeReadError
from pipeline.evaluations.tables import tables_from_logs
from pipeline.recording.record import record_episode
from pipeline.recording.replay import film_of, replay
from pipeline.report import learning_figures
from pipeline.stages import load_stage
from pipeline.stages.learning.task import LearningTask
from pipeline.store.errors import ConfigurationError
from pipeline.task import Task, entry_place
from tests.pipeline.composed import composed
from tests.pipeline.stages.small_expert import context, in_this_process

TARGET = "left_carotid"
NAMES = "phantom.names={lcca: left_carotid}"
COARSE = 2e-3  # m between the nodes of the file's grid; the usual one takes twice as long to import
TINY: dict[str, tuple[str, ...]] = {
    "expert": ("stage.film=false", "stage.threads=1"),
    "baselines": ("stage.decisions=32", "stage.ppo_decisions=32", "stage.observations=[internal]",
                  "stage.encoder_samples=40", "stage.training={n_envs: 2}", "stage.algorithms=[sac]"),
    "enn": ("stage.decisions=32", "stage.modalities=[]", "stage.expert=I+V", "stage.encoder_samples=40",
            "stage.algorithm=ppo", "stage.expert_episodes=1", "stage.training={n_envs: 2, learning_rate: 1e-3}"),
    "imitation": ("stage.expert=I+V", "stage.episodes=[1]"),
    "unseen": ("stage.decisions=64", "stage.hidden=16", "stage.image=false", "stage.xray=false",
               "stage.registration_noise_mm=[]", "stage.validation_episodes=1", "stage.mesh_episodes=1",
               "stage.targets=[bca]"),
    "navigation": ("stage.expert=I+V", "stage.arches=0", "stage.test_arches=0", "stage.perception_arches=0",
                   "stage.perception_frames=2", "stage.perception_epochs=1", "stage.episodes=[1]", "stage.epochs=1",
                   "stage.dagger_rounds=0", "stage.image_size_px=128", "stage.cameras=[a]", "stage.hidden=8",
                   "stage.film=false", "stage.trials=1"),
}  # fmt: skip


@pytest.fixture(scope="module", autouse=True)
def _coarse() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(AnatomyFile.load, "__defaults__", (COARSE,))
        yield


@pytest.fixture(scope="module")
def mesh(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small arch in mm, in a folder whose cache has its import."""
    folder = tmp_path_factory.mktemp("own")
    surface = load_phantom("type_1", resolution=2e-3).lumen_mesh.copy()
    surface.apply_scale(1e3)
    surface.export(folder / "my patient.stl")
    return folder / "my patient.stl"


def settled(stage: str, *overrides: str) -> Any:
    """A stage's settings as a run has them before its work begins."""
    settings = composed(f"stage={stage}", "budget=smoke", *overrides).stage
    load_stage(stage).prepare(settings)
    load_stage(stage).check(settings)
    return settings


def run_stage(stage: str, folder: Path, *overrides: str) -> Path:
    """Runs a stage's jobs in this process."""
    settings = settled(stage, *overrides, *TINY[stage], "stage.task.max_steps=4")
    module = importlib.import_module(load_stage(stage).run.__module__)
    reads = ("expert", "enn", "unseen", "splineformer")
    with pytest.MonkeyPatch.context() as patch:
        for user in (module, importlib.import_module("pipeline.stages.learning.training")):
            if hasattr(user, "run_jobs"):
                patch.setattr(user, "run_jobs", in_this_process)
        results = load_stage(stage).run(settings, context(folder, stage, reads=reads))
        assert results is not None
        results.write(folder / stage)
    return folder / stage


@pytest.fixture(scope="module")
def run(mesh: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of the stages that build on each other, in the file's anatomy."""
    from splineformer.build import build, size_of
    from splineformer.predictor import Predictor

    folder = tmp_path_factory.mktemp("run")
    chosen = (f"phantom.file='{mesh}'", "phantom.unit=mm", NAMES, f"target={TARGET}")
    torch.manual_seed(0)
    Predictor(build(size_of("ordered", "smoke"))).save(folder / "splineformer" / "ordered" / "predictor.pt")
    for stage in ("expert", "baselines", "enn", "imitation", "navigation"):
        run_stage(stage, folder, *chosen)
    return folder


def test_every_stage_leaves_episodes_in_the_file_s_anatomy(run: Path, mesh: Path) -> None:
    made = import_anatomy(mesh, unit="mm", names={"lcca": TARGET}, resolution=COARSE)
    for stage in ("expert", "baselines", "enn", "imitation", "navigation"):
        logs = sorted((run / stage).rglob("*.mcap"))
        assert logs, stage
        for log in logs:
            with EpisodeReader(log) as reader:
                info = reader.info
            assert (info.phantom, info.target, info.phantom_hash) == ("my_patient", TARGET, made.hash), log
            assert info.configuration["anatomy"]["mesh"]["names"] == [["lcca", TARGET]]
    assert (run / "enn" / "my_patient" / TARGET / "I+V" / "seed0" / "policy.pt").is_file()
    trials = json.loads((run / "navigation" / "results.json").read_text())["navigation_trials"]
    assert list(trials) == ["splineformer/my_patient"]


def test_episodes_replay_and_film_and_the_report_has_rows_and_pictures(run: Path, tmp_path: Path) -> None:
    log = run / "expert" / "my_patient" / TARGET / "000.mcap"
    assert len(replay(log).actions) == 4
    assert film_of(log, tmp_path / "film.gif").stat().st_size > 10_000
    assert learning_figures._phantom("my_patient", log).name == "my_patient"
    tables = tables_from_logs(run)
    assert tables["expert"][f"my_patient/{TARGET}"]["n"] == 1
    assert f"my_patient/{TARGET}/I+V" in tables["enn"]


def test_a_changed_file_is_refused_by_replay_and_left_out_of_the_report(mesh: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copy(mesh, tmp_path / "copy.stl"))
    anatomy = AnatomyFile.of(str(copy), "mm", {"lcca": TARGET}, None)
    environment = LearningTask(anatomy.name, TARGET, Task(max_steps=2), anatomy).environment("tip")
    log = tmp_path / "000.mcap"
    record_episode(environment, lambda *_: np.array([1.0, 0.0]), log, seed=0, operator="test", pictures=False)
    assert len(replay(log).actions) == 2
    with copy.open("ab") as file:
        file.write(b"more")
    with pytest.raises(EpisodeReadError, match=r"phantom 'copy' is another than the one described"):
        replay(log)
    assert learning_figures._phantom("copy", log) is None
    copy.unlink()
    with pytest.raises(EpisodeReadError, match="there is no file"):
        replay(log)


def test_unseen_tests_in_the_file_what_it_learnt(mesh: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pipeline.stages.unseen.task.training_arch", lambda seed, arches: ("random", 3))
    monkeypatch.setattr("pipeline.stages.unseen.stage.training_arches", lambda run, count: range(3, 3 + count))
    monkeypatch.setattr("pipeline.stages.unseen.trials.unseen_arches", lambda count: range(3, 3 + count))
    monkeypatch.setattr("pipeline.stages.unseen.stage.validation_arches", lambda count, every: range(3, 3 + count))
    folder = run_stage("unseen", tmp_path, f"phantom.file='{mesh}'", "phantom.unit=mm", NAMES, f"target={TARGET}")
    (log,) = folder.rglob("my_patient/*.mcap")
    with EpisodeReader(log) as reader:
        assert (reader.info.target, reader.info.configuration["test_set"]) == (TARGET, "my_patient")
    assert {path.parent.name for path in folder.rglob("*.mcap")} == {"my_patient", "random_3"}


def test_points_lie_in_the_file_s_axes(mesh: Path) -> None:
    file = (f"phantom.file='{mesh}'", "phantom.unit=mm", NAMES)
    made = import_anatomy(mesh, unit="mm", names={"lcca": TARGET}, resolution=COARSE)
    report = made.imported
    assert report is not None
    place = made.tree["bca"].point_at(made.tree["bca"].length - 0.02)
    in_file = [float(x) for x in 1e3 * (place - report.offset) @ report.rotation]
    settings = settled("enn", *file, f"stage.point_mm={in_file}")
    (target,) = settings.targets
    assert made.target(target).position == pytest.approx(place, abs=1e-4)
    assert made.target(target).branch == "bca"
    entered = settled("expert", *file, f"phantom.entry={in_file}", "target=lsa")
    assert entry_place(entered.task.entry) == pytest.approx(place, abs=1e-6)
    assert settled("expert", *file, "phantom.entry=lsa_end").task.entry == "lsa_end"


@pytest.mark.parametrize("stage", ["expert", "baselines", "enn", "imitation", "rehearsal", "unseen", "navigation"])
def test_a_target_that_the_file_does_not_have_is_refused(stage: str, mesh: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"unknown target 'lcca_ned' .*choose from bca, .*left_carotid"):
        settled(stage, f"phantom.file='{mesh}'", "phantom.unit=mm", NAMES, "target=lcca_ned")


@pytest.mark.parametrize("stage", ["expert", "unseen"])
@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ("stage.point_mm=[900,0,0]", "outside the lumen"),
        ("phantom.entry=groin", r"unknown entry 'groin' .*choose from descending"),
        ("phantom.labels={3: aorta}", r"my patient\.stl is no label volume"),
    ],
)
def test_what_else_the_file_does_not_have_is_refused(stage: str, asked: str, message: str, mesh: Path) -> None:
    given = (f"phantom.file='{mesh}'", "phantom.unit=mm", NAMES, *([] if "point" in asked else [f"target={TARGET}"]))
    with pytest.raises(ConfigurationError, match=message):
        settled(stage, *given, asked)
