"""DICOM series, segmentations and structure sets, as highdicom, rt-utils, SimpleITK and pydicom write them."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cathsim.anatomy.importing import import_anatomy, import_digest, is_anatomy_path
from cathsim.anatomy.mesh.report import MeshRefusedError
from cathsim.anatomy.volume.files.reading import open_volume, read_labels
from tests.cathsim.anatomy.volume.dicom.ct_series import (
    ORIGIN,
    SHAPE,
    SPACING,
    VESSELS,
    affine,
    masks,
    write_segmentation,
    write_series,
)
from tests.cathsim.anatomy.volume.rasterising import oblique, whole_lattice

pydicom = pytest.importorskip("pydicom", reason="DICOM files need pydicom")

REFERENCES = Path(__file__).parent / "references"


def hounsfield() -> np.ndarray:
    return np.random.default_rng(0).integers(-900, 900, SHAPE).astype(float)


def whole(path: Path, **arguments: Any) -> tuple[dict[str, np.ndarray], Any]:
    """Voxels of every vessel on the volume's own lattice."""
    volume = read_labels(path, **arguments)
    return {name: whole_lattice(volume) == number for number, name in enumerate(volume.names, 1)}, volume


def refused(path: Path, match: str, *, image: bool = True) -> None:
    with pytest.raises(MeshRefusedError, match=match):
        list(open_volume(path, image=image).slabs())


def test_a_series_in_any_order_has_its_places_and_hounsfield_units(tmp_path: Path) -> None:
    write_series(tmp_path / "ct", hounsfield(), oblique())
    source = open_volume(tmp_path / "ct", image=True)
    np.testing.assert_allclose(source.affine, affine(oblique()), atol=1e-6)
    values = np.concatenate([slab[0] for _, slab in source.slabs()], axis=2)
    np.testing.assert_array_equal(values, hounsfield())
    assert (source.world, source.unit, source.notes) == ("LPS", "mm", ())


def test_series_that_are_none(tmp_path: Path) -> None:
    folder = tmp_path / "ct"
    paths = write_series(folder, hounsfield(), oblique())
    refused(paths[0], "one file of a DICOM series; give the folder")
    refused(folder, "no labels: segment the vessels first", image=False)
    refused(paths[0], "of the kind CT, expected a segmentation", image=False)
    content = paths[4].read_bytes()
    paths[4].unlink()
    refused(folder, r"lacks slices: from .* mm there is none, elsewhere they lie 2 mm apart")
    paths[4].write_bytes(content)
    (folder / "again.dcm").write_bytes(content)
    refused(folder, "two slices in one place")
    (folder / "again.dcm").unlink()
    paths[4].write_bytes(content[:-200])
    refused(folder, "cannot be read: .*; export the series without compression")
    paths[4].write_bytes(content)
    write_series(folder, hounsfield(), oblique(), series="1.2.3.9")
    refused(folder, r"holds 2 series of a CT: 3 THORAX \(8 files\), 3 THORAX \(8 files\)")


def test_a_tilted_gantry_is_refused(tmp_path: Path) -> None:
    for k, path in enumerate(write_series(tmp_path / "ct", hounsfield())):
        one = pydicom.dcmread(path)
        one.ImagePositionPatient = [40.0, -30.0 + 0.5 * k, 12.0 + 2 * k]
        one.save_as(path)
    refused(tmp_path / "ct", "gantry tilted by 14.0 degrees")


@pytest.mark.parametrize("kind", ["binary", "fractional", "labelmap"])
def test_segmentations_of_highdicom(kind: str) -> None:
    path = REFERENCES / f"highdicom_{kind}.dcm"
    source = open_volume(path)
    labels = {1: "aorta", 2: "lsa"} if kind != "binary" else None
    if kind != "binary":  # labels called Segment_1 and Segment_2: the coded structures name them
        assert sorted(source.names.values()) == ["Aorta", "Subclavian artery"]
    found, volume = whole(path, labels=labels)
    expected = masks()
    if kind == "labelmap":
        expected[1] &= ~expected[2]
    low = np.rint(np.linalg.inv(affine(oblique())) @ [*source.affine[:3, 3], 1])[:3].astype(int)
    assert set(found) == {"aorta", "lsa"}
    np.testing.assert_array_equal(
        found["lsa"], expected[2][tuple(slice(a, a + n) for a, n in zip(low, volume.shape, strict=True))]
    )
    # where both overlap the smaller counts
    np.testing.assert_array_equal(found["aorta"], (expected[1] & ~expected[2])[..., low[2] : low[2] + volume.shape[2]])
    np.testing.assert_allclose(source.affine[:3, :3], affine(oblique())[:3, :3], atol=1e-5)
    assert any("fractional" in note for note in volume.notes) == (kind == "fractional")


