"""The generator of bi-planar data sets: composition, annotations, motions, and a tiny set whose pieces agree."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from guide3d.dataset.annotation_files import read_curves
from guide3d.dataset.cvat import read_cvat
from guide3d.dataset.dataset import Dataset
from guide3d.geometry.polyline import arc_length
from guide3d.reconstruction.reprojection import distances_to
from pipeline.jobs.worker import Report
from pipeline.stages.guide3d.annotation import annotated, in_view, thinned_by_turning
from pipeline.stages.guide3d.generator import TAKES, GenerationJob, Studio, assemble, cameras_of, generate
from pipeline.stages.guide3d.plan import COMPOSITION, composition, plan_acquisitions
from pipeline.stages.guide3d.wire_motions import MAX_ADVANCE, MAX_TURN, MOTIONS, Hand

SIZE = 256


def test_composition_is_the_thesiss() -> None:
    assert composition(8746) == {kind: count // 2 for kind, count in COMPOSITION.items()}
    for images in (8, 40, 2400):
        counts = composition(images)
        assert sum(counts.values()) == images // 2
        assert min(counts.values()) >= 1
    assert composition(2400)[True, "angled"] == round(1200 * 3664 / 8746)


def test_a_plan_names_every_acquisition_once_and_repeats_itself() -> None:
    plan = plan_acquisitions(2400, 13, ["type_1", "type_2"], ["bca", "lsa"], 4, seed=3)
    assert len({one.name for one in plan}) == len(plan)
    assert sum(one.script.shapes for one in plan) == 1200
    assert max(one.script.shapes for one in plan) <= 13
    assert {one.script.target for one in plan} == {"bca", "lsa"}
    assert {one.script.phantom for one in plan} == {"type_1", "type_2"}
    assert plan == plan_acquisitions(2400, 13, ["type_1", "type_2"], ["bca", "lsa"], 4, seed=3)
    other = plan_acquisitions(2400, 13, ["type_1", "type_2"], ["bca", "lsa"], 4, seed=4)
    assert not {one.script.seed for one in plan} & {one.script.seed for one in other}


def hook(count: int = 2000) -> np.ndarray:
    """(count, 2) px: a straight stretch and a tight bend of 12 px radius."""
    bend = np.pi * np.linspace(0.0, 1.0, count // 2)
    return np.concatenate(
        [
            np.column_stack([50 + 12 * np.sin(bend[::-1]), 40 - 12 * np.cos(bend[::-1])]),
            np.column_stack([np.linspace(50, -30, count // 2), np.full(count // 2, 28.0)]),
        ]
    )


def test_exact_annotations_stay_within_a_tenth_of_a_pixel() -> None:
    wire = hook()
    points = annotated(wire, 0.0, SIZE, np.random.default_rng(0))
    assert distances_to(points, wire).max() < 0.1
    assert np.array_equal(points[[0, -1]], wire[[0, -1]])
    assert len(points) < 60


def test_clicks_are_apart_noisy_and_reach_both_ends() -> None:
    wire = np.column_stack([np.linspace(10.0, 240.0, 4000), np.full(4000, 100.0)])
    drawn = [annotated(wire, 1.0, SIZE, np.random.default_rng(seed)) for seed in range(200)]
    assert np.array_equal(drawn[3], annotated(wire, 1.0, SIZE, np.random.default_rng(3)))
    assert all(8 <= len(points) <= 17 for points in drawn)
    off = np.concatenate([points[:, 1] - 100.0 for points in drawn])
    assert off.std() == pytest.approx(1.0, abs=0.06)
    ends = np.array([points[[0, -1], 0] for points in drawn])
    assert np.abs(ends.mean(axis=0) - [10.0, 240.0]).max() < 0.25
    bent = hook() + np.array([40.0, 0.0])
    assert distances_to(annotated(bent, 1e-9, SIZE, np.random.default_rng(0)), bent).max() < 1.5  # closer in a bend


def test_a_curve_is_cut_where_it_leaves_the_image() -> None:
    wire = hook()
    view = in_view(wire, arc_length(wire), SIZE)
    assert view is not None
    assert view.points[-1] == pytest.approx([0.0, 28.0])
    assert view.visible == pytest.approx(12 * np.pi + 50, abs=1e-3)
    assert in_view(wire[::-1], arc_length(wire), SIZE) is None
    whole = in_view(wire + np.array([40.0, 0.0]), arc_length(wire), SIZE)
    assert whole is not None
    assert len(whole.points) == len(wire)


def test_thinning_holds_its_bound_in_space() -> None:
    t = np.linspace(0.0, 4 * np.pi, 5000)
    helix = np.column_stack([20 * np.cos(t), 20 * np.sin(t), 5 * t])
    kept = thinned_by_turning(helix, 5.0, 0.05)
    assert distances_to(kept, helix).max() < 5.0 * 0.05 / 32 + 1e-3
    assert len(kept) < 500


@pytest.mark.parametrize("motion", MOTIONS)
def test_a_hand_keeps_to_what_a_hand_can_do(motion: str) -> None:
    moves = []
    for _ in range(2):
        hand = Hand(motion, np.random.default_rng(5))
        moves.append(np.array([hand.move() for _ in range(2000)]))
    assert np.array_equal(*moves)
    assert np.abs(moves[0][:, 0]).max() <= MAX_ADVANCE
    assert np.abs(moves[0][:, 1]).max() <= MAX_TURN
    assert np.sign(moves[0][:, 0].mean()) == (-1 if motion == "withdraw" else 1)


def studio(**changed) -> Studio:
    values = {"centre": (0.0, 0.0, 0.004), "image_size_px": SIZE, "distorted": True, "annotation_noise_px": 0.0,
              "filling": "fluid"}  # fmt: skip
    return Studio(**{**values, **changed})


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data set with an acquisition of each kind."""
    folder = tmp_path_factory.mktemp("stage")
    plan = plan_acquisitions(24, 2, ["type_1"], ["bca"], 4, 0)
    kinds = {(one.fluid, one.script.wire): one for one in plan}
    chosen = tuple(kinds.values())
    result = generate(GenerationJob(folder, chosen, studio()), Report())
    assert result["pairs"] == sum(one.script.shapes for one in chosen)
    record = folder / TAKES / f"{chosen[0].name}.json"
    image = next((folder / "dataset" / "images").glob(f"{chosen[0].name}-2/000.png"))
    first = record.read_bytes(), image.read_bytes()
    record.unlink()  # as if killed before the end of this acquisition
    image.write_bytes(b"half")
    generate(GenerationJob(folder, chosen, studio()), Report())
    assert (record.read_bytes(), image.read_bytes()) == first
    assemble(folder, chosen, studio())
    assert assemble(folder, chosen, studio()) == folder / "dataset"  # done already
    return folder / "dataset"


