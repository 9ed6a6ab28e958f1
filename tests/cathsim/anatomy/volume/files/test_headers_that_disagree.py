"""Headers that say two things: a note with both, and a choice; axes that rounding has bent are straightened."""

from pathlib import Path

import numpy as np
import pytest

from cathsim.anatomy.importing import import_anatomy, import_digest
from cathsim.anatomy.mesh.report import MeshRefusedError
from cathsim.anatomy.volume.files.reading import open_volume, read_labels

nibabel = pytest.importorskip("nibabel", reason="label volumes need nibabel")
nrrd = pytest.importorskip("nrrd", reason="label volumes need pynrrd")

SIDES = np.array([0.7, 0.8, 2.0])


def tubes() -> np.ndarray:
    labels = np.zeros((64, 64, 30), dtype=np.uint8)
    labels[20:36, 20:36] = 52
    labels[36:50, 25:31, 12:18] = 58
    return labels


def turned(sides: np.ndarray = SIDES) -> np.ndarray:
    """An affine that is turned about all axes, whose numbers rounding touches."""
    a, b = 0.3, 0.2
    first = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    second = np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
    affine = np.eye(4)
    affine[:3, :3] = first @ second * sides
    affine[:3, 3] = [12.0, -30.0, 4.0]
    return affine


def save(path: Path, sform: np.ndarray | None, qform: np.ndarray | None) -> Path:
    image = nibabel.Nifti1Image(tubes(), np.eye(4))
    image.header.set_zooms(SIDES if sform is None else np.linalg.norm(sform[:3, :3], axis=0))
    image.set_sform(sform, 0 if sform is None else 1)
    image.set_qform(qform, 0 if qform is None else 1)
    image.header.set_xyzt_units("mm")
    nibabel.save(image, path)
    return path


def test_a_mirrored_qform_is_noted_and_may_be_chosen(tmp_path: Path) -> None:
    mirrored = np.diag([-1.0, 1, 1, 1])
    path = save(tmp_path / "a.nii.gz", np.eye(4), mirrored)
    note = (
        "the header's sform and qform lie up to 126 apart and exchange two sides of the patient: the sform is taken, "
        "transform='qform' takes the other"
    )
    assert note in read_labels(path).notes
    np.testing.assert_allclose(read_labels(path).affine[0, 0], 1e-3)
    np.testing.assert_allclose(read_labels(path, transform="qform").affine[0, 0], -1e-3)
    assert any("the qform is taken" in note for note in read_labels(path, transform="qform").notes)
    source = {"path": path, "unit": None, "names": None}
    digests = {import_digest(source | {"transform": one}, 1e-3) for one in (None, "sform", "qform")}
    assert len(digests) == 3


def test_a_transform_that_is_not_there(tmp_path: Path) -> None:
    path = save(tmp_path / "a.nii.gz", turned(), None)
    with pytest.raises(MeshRefusedError, match="has no qform; leave transform='qform' out"):
        import_anatomy(path, transform="qform", cache_dir=tmp_path)
    with pytest.raises(ValueError, match="transform must be one of sform, qform, got 'affine'"):
        import_anatomy(path, transform="affine", cache_dir=tmp_path)
    nrrd.write(str(tmp_path / "a.nrrd"), tubes())
    with pytest.raises(MeshRefusedError, match="has one affine; transform='sform' belongs to NIfTI files"):
        read_labels(tmp_path / "a.nrrd", transform="sform")
    (tmp_path / "a.stl").write_text("solid")
    with pytest.raises(MeshRefusedError, match="no label volume; leave transform="):
        import_anatomy(tmp_path / "a.stl", transform="sform", cache_dir=tmp_path)


@pytest.mark.parametrize(("told", "noted"), [(0.72, True), (0.701, False)])
def test_a_rounded_spacing_is_noted_where_it_matters(tmp_path: Path, told: float, noted: bool) -> None:
    image = nibabel.Nifti1Image(tubes(), turned())
    image.header["qform_code"] = 0
    image.header["pixdim"][1] = told
    nibabel.save(image, tmp_path / "a.nii.gz")
    notes = open_volume(tmp_path / "a.nii.gz").notes
    assert [note.startswith("the header's spacing 0.72 x 0.8 x 2 is not that") for note in notes] == [True] * noted
    np.testing.assert_allclose(open_volume(tmp_path / "a.nii.gz").spacing, 1e-3 * SIDES, rtol=1e-6)


@pytest.mark.parametrize("noise", [1e-4, 1e-3, 1e-2])
def test_axes_with_noise_are_straightened(tmp_path: Path, noise: float) -> None:
    affine = turned()
    affine[:3, :3] += np.random.default_rng(0).uniform(-noise, noise, (3, 3))
    path = save(tmp_path / "a.nii.gz", affine, None)
    source = open_volume(path)
    axes = source.affine[:3, :3] / np.linalg.norm(source.affine[:3, :3], axis=0)
    np.testing.assert_allclose(axes.T @ axes, np.eye(3), atol=1e-9)
    middle = [*(np.array(source.shape) - 1) / 2, 1]
    np.testing.assert_allclose(source.affine @ middle, affine @ middle, atol=1e-4)  # of float32 in the header
    assert [("straightened" in note) for note in source.notes] == [True] * (noise == 1e-2)
    assert set(read_labels(path).names) == {"aorta", "lcca"}


def test_axes_of_a_tilted_gantry_are_refused(tmp_path: Path) -> None:
    affine = turned()
    affine[:3, 2] += 0.2 * affine[:3, 1]
    with pytest.raises(MeshRefusedError, match="not at right angles"):
        read_labels(save(tmp_path / "a.nii.gz", affine, None))


def test_files_of_a_folder_whose_affines_differ_by_rounding_are_one_lattice(tmp_path: Path) -> None:
    for name, value, noise in (("aorta", 52, 0.0), ("common_carotid_artery_left", 58, 2e-3)):
        affine = turned()
        affine[0, 0] += noise
        image = nibabel.Nifti1Image((tubes() == value).astype(np.uint8), affine)
        nibabel.save(image, tmp_path / f"{name}.nii.gz")
    assert set(read_labels(tmp_path).names) == {"aorta", "lcca"}