@pytest.mark.parametrize("columns", [17, 20, 24])
def test_frames_that_begin_within_a_byte(columns: int, tmp_path: Path) -> None:
    labels = np.zeros((columns, 19, 8), dtype=np.uint8)
    labels[:12, 5:13], labels[12:, 7:10, 3:6] = 1, 2
    write_segmentation(tmp_path / "a.dcm", labels, affine(oblique()), VESSELS)
    found, _ = whole(tmp_path / "a.dcm")
    np.testing.assert_array_equal(found["aorta"], labels == 1)
    np.testing.assert_array_equal(found["lsa"], (labels == 2))


def test_frames_tell_how_far_slices_lie_apart(tmp_path: Path) -> None:
    path = tmp_path / "a.dcm"
    write_segmentation(path, masks()[1].astype(np.uint8), affine(np.eye(3)), {1: "aorta"})
    one = pydicom.dcmread(path)
    measures = one.SharedFunctionalGroupsSequence[0].PixelMeasuresSequence[0]
    del measures.SpacingBetweenSlices
    measures.SliceThickness = 1.0  # slices lie 2 mm apart
    one.save_as(path)
    found, volume = whole(path)
    np.testing.assert_allclose(volume.spacing, 1e-3 * np.array(SPACING))
    np.testing.assert_array_equal(found["aorta"], masks()[1])
    frames = one.PerFrameFunctionalGroupsSequence
    for at, frame in zip((0, 1, 2, 3, 4, 6, 8, 10), frames, strict=True):
        frame.PlanePositionSequence[0].ImagePositionPatient = [*ORIGIN[:2], 2.0 * at]
    one.save_as(path)
    refused(path, "slices that lie 2 to 4 mm apart; resample it to even ones", image=False)
    for at, frame in zip((0, 1, 2, 3, 4, 5, 6, 8), frames, strict=True):
        frame.PlanePositionSequence[0].ImagePositionPatient = [*ORIGIN[:2], 2.0 * at]
    one.save_as(path)
    assert whole(path)[1].notes == ("aorta has no frame in 1 slices between others",)


@pytest.mark.parametrize("beside", [True, False])
def test_contours_of_rt_utils(tmp_path: Path, beside: bool) -> None:
    folder = tmp_path / "patient"
    folder.mkdir()
    shutil.copy(REFERENCES / "rt_utils.dcm", folder / "structures.dcm")
    if beside:
        write_series(folder, hounsfield(), PixelSpacing=[0.8, 0.8])
    found, volume = whole(folder)
    assert set(found) == {"aorta", "lsa"}
    if beside:
        expected = masks()
        np.testing.assert_array_equal(found["lsa"], expected[2])
        np.testing.assert_array_equal(found["aorta"], expected[1] & ~expected[2])
        assert volume.notes == ()
    else:
        assert any("the series of the contours is not beside them" in note for note in volume.notes)
        ml = found["aorta"].sum() * volume.voxel_volume
        # contours run through the middles of voxels, which a lattice of their own cannot know: half a voxel is lost
        assert 0.6 < ml / ((masks()[1] & ~masks()[2]).sum() * 0.8 * 0.8 * 2.0e-9) < 1.05


def test_slices_beside_contours_are_part_of_the_hash(tmp_path: Path) -> None:
    paths = write_series(tmp_path, hounsfield())
    structures = tmp_path / "structures.dcm"
    shutil.copy(REFERENCES / "rt_utils.dcm", structures)
    for path in (structures, tmp_path):
        assert is_anatomy_path(str(path))
        source = {"path": path, "unit": None, "names": None}
        before = import_digest(source, 1e-3)
        content = paths[3].read_bytes()
        paths[3].write_bytes(content[:-1] + b"x")
        assert import_digest(source, 1e-3) != before
        paths[3].write_bytes(content)


def test_damaged_files_are_refused(tmp_path: Path) -> None:
    for name in ("highdicom_binary.dcm", "highdicom_labelmap.dcm", "rt_utils.dcm"):
        content = (REFERENCES / name).read_bytes()
        for share in (0.3, 0.9):
            path = tmp_path / name
            path.write_bytes(content[: int(share * len(content))])
            with pytest.raises(MeshRefusedError):
                import_anatomy(path, cache_dir=tmp_path / "cache")
