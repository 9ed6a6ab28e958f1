"""Variants of a surface for the benchmark of imports: what each changes and keeps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from benchmarks.anatomy import volume_variants
from benchmarks.anatomy.variants import CHANGES, VARIANTS, Surface, is_right, write_variant
from benchmarks.anatomy.volume_variants import write_volume_variant
from cathsim.anatomy.mesh.parts.vessel_parts import read_parts


@pytest.fixture(scope="module")
def sphere() -> Surface:
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=10.0)
    return np.add(mesh.vertices, [3.0, 5.0, 7.0]), np.asarray(mesh.faces, np.int64)


def changed(name: str, surface: Surface) -> trimesh.Trimesh:
    return trimesh.Trimesh(*CHANGES[name](surface, np.random.default_rng(0)), process=False)


def test_what_each_variant_keeps(sphere: Surface) -> None:
    whole = trimesh.Trimesh(*sphere, process=False)
    for name in ("rotated", "mirrored", "subdivided"):
        assert changed(name, sphere).volume == pytest.approx(whole.volume, rel=1e-3), name
    assert changed("flipped", sphere).volume == pytest.approx(-whole.volume)
    assert changed("mirrored", sphere).centroid == pytest.approx([-3.0, 5.0, 7.0], abs=1e-6)
    assert np.linalg.norm(changed("rotated", sphere).centroid) == pytest.approx(np.linalg.norm([3.0, 5.0, 7.0]))
    assert len(changed("subdivided", sphere).faces) == 4 * len(sphere[1])
    assert len(changed("torn", sphere).faces) == pytest.approx(0.99 * len(sphere[1]), rel=0.005)
    coarse = changed("decimated", sphere)
    assert 0.05 * len(sphere[1]) < len(coarse.faces) <= 0.1 * len(sphere[1])
    assert coarse.volume == pytest.approx(whole.volume, rel=0.1)


def test_files_are_in_the_unit_and_keep_the_names_of_parts(sphere: Surface, tmp_path: Path) -> None:
    trimesh.Trimesh(*sphere).export(tmp_path / "one.stl")
    (part,) = read_parts(write_variant(tmp_path / "one.stl", "cm", "mm", tmp_path, 0)).parts
    assert part.mesh.extent == pytest.approx(2.0, rel=0.01)
    scene = trimesh.Scene()
    for name, aside in (("aorta", 0.0), ("left common carotid artery", 15.0)):
        scene.add_geometry(trimesh.Trimesh(sphere[0] + aside, sphere[1]), node_name=name, geom_name=name)
    scene.export(tmp_path / "two.glb")
    parts = read_parts(write_variant(tmp_path / "two.glb", "torn", "mm", tmp_path, 0)).parts
    assert {part.name for part in parts} == {"aorta", "lcca"}
    assert set(CHANGES) < set(VARIANTS)


@pytest.mark.parametrize(
    ("row", "variant", "right"),
    [
        ({}, "torn", True),
        ({"ok": False}, "torn", False),
        ({"branches": ["bca", "lcca"]}, "torn", False),
        ({"places_mm": {"bca": [0.0, 9.0, 0.0], "lcca": [0.0, 9.0, 26.0]}}, "rotated", True),
        ({"places_mm": {"bca": [0.0, 0.0, 0.0], "lcca": [36.0, 0.0, 0.0]}}, "rotated", False),
        ({"branches": ["bca", "branch_1"]}, "mirrored", False),
        ({"branches": ["bca", "branch_1"], "notes": ["the arch is the mirror image of a usual one"]}, "mirrored", True),
    ],
)
def test_right_is_what_has_the_branches_or_says_that_it_is_mirrored(row: dict, variant: str, right: bool) -> None:
    places = {"bca": [0.0, 0.0, 0.0], "lcca": [30.0, 0.0, 0.0]}
    original = {"ok": True, "branches": ["bca", "lcca", "lsa"], "notes": [], "places_mm": places}
    assert is_right({**original, **row}, original, variant) is right


def test_variants_of_labels_lie_where_they_should(tmp_path: Path) -> None:
    nibabel = pytest.importorskip("nibabel", reason="label volumes need nibabel")
    labels = np.zeros((20, 30, 40), np.uint8)
    labels[4:16, 6:26, 10:30] = 52
    affine = np.diag([0.7, 0.7, 2.0, 1.0])
    affine[:3, 3] = 5.0, -20.0, 3.0
    image = nibabel.Nifti1Image(labels, affine)
    image.header.set_xyzt_units("mm")
    nibabel.save(image, tmp_path / "labels.nii.gz")
    middle = affine[:3, :3] @ [9.5, 15.5, 19.5] + affine[:3, 3]
    for variant in volume_variants.VARIANTS:
        (tmp_path / variant).mkdir()
        found = nibabel.load(write_volume_variant(tmp_path / "labels.nii.gz", variant, tmp_path / variant, 0))
        values, where = np.asarray(found.dataobj), found.affine
        voxels = np.argwhere(values > 0)
        assert set(np.unique(values)) == {0, 52}
        centre = where[:3, :3] @ voxels.mean(axis=0) + where[:3, 3]
        scale = {"m": 1e-3, "micron": 1e3}.get(variant, 1.0)
        assert found.header.get_xyzt_units()[0] == {"m": "meter", "micron": "micron"}.get(variant, "mm")
        volume = len(voxels) * abs(np.linalg.det(where[:3, :3])) / scale**3
        assert volume == pytest.approx(4704, rel=0.02 if variant == "torn" else 1e-4), variant
        if variant == "rotated":
            assert np.linalg.norm(centre) == pytest.approx(np.linalg.norm(middle), rel=1e-4)
        else:
            expected = middle * ([-1, 1, 1] if variant == "mirrored" else [1, 1, 1]) * scale
            assert centre == pytest.approx(expected, rel=0.05 if variant in ("torn", "decimated") else 1e-4), variant
