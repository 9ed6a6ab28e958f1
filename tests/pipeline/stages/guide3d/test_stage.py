"""The guide3d stage: its generator, a tiny data set with all it leaves, one's own data set, and bad input."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from guide3d.dataset.acquisition_split import COMPOSITION, plan_acquisitions
from guide3d.dataset.annotation_files import read_curves
from guide3d.dataset.cvat import read_cvat
from guide3d.dataset.dataset import Dataset
from guide3d.geometry.polyline import distances_to
from pipeline.jobs.worker import Report
from pipeline.stages.guide3d import stage as guide3d
from pipeline.stages.guide3d.figures import reconstruction_tables
from pipeline.stages.guide3d.folder import open_dataset
from pipeline.stages.guide3d.generator import TAKES, GenerationJob, assemble, cameras_of, generate
from pipeline.stages.guide3d.settings import Guide3dSettings
from pipeline.store.errors import ConfigurationError, StageError
from tests.guide3d.dataset.drawn_dataset import write_dataset
from tests.pipeline.stages.small_expert import run_here


@pytest.fixture(scope="module")
def generated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a stage that generated four pairs, distorted."""
    run = tmp_path_factory.mktemp("run")
    settings = Guide3dSettings(images=8, pairs=1, targets=["bca"], image_size_px=256, distorted=True)
    guide3d.check_guide3d(settings)
    run_here(settings, run, guide3d, ())
    return run / "guide3d"


@pytest.fixture
def own(tmp_path: Path) -> Path:
    root = tmp_path / "own"
    write_dataset(root, acquisitions=4, frames=2)
    return root


def run_own(root: Path, tmp_path: Path, **changed) -> Path:
    run_here(Guide3dSettings(root=str(root), **changed), tmp_path / "run", guide3d, ())
    return tmp_path / "run" / "guide3d"


def test_a_generated_run_leaves_data_curves_tables_and_figures(generated: Path) -> None:
    results = json.loads((generated / "results.json").read_text())
    assert results["guide3d_composition"]["total"] == {"with_fluid": 4, "without_fluid": 4, "total": 8}
    row = results["datasets"]["both/guide3d"]
    assert (row["frames"], row["source"]) == (8, "simulated phantom")
    assert set(results["guide3d_reprojection_px"]) == {"camera_a", "camera_b"}
    assert set(results["guide3d_simulated_validation_mm"]) == {"max_ed", "mete", "mers"}
    assert set(results["guide3d_simulated_ways_mm"]) == {"global", "greedy", "global, clicks", "greedy, clicks"}
    assert results["guide3d_reconstruction"]["global"]["n"] == 4
    data = open_dataset(generated)
    assert len(data) == 4
    assert data.undistorted is False
    curves = [frame.reconstruction_mm for frame in data.frames]
    errors = [np.linalg.norm(curve[0] - frame.curve_mm[0]) for curve, frame in zip(curves, data.frames, strict=True)]
    assert max(errors) < 1.0
    shown = {entry["file"] for entry in json.loads((generated / "figures.json").read_text())}
    assert shown == {"samples.png", "reprojection.png", "overlays.png", "space.png"}


def test_ones_own_data_set_is_read_where_it_lies(tmp_path: Path) -> None:
    own = tmp_path / "own"
    write_dataset(own, acquisitions=4, frames=1)
    before = {path: path.stat().st_mtime_ns for path in own.rglob("*")}
    folder = run_own(own, tmp_path, compared=3)
    assert before == {path: path.stat().st_mtime_ns for path in own.rglob("*")}
    results = json.loads((folder / "results.json").read_text())
    assert results["guide3d_composition"]["total"]["total"] == 8
    assert results["guide3d_reconstruction"]["global"]["n"] == 4
    assert results["guide3d_reconstruction"]["greedy"]["n"] == 3
    assert results["guide3d_reconstruction"]["global"]["accepted_pct"] == 100.0
    assert sum(frame.reconstruction_mm is not None for frame in open_dataset(folder).frames) == 4
    assert not (folder / "dataset").exists()


def test_annotations_alone_will_do(own: Path, tmp_path: Path) -> None:
    shutil.rmtree(own / "images")
    shutil.rmtree(own / "calibration")
    (own / "truth.json").unlink()
    (own / "sphere.json").unlink()
    folder = run_own(own / "raw.json", tmp_path)
    results = json.loads((folder / "results.json").read_text())
    assert set(results) == {"guide3d_composition", "datasets"}
    # where one's own images come from is not known here
    assert set(results["datasets"]["both/guide3d"]) == {"collection", "type", "frames"}
    assert json.loads((folder / "figures.json").read_text()) == []
    assert all(frame.reconstruction_mm is None for frame in open_dataset(folder).frames)


def test_residuals_tell_that_annotations_are_raw(generated: Path, tmp_path: Path, caplog) -> None:
    root = tmp_path / "own"
    shutil.copytree(generated / "dataset", root)
    (root / "dataset.json").unlink()
    caplog.set_level("INFO")
    folder = run_own(root, tmp_path, compared=1)
    assert Dataset.open(root).undistorted is None
    assert open_dataset(folder).undistorted is False
    assert [line for line in caplog.messages if "the annotations are raw" in line]


def test_swapped_and_missing_cameras_are_said(own: Path, tmp_path: Path) -> None:
    files = [own / "calibration" / f"projection_{name}.txt" for name in ("16709", "16710")]
    first, second = (file.read_bytes() for file in files)
    files[0].write_bytes(second)
    files[1].write_bytes(first)
    with pytest.raises(StageError, match="the cameras are swapped"):
        run_own(own, tmp_path)
    files[0].unlink()
    with pytest.raises(StageError, match="the file of camera B"):
        run_own(own, tmp_path)


