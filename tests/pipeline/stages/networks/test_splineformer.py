"""The stage splineformer: a tiny run with everything it leaves, what is kept, and bad settings."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from guide3d import shipped as shelf
from guide3d.learning.build import SEGMENTER_SIZES
from guide3d.learning.picture_store import Preprocessing
from guide3d.learning.predictor import SegmentationPredictor, built
from pipeline.jobs.worker import Report
from pipeline.plots.networks import draw_attention, draw_comparison, draw_errors
from pipeline.settings.kinds import settings_that_matter
from pipeline.stages import splineformer
from pipeline.stages import splineformer as splineformer_jobs
from pipeline.stages.guide3d.folder import Source
from pipeline.stages.guide3d.settings import Guide3dSettings
from pipeline.stages.networks import shipped as shipping
from pipeline.stages.networks import training as network_stage
from pipeline.stages.networks.settings import SplineformerSettings
from pipeline.stages.networks.shipped import shipped_rows
from pipeline.stages.splineformer import EXAMPLES, compare, learn_variant
from pipeline.store.errors import ConfigurationError, StageError
from splineformer.comparison.evaluation import ReadCurve, Reader
from splineformer.predictor import Predictor
from tests.guide3d.learning.drawn_data import draw
from tests.pipeline.stages.small_expert import context, in_this_process

READS = ("guide3d", "segmentation")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    draw(folder / "guide3d" / "dataset")
    Source("dataset").write(folder / "guide3d")
    size = {"name": "unet", "crop_px": 64, "sizes": SEGMENTER_SIZES["unet"]["smoke"]}
    (folder / "segmentation" / "unet").mkdir(parents=True)
    SegmentationPredictor(built(size), size, Preprocessing(128, 128), {}).save(
        folder / "segmentation" / "unet" / "predictor.pt"
    )
    return folder


SETTINGS = SplineformerSettings(
    variants=["published", "ordered"],
    size="smoke",
    device="cpu",
    disturbances=["none", "occlusion"],
    test_images=4,
    disturbed_images=2,
)


@pytest.fixture(scope="module")
def results(run: Path) -> dict:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(network_stage, "run_jobs", in_this_process)
        splineformer.run_splineformer(SETTINGS, context(run, "splineformer", reads=READS)).write(run / "splineformer")
    return json.loads((run / "splineformer" / "results.json").read_text())


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
    assert files == ["comparison.png", "errors.png", "attention.png", "training.png"]


def test_finished_jobs_are_kept(run: Path, results: dict, monkeypatch: pytest.MonkeyPatch) -> None:
    jobs = {job.key: job for job in splineformer.plan(SETTINGS, context(run, "splineformer", reads=READS))}
    assert jobs["comparison"].after == ("published", "ordered")
    monkeypatch.setattr("splineformer.learning.training_command.train", None)
    outcome = learn_variant(jobs["ordered"].given, Report())
    assert outcome["round_trip_px"] == results["splineformer_variants"]["ordered"]["round_trip_px"]
    monkeypatch.setattr("splineformer.comparison.evaluation.evaluate_readers", None)
    assert compare(jobs["comparison"].given, Report())["none"]["unet"]["n"] == 4


def test_a_missing_rival_is_told(run: Path, results: dict) -> None:
    settings = SplineformerSettings(variants=["ordered"], rival="swinunet")
    job = splineformer.plan(settings, context(run, "splineformer", reads=READS))[-1]
    with pytest.raises(StageError, match=r"swinunet.predictor.pt is missing"):
        compare(job.given, Report())


def test_wires_that_no_reader_finds_are_drawn(
    run: Path, results: dict, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    job = splineformer.plan(SETTINGS, context(run, "splineformer", reads=READS))[-1].given

    def blind(*given: Any) -> dict[str, Reader]:
        found = {name: lambda image, camera: ReadCurve(None) for name in job.variants}
        return {SETTINGS.rival: lambda image, camera: ReadCurve(None, 0, np.zeros(image.shape, np.uint8)), **found}

    monkeypatch.setattr(splineformer_jobs, "readers_of", blind)
    settings = replace(SETTINGS, disturbances=["none"])
    outcome = compare(replace(job, folder=tmp_path, settings=settings), Report())
    assert {read["read_pct"] for read in outcome["none"].values()} == {0.0}
    examples = tmp_path / EXAMPLES
    draw_comparison(examples, SETTINGS.rival, SETTINGS.variants, splineformer.LABELS, tmp_path / "comparison.png")
    draw_errors(outcome, splineformer.LABELS, tmp_path / "errors.png")
    draw_attention(examples, SETTINGS.variants, splineformer.LABELS, tmp_path / "attention.png")
    assert len(list(tmp_path.glob("*.png"))) == 3


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"variants": ["parallel"]}, "choose from published, ordered"),
        ({"variants": []}, "empty"),
        ({"size": "huge"}, "stage.size"),
        ({"size": "thesis_large"}, "variant published alone"),
        ({"disturbances": ["noise"]}, "must hold none"),
        ({"rival": "resnet"}, "choose from unet"),
        ({"test_images": -1}, "stage.test_images must be 0 or more"),
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
    monkeypatch.setattr(shipping, "read_manifest", lambda folder: SimpleNamespace(config=usual))
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
    monkeypatch.setattr("splineformer.learning.training_command.train", None)
    job = {job.key: job.given for job in splineformer.plan(SETTINGS, ours)}["ordered"]
    learn_variant(replace(job, folder=tmp_path / "ordered", shipped="ordered_simulated"), Report())
    assert (tmp_path / "ordered" / "predictor.pt").read_bytes() == file.read_bytes()
    assert json.loads((tmp_path / "ordered" / "training.json").read_text()) == training
