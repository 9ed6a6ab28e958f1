"""Numbers of labels that look like a published scheme's: used if the vessels can be these, and always noted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cathsim.anatomy import Phantom
from cathsim.anatomy.mesh.report import MeshRefusedError
from cathsim.anatomy.vessel_tree import nearest_on_branch
from cathsim.anatomy.volume.files.reading import LabelVolume, read_labels
from cathsim.anatomy.volume.labels.choice import choose_labels
from tests.cathsim.anatomy.volume.rasterising import IDS, rasterise, save_nifti

pytest.importorskip("nibabel", reason="label volumes need nibabel")


@pytest.fixture(scope="module")
def scan(phantom: Phantom) -> tuple[np.ndarray, np.ndarray]:
    return rasterise(phantom, spacing=(1.2e-3,) * 3)


def read(path: Path, scan: tuple[np.ndarray, np.ndarray], numbers: dict[str, int]) -> LabelVolume:
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
        ("aorta", "bca", "rcca", "lcca", "rsa", "lsa"),
        ("aorta", "lsa", "bca", "rcca", "rsa", "lcca"),
        ("lsa", "lcca", "bca", "rcca", "rsa", "aorta"),
        ("rsa", "rcca", "bca", "aorta", "lcca", "lsa"),
    ],
)
def test_numbers_of_ones_own_are_no_zones_of_aortaseg24(
    tmp_path: Path, scan: tuple[np.ndarray, np.ndarray], order: tuple[str, ...]
) -> None:
    volume = read(tmp_path, scan, {name: number for number, name in enumerate(order, 1)})
    assert not volume.named
    assert volume.scheme == "shape"
    assert "would be AortaSeg24's, but" in volume.notes[0]
    assert "labels=" in volume.notes[0]


def test_zones_of_an_arch_are_taken_for_aortaseg24s_and_noted(
    tmp_path: Path, scan: tuple[np.ndarray, np.ndarray], phantom: Phantom
) -> None:
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
    borders = [lsa - 0.02, (lcca + lsa) / 2, (bca + lcca) / 2]  # the course begins at the lower end
    zones[tuple(places.T)] = np.array([7, 5, 3, 1])[np.searchsorted(borders, arc)]
    volume = read_labels(save_nifti(tmp_path / "scan.nii.gz", zones, affine))
    assert volume.scheme == "AortaSeg24"
    assert set(volume.names) == {"aorta", "bca", "lcca", "lsa"}
    assert any("guessed by AortaSeg24's numbers" in note for note in volume.notes)
    mirrored = read_labels(save_nifti(tmp_path / "mirrored.nii.gz", zones, np.diag([-1.0, 1.0, 1.0, 1.0]) @ affine))
    assert mirrored.scheme == "shape"
    assert "patient's right" in mirrored.notes[0]


def test_a_guess_by_totalsegmentators_numbers_is_noted(tmp_path: Path, scan: tuple[np.ndarray, np.ndarray]) -> None:
    volume = read(tmp_path, scan, {name: number for name, number in IDS.items() if number < 60})
    assert volume.scheme == "TotalSegmentator 2"
    assert any("guessed by TotalSegmentator 2's numbers" in note for note in volume.notes)


def test_a_whole_trunk_of_the_first_totalsegmentator_is_not_the_seconds(
    tmp_path: Path, scan: tuple[np.ndarray, np.ndarray]
) -> None:
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
