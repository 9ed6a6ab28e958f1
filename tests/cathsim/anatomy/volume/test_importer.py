"""Phantoms from label volumes of a generated arch, against that arch."""

import json
import pickle
from pathlib import Path

import numpy as np
import pytest

from cathsim.anatomy import Phantom, import_anatomy, load_phantom
from cathsim.anatomy.importing import _load
from cathsim.anatomy.library import phantom_from_spec, phantom_to_spec
from cathsim.anatomy.lumen import build_lumen
from cathsim.anatomy.mesh.report import MeshRefusedError
from cathsim.anatomy.surface import open_ends
from cathsim.anatomy.vessel_tree import nearest_on_branch
from cathsim.anatomy.volume.importer import _volume_notes
from tests.cathsim.anatomy.generator.drawn_arch import arch_tree
from tests.cathsim.anatomy.lumen_report import check_lumen
from tests.cathsim.anatomy.volume.rasterising import IDS, oblique, rasterise, save_nifti, save_slicer

nibabel = pytest.importorskip("nibabel", reason="label volumes need nibabel")
pytest.importorskip("nrrd", reason="label volumes need pynrrd")

COARSE = 1.5e-3  # m: fast, and as fine as the walls of these arches need
UPSIDE_DOWN = np.array([1.0, -1.0, -1.0])
LONG_NAMES = {
    52: "aorta", 54: "brachiocephalic_trunk", 56: "subclavian_artery_left", 58: "common_carotid_artery_left",
}  # fmt: skip
REAL = Path(__file__).parents[5] / "shared" / "real" / "aortas"


def in_patient(phantom: Phantom, points: np.ndarray) -> np.ndarray:
    """Points (n, 3) m of an imported phantom in the axes of the volume's patient, whose origin the file keeps."""
    return points - np.array(phantom.imported.offset)


def away_from_ends(phantom: Phantom, truth: Phantom) -> np.ndarray:
    """Which vertices (n,) of an imported phantom's surface are far from the true open ends."""
    vertices = in_patient(phantom, phantom.lumen_mesh.vertices)
    ends = [np.linalg.norm(vertices - centre, axis=1) < radius + 5e-3 for centre, _, radius in open_ends(truth.tree)]
    return ~np.any(ends, axis=0)


def compare(phantom: Phantom, truth: Phantom, *, centreline: float = 1e-3, volume: float = 0.03) -> None:
    """Names, places of centrelines, wall and volume of an imported phantom against the arch it was made of."""
    assert set(phantom.tree.names) == set(truth.tree.names)
    for branch in truth.tree:
        found = phantom.tree[branch.name]
        points = in_patient(phantom, found.points)
        if branch.parent is not None:
            outside = 1.5 * truth.tree[branch.parent].radius_at(branch.parent_arc)
            points = points[np.linalg.norm(points - branch.points[0], axis=1) > outside]
        _, arc, away = nearest_on_branch(branch, points)
        middle = (arc > (0.1 if branch.parent in (None, "aorta") else 0.3) * branch.length) & (
            arc < 0.9 * branch.length
        )
        assert np.percentile(away[middle], 95) < centreline, branch.name
        assert 0.75 * branch.length < found.length < 1.35 * branch.length, branch.name
    off = truth.grid.sample(in_patient(phantom, phantom.lumen_mesh.vertices)[away_from_ends(phantom, truth)])
    assert abs(off.mean()) < 2e-4
    assert np.percentile(np.abs(off), 95) < 7e-4
    assert phantom.lumen_mesh.volume == pytest.approx(truth.lumen_mesh.volume, rel=volume)


