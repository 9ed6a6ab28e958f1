"""The stage splineformer: a tiny run with everything it leaves, what is kept, and bad settings."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from guide3d.learning.build import SEGMENTER_SIZES
from guide3d.learning.predictor import SegmentationPredictor, built
from guide3d.learning.preprocessing import Preprocessing
from pipeline.jobs.worker import Report
from pipeline.report.plots.splineformer import draw_attention, draw_comparison, draw_errors
from pipeline.stages import splineformer
from pipeline.stages.guide3d.folder import Source, open_dataset
from pipeline.stages.networks import comparison as splineformer_comparison
from pipeline.stages.networks.comparison import EXAMPLES, Reader, compare, mm_per_px
from pipeline.stages.networks.splineformer import learn_variant
from pipeline.stages.networks.splineformer_settings import SplineformerSettings
from pipeline.store.errors import ConfigurationError, StageError
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
        patch.setattr(splineformer, "run_jobs", in_this_process)
        splineformer.run_splineformer(SETTINGS, context(run, "splineformer", reads=READS))
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
    monkeypatch.setattr("splineformer.train.train", None)
    told = learn_variant(jobs["ordered"].given, Report())
    assert told["round_trip_px"] == results["splineformer_variants"]["ordered"]["round_trip_px"]
    monkeypatch.setattr("pipeline.stages.networks.comparison._under", None)
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
        found = {name: lambda image, camera: (None, 0, None) for name in job.variants}
        return {job.rival: lambda image, camera: (None, 0, np.zeros(image.shape, np.uint8)), **found}

    monkeypatch.setattr(splineformer_comparison, "_readers", blind)
    outcome = compare(replace(job, folder=tmp_path, disturbances=("none",)), Report())
    assert {told["read_pct"] for told in outcome["none"].values()} == {0.0}
    examples = tmp_path / EXAMPLES
    draw_comparison(examples, job.rival, SETTINGS.variants, splineformer.LABELS, tmp_path / "comparison.png")
    draw_errors(outcome, splineformer.LABELS, tmp_path / "errors.png")
    draw_attention(examples, SETTINGS.variants, splineformer.LABELS, tmp_path / "attention.png")
    assert len(list(tmp_path.glob("*.png"))) == 3


def test_scale(run: Path) -> None:
    data = open_dataset(run / "guide3d")
    frame = data.frames[0]
    scale = mm_per_px(frame, data.camera_a)
    pixels = np.diff(data.camera_a.project(frame.curve_mm), axis=0)
    lengths = np.diff(frame.curve_mm[:, :2], axis=0)
    assert scale == pytest.approx(
        np.linalg.norm(lengths, axis=1).sum() / np.linalg.norm(pixels, axis=1).sum(), rel=0.05
    )
    assert mm_per_px(frame, None) is None


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
