"""Labels that no patient can have are refused, doubtful ones and guessed schemes are noted."""

import time
from pathlib import Path

import numpy as np
import pytest

from cathsim.anatomy import Phantom, import_anatomy
from cathsim.anatomy.mesh.report import MeshRefusedError
from cathsim.anatomy.vessel_tree import nearest_on_branch
from cathsim.anatomy.volume.files.reading import LabelVolume, read_labels
from cathsim.anatomy.volume.labels.checks import check_labels
from cathsim.anatomy.volume.labels.choice import choose_labels
from tests.cathsim.anatomy.volume.rasterising import IDS, rasterise, save_nifti

pytest.importorskip("nibabel", reason="label volumes need nibabel")

Scan = tuple[np.ndarray, np.ndarray]  # labels and affine
MIRROR = np.diag([-1.0, 1.0, 1.0, 1.0])


@pytest.fixture(scope="module")
def scan(phantom: Phantom) -> Scan:
    return rasterise(phantom, spacing=(1.2e-3,) * 3)


def notes_of(folder: Path, labels: np.ndarray, affine: np.ndarray) -> tuple[str, ...]:
    return check_labels(read_labels(save_nifti(folder / "scan.nii.gz", labels, affine)))


def scaled(affine: np.ndarray, factor: float) -> np.ndarray:
    return np.diag([factor, factor, factor, 1.0]) @ affine


@pytest.mark.parametrize("spacing", [(0.7e-3, 0.7e-3, 5e-3), (3e-3, 3e-3, 3e-3)])
def test_whole_labels_of_coarse_voxels_have_no_notes(
    tmp_path: Path, phantom: Phantom, spacing: tuple[float, float, float]
) -> None:
    assert notes_of(tmp_path, *rasterise(phantom, spacing=spacing)) == ()


def test_a_wrong_unit_is_refused_by_the_aortas_radius(tmp_path: Path, scan: Scan, cache: Path) -> None:
    path = save_nifti(tmp_path / "scan.nii.gz", scan[0], scaled(scan[1], 0.1))
    with pytest.raises(MeshRefusedError, match=r"mm of radius at its widest, by voxels of 0\.12 x"):
        import_anatomy(path, cache_dir=cache)


def test_an_aorta_of_eighty_millimetres_is_refused_at_once(tmp_path: Path, cache: Path) -> None:
    x, y, z = np.meshgrid(*[np.arange(n) for n in (40, 40, 60)], indexing="ij")
    labels = np.zeros(x.shape, dtype=np.uint8)
    labels[(np.hypot(y - 20, z - 45) < 4) & (x > 20)] = 54
    labels[np.hypot(x - 20, y - 20) < 13.3] = 52
    path = save_nifti(tmp_path / "scan.nii.gz", labels, np.diag([-3.0, -3.0, 3.0, 1.0]))
    begin = time.process_time()
    with pytest.raises(MeshRefusedError, match="check the unit"):
        import_anatomy(path, cache_dir=cache)
    assert time.process_time() - begin < 20
    # an aneurysm of 70 mm is none
    assert check_labels(read_labels(save_nifti(path, labels, np.diag([-2.6, -2.6, 2.6, 1.0])))) == ()


@pytest.mark.parametrize("share", [0.1, 0.8])
def test_noise_in_one_label(tmp_path: Path, cache: Path, share: float) -> None:
    noise = (np.random.default_rng(0).random((140, 130, 120)) < share).astype(np.uint8)
    path = save_nifti(tmp_path / "scan.nii.gz", noise, np.diag([-1.0, -1.0, 1.0, 1.0]))
    begin = time.process_time()
    with pytest.raises(MeshRefusedError, match=r"is noise: .* voxels' neighbours"):
        import_anatomy(path, cache_dir=cache)
    assert time.process_time() - begin < 20


def test_exchanged_sides_and_an_infants_size_are_noted_and_no_others(tmp_path: Path, scan: Scan) -> None:
    assert notes_of(tmp_path, *scan) == ()
    assert any("lies to the patient's right" in note for note in notes_of(tmp_path, scan[0], MIRROR @ scan[1]))
    assert any("unit of the affine" in note for note in notes_of(tmp_path, scan[0], scaled(scan[1], 0.3)))


def test_a_vessel_that_the_volumes_side_cuts_lengthwise_is_noted(tmp_path: Path, scan: Scan) -> None:
    labels, affine = scan
    across = labels[:, :, np.flatnonzero((labels == 52).any(axis=(0, 1)))[15] :]
    assert notes_of(tmp_path, across, affine) == ()
    descending = np.argwhere(labels[:, :, 30] == 52)
    for axis in (0, 1):
        middle = int(descending[:, axis].mean())
        for end in (slice(None, middle), slice(middle, None)):
            cut = labels[end] if axis == 0 else labels[:, end]
            notes = notes_of(tmp_path, cut, affine)
            assert any(note.startswith("aorta is cut off lengthwise") for note in notes), (axis, end)