def finer_upside_down(labels: np.ndarray, affine: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The labels by voxels of half the width, after half a turn about the axis from right to left."""
    halves = affine @ np.diag([0.5, 0.5, 1.0, 1.0])
    halves[:, 3] = affine @ [-0.25, -0.25, 0.0, 1.0]
    return labels.repeat(2, 0).repeat(2, 1), np.diag([*UPSIDE_DOWN, 1.0]) @ halves


@pytest.fixture(scope="module")
def drawn() -> Phantom:
    """A small arch with three branches."""
    tree = arch_tree(0.045)
    return Phantom("drawn", "0" * 32, None, tree, build_lumen(tree, resolution=1e-3, fillet_radius=2e-3), {}, {})


@pytest.fixture(scope="module")
def thick(tmp_path_factory: pytest.TempPathFactory, phantom: Phantom) -> Path:
    labels, affine = rasterise(phantom)
    return save_nifti(tmp_path_factory.mktemp("volumes") / "scan.nii.gz", labels, affine)


@pytest.fixture(scope="module")
def imported(thick: Path, cache: Path) -> Phantom:
    return import_anatomy(thick, resolution=COARSE, cache_dir=cache)


def test_thick_slices_become_the_arch_they_were_made_of(imported: Phantom, phantom: Phantom) -> None:
    compare(imported, phantom)
    # steps of slices are not felt
    mesh, kept = imported.lumen_mesh, away_from_ends(imported, phantom)
    true = -phantom.grid.gradient(in_patient(imported, mesh.vertices)[kept])
    true /= np.linalg.norm(true, axis=1, keepdims=True)
    angle = np.degrees(np.arccos(np.clip((true * mesh.vertex_normals[kept]).sum(axis=1), -1, 1)))
    assert np.median(angle) < 3
    assert np.percentile(angle, 95) < 12  # a staircase of voxels has 45 to 90
    report = imported.imported
    assert not any("repeat" in note or "heart" in note or "by the file's axes" in note for note in report.notes)
    assert report.rotation == ((-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0))
    voxels, lumen = (sum(pair[n] for pair in report.volumes_ml.values()) for n in (0, 1))
    assert lumen == pytest.approx(voxels, rel=0.03)
    assert "TotalSegmentator 2" in report.kind
    assert check_lumen(imported, required_radius=1e-3) == []


def test_a_folder_with_bridges_and_gaps(tmp_path: Path, drawn: Phantom, cache: Path) -> None:
    labels, affine = rasterise(drawn, spacing=(1e-3, 1e-3, 2e-3), cut=0.02)
    lcca, lsa = labels == IDS["lcca"], labels == IDS["lsa"]
    # a bridge of one voxel's width between two vessels, and a gap of one slice in one
    k = int(np.flatnonzero(lcca.any(axis=(0, 1)) & lsa.any(axis=(0, 1)))[-3])
    a, b = np.argwhere(lcca[:, :, k]).mean(axis=0), np.argwhere(lsa[:, :, k]).mean(axis=0)
    for share in np.linspace(0, 1, 200):
        i, j = np.rint(a + share * (b - a)).astype(int)
        if not labels[i, j, k]:
            labels[i, j, k] = IDS["lcca"] if share < 0.5 else IDS["lsa"]
    gap = int(np.quantile(np.flatnonzero((labels == IDS["bca"]).any(axis=(0, 1))), 0.6))
    labels[:, :, gap][labels[:, :, gap] == IDS["bca"]] = 0
    folder = tmp_path / "patient"
    folder.mkdir()
    for value, name in LONG_NAMES.items():
        save_nifti(folder / f"{name}.nii.gz", (labels == value).astype(np.uint8), affine)
    save_nifti(folder / "liver.nii.gz", np.zeros_like(labels), affine)
    found = import_anatomy(folder, names={"lcca": "left"}, resolution=COARSE, cache_dir=cache)
    assert set(found.tree.names) == {"aorta", "bca", "left", "lsa"}
    assert "left" in found.targets
    notes = " ".join(found.imported.notes)
    assert "in bca is closed" in notes
    assert "aorta's lower end is cut off by the volume's edge" in notes
    # the way from one to the other is that through the arch, not over the bridge
    way = found.geodesic_distance(found.targets["lsa"].position, "left")
    assert way > 0.06
    assert check_lumen(found, required_radius=1e-3) == []


def test_a_carotid_of_a_trunk_and_a_trunks_fork_by_finer_voxels_upside_down(tmp_path: Path, cache: Path) -> None:
    """The carotid's label touches the aorta, too, along its side."""
    truth = load_phantom("random_scan", seed=2150, resolution=COARSE)
    file = save_nifti(tmp_path / "trunk.nii.gz", *finer_upside_down(*rasterise(truth)))
    found = import_anatomy(file, resolution=COARSE, cache_dir=cache)
    notes = "; ".join(found.imported.notes)
    assert "voxels repeat each other" in notes
    assert "the heart at the other end of the aorta" in notes
    assert "by the file's axes its arch points to the feet" in notes
    assert {branch.name: branch.parent for branch in found.tree} == {
        branch.name: branch.parent for branch in truth.tree
    }
    for name in ("rsa", "rcca", "lcca"):
        take_off = UPSIDE_DOWN * in_patient(found, found.tree[name].points[:1])[0]
        assert np.linalg.norm(take_off - truth.tree[name].points[0]) < 5e-3, name
    # there is a wall between the carotid and the aorta beside it
    carotid = truth.tree["lcca"].points[5:60]
    aorta = nearest_on_branch(truth.tree["aorta"], carotid)[0]
    way = np.concatenate([carotid + share * (aorta - carotid) for share in np.linspace(0, 1, 61)])
    before, after = (
        grid.sample(places).reshape(61, -1).min(axis=0)
        for grid, places in ((truth.grid, way), (found.grid, UPSIDE_DOWN * way + found.imported.offset))
    )
    assert (before < -5e-4).sum() > 20
    assert (after[before < -5e-4] < 0).all()


@pytest.mark.slow
def test_first_stretches_of_vessels_in_the_aortas_label(tmp_path: Path, drawn: Phantom, cache: Path) -> None:
    """In an oblique volume of 3D Slicer."""
    labels, affine = rasterise(drawn, spacing=(0.7e-3, 0.7e-3, 1.5e-3), turn=oblique())
    index = np.stack(np.meshgrid(*[np.arange(n) for n in labels.shape], indexing="ij"), axis=-1).reshape(-1, 3)
    points = 1e-3 * (index @ affine[:3, :3].T + affine[:3, 3]) * [-1.0, -1.0, 1.0]
    for name in ("bca", "lcca", "lsa"):
        mine = np.flatnonzero(labels.reshape(-1) == IDS[name])
        _, arc, _ = nearest_on_branch(drawn.tree[name], points[mine])
        labels.reshape(-1)[mine[arc < np.quantile(arc, 0.4)]] = IDS["aorta"]
    path = save_slicer(tmp_path / "Segmentation.seg.nrrd", labels, affine, LONG_NAMES)
    found = import_anatomy(path, resolution=COARSE, cache_dir=cache)
    compare(found, drawn, centreline=1.5e-3)
    assert check_lumen(found, required_radius=1e-3) == []


def test_one_label_for_all_is_named_by_its_shape(tmp_path: Path, drawn: Phantom, cache: Path) -> None:
    labels, affine = rasterise(drawn, spacing=(1.5e-3,) * 3)
    path = save_nifti(tmp_path / "mask.nii.gz", (labels > 0).astype(np.uint8), affine)
    found = import_anatomy(path, resolution=COARSE, cache_dir=cache)
    assert {"aorta", "bca", "lcca", "lsa"} <= set(found.tree.names)
    for name in ("bca", "lcca", "lsa"):
        place = in_patient(found, found.targets[name].position[None])
        assert nearest_on_branch(drawn.tree[name], place)[2][0] < 2e-3


def test_one_label_with_many_wide_ends_is_no_aorta_unless_it_is_said(tmp_path: Path, cache: Path) -> None:
    # five limbs on a bar, as wide as it, by voxels of 2 mm
    x, y, z = np.mgrid[:50, :16, :24]
    bone = ((y - 8) ** 2 + (z - 6) ** 2 <= 9) & (x >= 4) & (x < 46)
    for place in (7, 16, 25, 34, 43):
        bone |= ((x - place) ** 2 + (y - 8) ** 2 <= 9) & (z >= 6) & (z < 20)
    path = save_nifti(tmp_path / "mask.nii.gz", bone.astype(np.uint8), np.diag([-2.0, -2.0, 2.0, 1.0]))
    with pytest.raises(MeshRefusedError, match="no aorta: 3 vessels beside"):
        import_anatomy(path, resolution=2e-3, cache_dir=cache)
    assert import_anatomy(path, labels={1: "aorta"}, resolution=2e-3, cache_dir=cache).targets


def test_a_volume_survives_load_phantom_cache_description_and_pickling(
    thick: Path, imported: Phantom, cache: Path
) -> None:
    assert load_phantom(str(thick), resolution=COARSE, cache_dir=cache).hash == imported.hash
    with pytest.raises(ValueError, match="takes no seed"):
        load_phantom(str(thick), seed=3, cache_dir=cache)
    with pytest.raises(MeshRefusedError, match="labels is a mapping such as"):
        load_phantom(thick, labels=[1, 2], cache_dir=cache)
    with pytest.raises(MeshRefusedError, match="unit in its header"):
        load_phantom(thick, unit="mm", cache_dir=cache)
    _load.cache_clear()
    again = import_anatomy(thick, resolution=COARSE, cache_dir=cache)
    assert again.imported == imported.imported
    np.testing.assert_array_equal(again.grid.dense(), imported.grid.dense())
    description = json.loads(json.dumps(phantom_to_spec(imported)))
    assert phantom_from_spec(description).hash == imported.hash
    assert pickle.loads(pickle.dumps(imported)).imported == imported.imported


@pytest.mark.slow
@pytest.mark.parametrize(
    ("file", "expected"),
    [("ctchest_mask.nii.gz", {"bca", "lcca", "lsa", "rsa", "rcca"}), ("totalseg", {"bca", "lcca", "lsa"})],
)
def test_real_labels(file: str, expected: set[str], cache: Path) -> None:
    if not (REAL / file).exists():
        pytest.skip(f"no real data at {REAL / file}")
    found = import_anatomy(REAL / file, resolution=COARSE, cache_dir=cache)
    assert set(found.tree.names) == expected | {"aorta"}
    assert expected <= set(found.targets)
    voxels, lumen = (sum(pair[n] for pair in found.imported.volumes_ml.values()) for n in (0, 1))
    assert lumen == pytest.approx(voxels, rel=0.03)
    assert check_lumen(found, required_radius=1e-3) == []


def test_a_vessel_whose_volume_differs_is_noted_beside_the_total() -> None:
    volumes = {"aorta": (150e-6, 151e-6), "rcca": (2e-6, 2.11e-6), "lsa": (2e-6, 2.05e-6), "rsa": (0.5e-6, 0.6e-6)}
    assert _volume_notes(volumes) == ["rcca holds 2.11 ml, its voxels 2"]
    assert _volume_notes({"aorta": (100e-6, 106e-6)})[0].startswith("the lumen holds")
