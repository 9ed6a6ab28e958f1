"""Labels that no patient can have are refused in one sentence, doubtful ones are noted."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from cathsim.anatomy import Phantom, import_anatomy
from cathsim.anatomy.mesh.report import MeshRefusedError
from cathsim.anatomy.volume.files.reading import read_labels
from cathsim.anatomy.volume.labels.checks import check_labels
from tests.cathsim.anatomy.volume.rasterising import rasterise, save_nifti

pytest.importorskip("nibabel", reason="label volumes need nibabel")

MIRROR = np.diag([-1.0, 1.0, 1.0, 1.0])


@pytest.fixture(scope="module")
def scan(phantom: Phantom) -> tuple[np.ndarray, np.ndarray]:
    return rasterise(phantom, spacing=(1.2e-3,) * 3)


def notes_of(folder: Path, labels: np.ndarray, affine: np.ndarray) -> tuple[str, ...]:
    return check_labels(read_labels(save_nifti(folder / "scan.nii.gz", labels, affine)))


def scaled(affine: np.ndarray, factor: float) -> np.ndarray:
    return np.diag([factor, factor, factor, 1.0]) @ affine


@pytest.mark.parametrize("spacing", [(1.2e-3, 1.2e-3, 1.2e-3), (0.7e-3, 0.7e-3, 5e-3), (3e-3, 3e-3, 3e-3)])
def test_whole_labels_have_no_notes(tmp_path: Path, phantom: Phantom, spacing: tuple[float, float, float]) -> None:
    assert notes_of(tmp_path, *rasterise(phantom, spacing=spacing)) == ()


@pytest.mark.parametrize("factor", [0.05, 0.1])
def test_a_wrong_unit_is_refused_by_the_aortas_radius(
    tmp_path: Path, scan: tuple[np.ndarray, np.ndarray], cache: Path, factor: float
) -> None:
    path = save_nifti(tmp_path / "scan.nii.gz", scan[0], scaled(scan[1], factor))
    voxel = f"voxels of {1.2 * factor:.2g} x"
    with pytest.raises(MeshRefusedError, match=rf"mm of radius at its widest, by {voxel}.*check the unit"):
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


def test_an_infants_size_is_noted(tmp_path: Path, scan: tuple[np.ndarray, np.ndarray]) -> None:
    assert any("unit of the affine" in note for note in notes_of(tmp_path, scan[0], scaled(scan[1], 0.3)))


@pytest.mark.parametrize("share", [0.1, 0.5, 0.8])
def test_noise_in_one_label(tmp_path: Path, cache: Path, share: float) -> None:
    noise = (np.random.default_rng(0).random((140, 130, 120)) < share).astype(np.uint8)
    path = save_nifti(tmp_path / "scan.nii.gz", noise, np.diag([-1.0, -1.0, 1.0, 1.0]))
    begin = time.process_time()
    with pytest.raises(MeshRefusedError, match=r"is noise: .* voxels' neighbours"):
        import_anatomy(path, cache_dir=cache)
    assert time.process_time() - begin < 20


def test_exchanged_sides_are_noted(tmp_path: Path, scan: tuple[np.ndarray, np.ndarray]) -> None:
    assert any("lies to the patient's right" in note for note in notes_of(tmp_path, scan[0], MIRROR @ scan[1]))


def test_a_vessel_that_the_volumes_side_cuts_lengthwise_is_noted(
    tmp_path: Path, scan: tuple[np.ndarray, np.ndarray]
) -> None:
    labels, affine = scan
    across = labels[:, :, np.flatnonzero((labels == 52).any(axis=(0, 1)))[15] :]
    assert notes_of(tmp_path, across, affine) == ()
    descending = np.argwhere(labels[:, :, 30] == 52)
    for axis in (0, 1):
        for end in (slice(None, int(descending[:, axis].mean())), slice(int(descending[:, axis].mean()), None)):
            cut = labels[end] if axis == 0 else labels[:, end]
            notes = notes_of(tmp_path, cut, affine)
            assert any(note.startswith("aorta is cut off lengthwise") for note in notes), (axis, end)