def test_settings_say_what_is_wrong(own: Path, tmp_path: Path) -> None:
    for wrong, sentence in (
        ({"root": str(tmp_path / "nowhere")}, r"guide3d\.root=.*nowhere is missing"),
        ({"calibration": str(own)}, r"give guide3d\.root=PATH too"),
        ({"images": 9}, r"stage\.images must be even"),
        ({"targets": ["aorta"]}, "type_1 has no branch 'aorta'"),
    ):
        with pytest.raises(ConfigurationError, match=sentence):
            guide3d.check_guide3d(Guide3dSettings(**wrong))
    with pytest.raises(StageError, match="run stage=guide3d again"):
        open_dataset(tmp_path)


def test_an_edited_data_set_is_another_one(own: Path) -> None:
    before = Guide3dSettings(root=str(own)).root_sha256
    assert before == Guide3dSettings(root=str(own)).root_sha256
    (own / "raw.json").write_text((own / "raw.json").read_text().replace("[", "[ ", 1))
    edited = Guide3dSettings(root=str(own)).root_sha256
    assert before != edited
    images = own.parent / "images elsewhere"
    images.mkdir()
    (images / "1.png").write_bytes(b"one")
    apart = Guide3dSettings(root=str(own), image_root=str(images)).root_sha256
    assert apart != edited
    (images / "1.png").write_bytes(b"another")
    assert Guide3dSettings(root=str(own), image_root=str(images)).root_sha256 != apart


def test_failed_pairs_count_as_not_accepted() -> None:
    good = {
        "index": 0, "way": "global", "accepted": True, "cpu_s": 0.5, "mean_a_px": 1.0, "mean_b_px": 3.0,
        "coverage": 0.9, "tangent_share": 0.2, "along_a_px": [1.0] * 30, "along_b_px": [0.0] * 29 + [6.0],
    }  # fmt: skip
    bad = {"index": 1, "way": "global", "accepted": False, "reason": "nothing in common"}
    tables = reconstruction_tables([good, bad])
    assert tables["guide3d_reconstruction"]["global"]["accepted_pct"] == 50.0
    assert tables["guide3d_reconstruction"]["global"]["pairs_per_s"] == 2.0
    assert tables["guide3d_reprojection_px"]["camera_b"]["peak_mean"] == 6.0
    assert tables["guide3d_reprojection_px"]["camera_b"]["distal_mean"] == 0.0
    assert "guide3d_simulated_validation_mm" not in tables


SIZE = 256
SETTINGS = Guide3dSettings(image_size_px=SIZE, distorted=True)
CENTRE = (0.0, 0.0, 0.004)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data set with an acquisition of each kind."""
    folder = tmp_path_factory.mktemp("stage")
    plan = plan_acquisitions(24, 2, ["type_1"], ["bca"])
    kinds = {(one.fluid, one.wire): one for one in plan}
    chosen = tuple(kinds.values())
    result = generate(GenerationJob(folder, chosen, SETTINGS, CENTRE, 0), Report())
    assert result["pairs"] == sum(one.pairs for one in chosen)
    record = folder / TAKES / f"{chosen[0].name}.json"
    image = next((folder / "dataset" / "images").glob(f"{chosen[0].name}-2/000.png"))
    first = record.read_bytes(), image.read_bytes()
    record.unlink()  # as if killed before the end of this acquisition
    image.write_bytes(b"half")
    generate(GenerationJob(folder, chosen, SETTINGS, CENTRE, 0), Report())
    assert (record.read_bytes(), image.read_bytes()) == first
    assemble(folder, chosen, SETTINGS, CENTRE)
    assert assemble(folder, chosen, SETTINGS, CENTRE) == folder / "dataset"  # done already
    return folder / "dataset"


def test_truth_annotation_cameras_and_other_files_agree(made: Path) -> None:
    data = Dataset.open(made, strict=True)
    assert data.undistorted is False
    assert {(frame.fluid, frame.wire) for frame in data.frames} == set(COMPOSITION)
    for frame in data.frames:
        for view, camera in (("a", data.camera_a), ("b", data.camera_b)):
            assert camera is not None
            seen = camera.project(frame.visible_curve_mm(view))
            points = frame.polyline(view)
            assert distances_to(seen, data.undistort(view, points)).max() < 0.1
            assert distances_to(points, data.distort(view, seen)).max() < 0.1
            exact = {one.name: one for one in cameras_of(SETTINGS, CENTRE).values()}[view]
            assert distances_to(points, exact.pixels(1e-3 * frame.visible_curve_mm(view))).max() < 0.1
    exported = {one.label: one for one in read_cvat(made / "cvat.xml", [])}
    curves = read_curves(made / "b_spline.json", [])
    for frame in data.frames:
        assert np.array_equal(exported[frame.label].points_b, frame.polyline("b"))
        fitted = curves[frame.acquisition, frame.number].b.sample(300)
        assert distances_to(frame.polyline("b"), fitted).max() < 2.0  # clicks closer than 2 px are one


def test_the_annotation_lies_on_the_dark_wire(made: Path) -> None:
    data = Dataset.open(made)
    darker = []
    for frame in data.frames:
        image = frame.image("a").astype(float)
        points = frame.polyline("a")
        along = np.gradient(points, axis=0)
        across = np.column_stack([-along[:, 1], along[:, 0]]) / np.linalg.norm(along, axis=1, keepdims=True)

        def grey(at: np.ndarray, image: np.ndarray = image) -> np.ndarray:
            column, row = np.clip(at.round().astype(int), 0, SIZE - 1).T
            return image[row, column]

        beside = (grey(points + 4 * across) + grey(points - 4 * across)) / 2
        darker.append(np.median(beside - grey(points)))
    assert min(darker) > 4