def test_truth_annotation_and_cameras_agree(made: Path) -> None:
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
            exact = {one.name: one for one in cameras_of(studio()).values()}[view]
            assert distances_to(points, exact.pixels(1e-3 * frame.visible_curve_mm(view))).max() < 0.1


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


def test_other_files_hold_the_same(made: Path) -> None:
    data = Dataset.open(made)
    exported = {one.label: one for one in read_cvat(made / "cvat.xml", [])}
    curves = read_curves(made / "b_spline.json", [])
    for frame in data.frames:
        assert np.array_equal(exported[frame.label].points_b, frame.polyline("b"))
        fitted = curves[frame.acquisition, frame.number].b.sample(300)
        assert distances_to(frame.polyline("b"), fitted).max() < 2.0  # clicks closer than 2 px are one


def test_undistorted_cameras_differ_only_in_distortion() -> None:
    raw, ideal = cameras_of(studio()), cameras_of(studio(distorted=False))
    point = np.array([[0.02, 0.01, -0.03]])
    for name in ("a", "b"):
        assert np.allclose(raw[name].projector.P, ideal[name].projector.P)
        assert np.allclose(ideal[name].pixels(point), ideal[name].projector.project(point))
        assert np.abs(raw[name].pixels(point) - ideal[name].pixels(point)).max() > 0.05