def read(path: Path, scan: Scan, numbers: dict[str, int]) -> LabelVolume:
    """The volume with other numbers for its vessels."""
    table = np.zeros(256, dtype=np.uint8)
    for name, number in numbers.items():
        table[IDS[name]] = number
    return read_labels(save_nifti(path / "scan.nii.gz", table[scan[0]], scan[1]))


@pytest.mark.parametrize(
    "order",
    [
        ("aorta", "bca", "lcca", "lsa", "rsa", "rcca"),
        ("aorta", "bca", "lcca", "lsa", "rsa"),
        ("aorta", "lsa", "bca", "rcca", "rsa", "lcca"),
        ("rsa", "rcca", "bca", "aorta", "lcca", "lsa"),
    ],
)
def test_numbers_of_ones_own_are_no_zones_of_aortaseg24(tmp_path: Path, scan: Scan, order: tuple[str, ...]) -> None:
    volume = read(tmp_path, scan, {name: number for number, name in enumerate(order, 1)})
    assert not volume.named
    assert volume.scheme == "shape"
    assert "would be AortaSeg24's, but" in volume.notes[0]
    assert "labels=" in volume.notes[0]


def test_zones_of_an_arch_are_taken_for_aortaseg24s_and_noted(tmp_path: Path, scan: Scan, phantom: Phantom) -> None:
    labels, affine = scan
    table = np.zeros(256, dtype=np.uint8)
    # the labels of the BCA's daughters are the trunk's
    for name, number in {"aorta": 1, "bca": 2, "rsa": 2, "rcca": 2, "lcca": 4, "lsa": 6}.items():
        table[IDS[name]] = number
    zones = table[labels]
    places = np.argwhere(zones == 1)
    points = 1e-3 * (places @ affine[:3, :3].T + affine[:3, 3]) * [-1.0, -1.0, 1.0]
    _, arc, _ = nearest_on_branch(phantom.tree.root, points)
    bca, lcca, lsa = (phantom.tree[name].parent_arc for name in ("bca", "lcca", "lsa"))
    borders = [lsa - 0.02, (lcca + lsa) / 2, (bca + lcca) / 2]  # the path begins at the lower end
    zones[tuple(places.T)] = np.array([7, 5, 3, 1])[np.searchsorted(borders, arc)]
    volume = read_labels(save_nifti(tmp_path / "scan.nii.gz", zones, affine))
    assert volume.scheme == "AortaSeg24"
    assert set(volume.names) == {"aorta", "bca", "lcca", "lsa"}
    assert any("guessed by AortaSeg24's numbers" in note for note in volume.notes)
    mirrored = read_labels(save_nifti(tmp_path / "mirrored.nii.gz", zones, MIRROR @ affine))
    assert mirrored.scheme == "shape"
    assert "patient's right" in mirrored.notes[0]


def test_a_whole_trunk_of_the_first_totalsegmentator_is_not_the_seconds(tmp_path: Path, scan: Scan) -> None:
    labels, affine = scan
    trunk = np.where(labels == IDS["aorta"], 7, 0).astype(np.uint8)
    x, y, z = np.argwhere(trunk == 7)[0]  # at the lower end
    low, top = max(x - 4, 0), max(y - 4, 0)
    trunk[low : low + 4, top : top + 4, z : z + 8] = 52  # the right iliac artery, 54 its vein
    trunk[low : low + 4, top + 4 : top + 8, z : z + 8] = 51
    trunk[-10:, -20:, :] = np.where(trunk[-10:, -20:, :] == 0, 57, trunk[-10:, -20:, :])
    trunk[0, 0, : 104 - 58] = np.arange(58, 104)
    trunk[0, 1, 0], trunk[0, 1, 1] = 104, 54
    volume = read_labels(save_nifti(tmp_path / "scan.nii.gz", trunk, affine))
    assert volume.scheme == "TotalSegmentator 1"
    assert set(volume.names) == {"aorta", "iliac_left", "iliac_right"}


def test_the_heart_beside_the_aorta_is_not_lumen() -> None:
    choice = choose_labels({(0, value): 100 for value in (51, 52, 53)}, {}, None, "a.nii.gz")
    assert choice.vessels == {(0, 52): "aorta"}


def test_branches_of_totalsegmentator_without_an_aorta() -> None:
    with pytest.raises(MeshRefusedError, match=r"no label of the aorta: 54 \(bca\), 56 \(lsa\), 58 \(lcca\)"):
        choose_labels({(0, value): 100 for value in (54, 56, 58)}, {}, None, "a.nii.gz")
