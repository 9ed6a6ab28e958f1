"""The stages shape and segmentation: tiny runs with everything they leave, what is kept, and bad settings."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from guide3d.learning.predictor import ShapePredictor
from pipeline.jobs.worker import Report
from pipeline.settings.kinds import settings_that_matter
from pipeline.stages import segmentation, shape
from pipeline.stages.guide3d.folder import Source
from pipeline.stages.guide3d.settings import Guide3dSettings
from pipeline.stages.networks import shipped
from pipeline.stages.networks import training as network_stage
from pipeline.stages.networks.settings import SegmentationSettings, ShapeSettings
from pipeline.stages.networks.training import learn_shape, train_network, train_together
from pipeline.store.errors import ConfigurationError, StageError
from tests.enn.event_scalars import scalars
from tests.guide3d.learning.drawn_data import draw
from tests.pipeline.stages.small_expert import context, in_this_process


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    draw(folder / "guide3d" / "dataset")
    Source("dataset").write(folder / "guide3d")
    return folder


@pytest.fixture(scope="module")
def shapes(run: Path) -> dict:
    settings = ShapeSettings(rows=["spherical", "cartesian", "fgrn"], size="smoke", device="cpu")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(network_stage, "run_jobs", in_this_process)
        shape.run_shape(settings, context(run, "shape", reads=("guide3d",))).write(run / "shape")
    return json.loads((run / "shape" / "results.json").read_text())


@pytest.fixture(scope="module")
def masks(run: Path) -> dict:
    settings = SegmentationSettings(rows=["unet", "swinunet"], size="smoke", device="cpu", test_images=4)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(network_stage, "run_jobs", in_this_process)
        found = segmentation.run_segmentation(settings, context(run, "segmentation", reads=("guide3d",)))
        found.write(run / "segmentation")
    return json.loads((run / "segmentation" / "results.json").read_text())


def test_shape_leaves_networks_tables_and_figures(run: Path, shapes: dict) -> None:
    assert set(shapes["shape_prediction_mm"]) == {"spherical", "cartesian"}
    assert set(shapes["shape_networks"]) == {"spherical", "cartesian", "fgrn"}
    for cells in shapes["shape_networks"].values():
        assert cells["n"] == 4  # one acquisition of six
        assert cells["max_ed"][0] >= cells["mers"][0] > 0
        assert cells["frechet"][0] >= cells["chamfer"][0] > 0
    figures = json.loads((run / "shape" / "figures.json").read_text())
    assert len(figures) == 6
    assert sorted(p.name for p in (run / "shape" / "fgrn").iterdir()) == [
        "examples.npz", "predictor.pt", "shape.json", "tensorboard", "training.json",
    ]  # fmt: skip
    rows = json.loads((run / "shape" / "fgrn" / "training.json").read_text())["rows"]
    shown = scalars(run / "shape" / "fgrn")
    assert shown["train/loss"] == pytest.approx({row["epoch"]: row["loss"] for row in rows})
    assert shown["train/validation"] == pytest.approx({row["epoch"]: row["validation"] for row in rows})


def test_segmentation_leaves_networks_tables_and_figures(run: Path, masks: dict) -> None:
    assert set(masks["segmentation"]) == {"unet", "swinunet"}
    for row, cells in masks["segmentation_networks"].items():
        assert cells["n"] == 4
        assert cells["miou"][0] >= cells["iou_foreground"][0]
        assert masks["segmentation"][row]["jaccard"] == cells["iou_foreground"]
    assert len(json.loads((run / "segmentation" / "figures.json").read_text())) == 3


def test_a_finished_network_is_kept(run: Path, shapes: dict, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = ShapeSettings(rows=["fgrn"], size="smoke", device="cpu")
    job = shape.plan(settings, context(run, "shape", reads=("guide3d",)))[0].given
    monkeypatch.setattr("guide3d.train.train", None)
    assert learn_shape(job, Report())["max_ed"] == shapes["shape_networks"]["fgrn"]["max_ed"]


def test_a_training_without_its_data_set_says_so(run: Path, tmp_path: Path) -> None:
    job = shape.plan(
        ShapeSettings(rows=["spherical"], size="smoke"), context(tmp_path, "shape", reads=("guide3d",))
    )[0].given  # fmt: skip
    with pytest.raises(StageError, match="holds no data set: run stage=guide3d again"):
        train_network(job, Report())
    shutil.copytree(run / "guide3d", tmp_path / "guide3d")
    shutil.rmtree(tmp_path / "guide3d" / "dataset")
    with pytest.raises((StageError, FileNotFoundError), match="is missing"):
        train_network(job, Report())


def test_weights_that_are_not_there_are_named(run: Path, tmp_path: Path) -> None:
    settings = ShapeSettings(rows=["spherical"], size="smoke", device="cpu", pretrained=str(tmp_path / "vit.pt"))
    job = shape.plan(settings, context(run, "elsewhere", reads=("guide3d",)))[0].given
    with pytest.raises(FileNotFoundError, match="there are no pretrained weights"):
        train_network(job, Report())


@pytest.mark.parametrize(
    ("made", "sentence"),
    [
        (lambda: ShapeSettings(rows=["unet"]), "stage.rows has no 'unet': choose from spherical, cartesian"),
        (lambda: ShapeSettings(rows=[]), "stage.rows is empty"),
        (
            lambda: ShapeSettings(rows=["fgrn"], size="huge"),
            "stage.size has no 'huge': choose from thesis, desk, smoke",
        ),
        (lambda: SegmentationSettings(rows=["vnet"]), "stage.rows has no 'vnet'"),
        (lambda: SegmentationSettings(rows=["unet"], processes=0), "stage.processes must be 1 or more"),
        (lambda: SegmentationSettings(rows=["unet"], test_images=-1), "stage.test_images must be 0 or more"),
    ],
)
def test_settings_are_checked(made, sentence: str) -> None:
    with pytest.raises(ConfigurationError, match=sentence):
        made()


def test_settings_know_what_the_package_trains() -> None:
    from guide3d.learning.build import SIZES
    from guide3d.train import NETWORKS
    from pipeline.stages.networks.settings import NETWORK_SIZES, SEGMENTATION_ROWS, SHAPE_ROWS

    assert set(SHAPE_ROWS) | set(SEGMENTATION_ROWS) == set(NETWORKS)
    assert NETWORK_SIZES == SIZES


TALKER = """
import sys
from pathlib import Path
sys.stderr.write("much to say\\n" * 30_000)
Path(sys.argv[1]).write_text("finished")
"""


@pytest.fixture
def talker(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    (tmp_path / "talker.py").write_text(TALKER)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    return "talker"


def test_an_error_stream_that_nobody_reads_does_not_stop_the_training(talker: str, tmp_path: Path) -> None:
    looks: list[str] = []
    train_together(talker, [str(tmp_path / "written")], 1, lambda share, words="": looks.append(words))
    assert (tmp_path / "written").read_text() == "finished"
    assert looks[0] == "1 processes"


def test_a_failure_is_told_in_a_sentence() -> None:
    with pytest.raises(StageError, match=r"torchrun ended with code 1: .*no_such_training"):
        train_together("no_such_training", [], 1, lambda share, words="": None)


def test_the_shipped_network_is_taken_where_its_training_would_be_repeated(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usual = settings_that_matter(Guide3dSettings())
    monkeypatch.setattr(shipped, "read_manifest", lambda folder: SimpleNamespace(config=usual))
    ours, rows = context(run, "shape", reads=("guide3d",)), ["spherical", "cartesian"]
    jobs = {job.key: job.given for job in shape.plan(ShapeSettings(shipped=True, rows=rows), ours)}
    assert {row: job.shipped for row, job in jobs.items()} == {"spherical": "shape", "cartesian": None}
    for other in ({"shipped": False}, {"pretrained": "vit.pt"}, {"epochs": 3}):
        assert shipped.shipped_rows(ShapeSettings(**{"shipped": True, **other}), ours) == {}
    training = train_network(replace(jobs["spherical"], folder=tmp_path), Report())
    assert training["best_epoch"] == len(training["rows"]) == 20
    assert ShapePredictor.load(tmp_path / "predictor.pt").metadata["form"] == "spherical"
