"""The stages shape, segmentation and splineformer: tiny runs with all they leave, what is kept, bad settings."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from guide3d import shipped as shelf
from guide3d.learning.predictor import ShapePredictor
from pipeline.jobs.worker import Report
from pipeline.plots.networks import draw_attention, draw_comparison
from pipeline.settings.kinds import settings_that_matter
from pipeline.stages import shape, splineformer
from pipeline.stages.guide3d.folder import Source
from pipeline.stages.guide3d.settings import Guide3dSettings
from pipeline.stages.networks import training as network_stage
from pipeline.stages.networks.settings import SegmentationSettings, ShapeSettings, SplineformerSettings
from pipeline.stages.networks.training import learn, shipped_rows, train_network
from pipeline.stages.splineformer import EXAMPLES, compare, learn_variant
from pipeline.store.errors import ConfigurationError, StageError
from splineformer.comparison.evaluation import ReadCurve, Reader
from splineformer.predictor import Predictor
from tests.enn.event_scalars import scalars
from tests.guide3d.learning.drawn_data import draw
from tests.pipeline.stages.small_expert import context, run_here


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    draw(folder / "guide3d" / "dataset")
    Source("dataset").write(folder / "guide3d")
    return folder


@pytest.fixture(scope="module")
def shapes(run: Path) -> dict:
    settings = ShapeSettings(rows=["spherical", "fgrn"], size="smoke", device="cpu")
    return run_here(settings, run, network_stage, ("guide3d",))


@pytest.fixture(scope="module")
def masks(run: Path) -> dict:
    settings = SegmentationSettings(rows=["unet", "swinunet"], size="smoke", device="cpu", test_images=4)
    return run_here(settings, run, network_stage, ("guide3d",))


def test_shape_leaves_networks_tables_and_figures(run: Path, shapes: dict) -> None:
    assert set(shapes["shape_prediction_mm"]) == {"spherical"}
    assert set(shapes["shape_networks"]) == {"spherical", "fgrn"}
    for cells in shapes["shape_networks"].values():
        assert cells["n"] == 4  # one acquisition of six
        assert cells["max_ed"][0] >= cells["mers"][0] > 0
        assert cells["frechet"][0] >= cells["chamfer"][0] > 0
    figures = json.loads((run / "shape" / "figures.json").read_text())
    assert len(figures) == 3
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
    assert len(json.loads((run / "segmentation" / "figures.json").read_text())) == 2


def test_a_finished_network_is_kept(run: Path, shapes: dict, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = ShapeSettings(rows=["fgrn"], size="smoke", device="cpu")
    job = shape.plan(settings, context(run, "shape", reads=("guide3d",)))[0].given
    monkeypatch.setattr("guide3d.train.train_command", None)
    assert learn(job, Report())["max_ed"] == shapes["shape_networks"]["fgrn"]["max_ed"]


def test_a_training_without_its_data_set_or_its_weights_says_so(run: Path, tmp_path: Path) -> None:
    settings = ShapeSettings(rows=["spherical"], size="smoke")
    job = shape.plan(settings, context(tmp_path, "shape", reads=("guide3d",)))[0].given
    with pytest.raises(StageError, match="run stage=guide3d again"):
        train_network(job, Report())
    shutil.copytree(run / "guide3d", tmp_path / "guide3d")
    shutil.rmtree(tmp_path / "guide3d" / "dataset")
    with pytest.raises((StageError, FileNotFoundError), match="is missing"):
        train_network(job, Report())
    settings = replace(settings, pretrained=str(tmp_path / "vit.pt"))
    job = shape.plan(settings, context(run, "elsewhere", reads=("guide3d",)))[0].given
    with pytest.raises(FileNotFoundError, match="there are no pretrained weights"):
        train_network(job, Report())


@pytest.mark.parametrize(
    ("kind", "rows", "sentence"),
    [
        (ShapeSettings, ["unet"], "stage.rows has no 'unet'"),
        (ShapeSettings, [], "stage.rows is empty"),
        (SegmentationSettings, ["vnet"], "stage.rows has no 'vnet'"),
    ],
)
def test_rows_are_checked(kind: type, rows: list[str], sentence: str) -> None:
    with pytest.raises(ConfigurationError, match=sentence):
        kind(rows=rows)


def test_settings_know_what_the_package_trains() -> None:
    from guide3d.learning.build import SIZES
    from guide3d.train import NETWORKS
    from pipeline.stages.networks.settings import NETWORK_SIZES, SEGMENTATION_ROWS, SHAPE_ROWS

    assert set(SHAPE_ROWS) | set(SEGMENTATION_ROWS) == set(NETWORKS)
    assert NETWORK_SIZES == SIZES


def test_a_shipped_network_is_taken_in_place_of_its_training(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usual = settings_that_matter(Guide3dSettings())
    monkeypatch.setattr(network_stage, "read_manifest", lambda folder: SimpleNamespace(config=usual))
    ours, rows = context(run, "shape", reads=("guide3d",)), ["spherical", "cartesian"]
    jobs = {job.key: job.given for job in shape.plan(ShapeSettings(shipped=True, rows=rows), ours)}
    assert {row: job.shipped for row, job in jobs.items()} == {"spherical": "shape", "cartesian": None}
    for other in ({"shipped": False}, {"pretrained": "vit.pt"}, {"epochs": 3}):
        assert shipped_rows(ShapeSettings(**{"shipped": True, **other}), ours) == {}
    training = train_network(replace(jobs["spherical"], folder=tmp_path), Report())
    assert training["best_epoch"] == len(training["rows"]) == 20
    assert ShapePredictor.load(tmp_path / "predictor.pt").metadata["form"] == "spherical"


READS = ("guide3d", "segmentation")


SMALL = {"size": "smoke", "device": "cpu", "test_images": 4, "disturbed_images": 2}
SETTINGS = SplineformerSettings(variants=["published", "ordered"], disturbances=["none", "occlusion"], **SMALL)


@pytest.fixture(scope="module")
def results(run: Path, masks: dict) -> dict:
    return run_here(SETTINGS, run, network_stage, READS)


def test_tables_and_figures(run: Path, results: dict) -> None:
    compared = results["splineformer_segmentation"]
    assert set(compared) == {
        f"{kind}/{name}" for kind in ("none", "occlusion") for name in ("unet", "published", "ordered")
    }
    for name, cells in compared.items():
        assert cells["n"] == (4 if name.startswith("none") else 2)
        if "tip_px" in cells:
            assert cells["max_px"][0] >= cells["mean_px"][0] > 0
            assert cells["max_mm"][0] > cells["max_px"][0]  # a pixel is 1.5 mm in the drawn data
        if not name.endswith("unet"):
            assert cells["discontinuities"] == 0
    alone = results["splineformer_variants"]
    assert set(alone) == {"published", "ordered"}
    for cells in alone.values():
        assert cells["round_trip_px"] < 0.5
        assert cells["tokens_max"] <= 23
        assert cells["latency_ms"] > 0
    files = [entry["file"] for entry in json.loads((run / "splineformer" / "figures.json").read_text())]
    assert files == ["comparison.png", "attention.png"]


def test_finished_jobs_are_kept_and_a_missing_rival_is_told(
    run: Path, results: dict, monkeypatch: pytest.MonkeyPatch
) -> None:
    jobs = {job.key: job for job in splineformer.plan(SETTINGS, context(run, "splineformer", reads=READS))}
    assert jobs["comparison"].after == ("published", "ordered")
    monkeypatch.setattr("splineformer.learning.training.train_command", None)
    outcome = learn_variant(jobs["ordered"].given, Report())
    assert outcome["round_trip_px"] == results["splineformer_variants"]["ordered"]["round_trip_px"]
    monkeypatch.setattr("splineformer.comparison.evaluation.evaluate_readers", None)
    assert compare(jobs["comparison"].given, Report())["none"]["unet"]["n"] == 4
    settings = SplineformerSettings(variants=["ordered"], rival="transunet")
    job = splineformer.plan(settings, context(run, "splineformer", reads=READS))[-1]
    with pytest.raises(StageError, match=r"transunet.predictor.pt is missing"):
        compare(job.given, Report())


def test_wires_that_no_reader_finds_are_drawn(
    run: Path, results: dict, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    job = splineformer.plan(SETTINGS, context(run, "splineformer", reads=READS))[-1].given

    def blind(*given: Any) -> dict[str, Reader]:
        found = {name: lambda image, camera: ReadCurve(None) for name in job.variants}
        return {SETTINGS.rival: lambda image, camera: ReadCurve(None, 0, np.zeros(image.shape, np.uint8)), **found}

    monkeypatch.setattr(splineformer, "readers_of", blind)
    settings = replace(SETTINGS, disturbances=["none"])
    outcome = compare(replace(job, folder=tmp_path, settings=settings), Report())
    assert {read["read_pct"] for read in outcome["none"].values()} == {0.0}
    examples = tmp_path / EXAMPLES
    draw_comparison(examples, SETTINGS.rival, SETTINGS.variants, splineformer.LABELS, tmp_path / "comparison.png")
    draw_attention(examples, SETTINGS.variants, splineformer.LABELS, tmp_path / "attention.png")
    assert len(list(tmp_path.glob("*.png"))) == 2


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"variants": []}, "empty"),
        ({"size": "thesis_large"}, "variant published alone"),
        ({"disturbances": ["noise"]}, "must hold none"),
    ],
)
def test_bad_settings(wrong: dict, message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        SplineformerSettings(**({"variants": ["ordered", "published"]} | wrong))


def test_a_shipped_network_is_taken_where_its_training_would_be_repeated(
    run: Path, results: dict, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ours = context(run, "splineformer", reads=READS)
    desk = SplineformerSettings(shipped=True)
    usual = settings_that_matter(Guide3dSettings())
    monkeypatch.setattr(network_stage, "read_manifest", lambda folder: SimpleNamespace(config=usual))
    assert shipped_rows(desk, ours) == {"ordered": "ordered_simulated"}
    for other in (replace(desk, shipped=False), replace(desk, epochs=2), replace(desk, size="smoke")):
        assert shipped_rows(other, ours) == {}
    assert shipped_rows(desk, replace(ours, seed=ours.seed + 1)) == {}
    jobs = {job.key: job.given for job in splineformer.plan(desk, ours)}
    assert (jobs["ordered"].shipped, jobs["published"].shipped) == ("ordered_simulated", None)
    usual = usual | {"images": 100}
    assert shipped_rows(desk, ours) == {}

    trained = run / "splineformer" / "ordered"
    training = json.loads((trained / "training.json").read_text())
    weights = tmp_path / "splineformer.weights"
    weights.mkdir()
    file = weights / "ordered_simulated.pt"
    Predictor.load(trained / "predictor.pt").save(file, training=json.dumps(training))
    monkeypatch.setattr(shelf, "files", lambda package: tmp_path / package)
    monkeypatch.setattr("splineformer.learning.training.train_command", None)
    job = {job.key: job.given for job in splineformer.plan(SETTINGS, ours)}["ordered"]
    learn_variant(replace(job, folder=tmp_path / "ordered", shipped="ordered_simulated"), Report())
    assert (tmp_path / "ordered" / "predictor.pt").read_bytes() == file.read_bytes()
    assert json.loads((tmp_path / "ordered" / "training.json").read_text()) == training
