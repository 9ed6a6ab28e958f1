"""Label volumes as they come, headers that say two things, and what cannot be read: one sentence each."""

import builtins
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cathsim import load_phantom
from cathsim.anatomy.importing import import_anatomy, import_digest, is_anatomy_path
from cathsim.anatomy.mesh.report import MeshRefusedError
from cathsim.anatomy.volume.files.reading import LabelVolume, open_volume, read_labels
from cathsim.anatomy.volume.importer import join_repeated
from tests.cathsim.anatomy.volume.rasterising import oblique, save_nifti, save_slicer, tubes

nibabel = pytest.importorskip("nibabel", reason="label volumes need nibabel")
nrrd = pytest.importorskip("nrrd", reason="label volumes need pynrrd")

AFFINE = np.diag([-0.8, 0.9, 2.0, 1.0])
AFFINE[:3, 3] = [40.0, -30.0, 12.0]


def refused(path: Path, match: str, **arguments: Any) -> None:
    with pytest.raises(MeshRefusedError, match=match) as caught:
        import_anatomy(path, cache_dir=path.parent / "cache", **arguments)
    sentence = str(caught.value)
    assert "\n" not in sentence
    assert len(sentence) < 420


def test_a_voxels_place_is_that_of_the_affine(tmp_path: Path) -> None:
    for unit, scale in (("mm", 1.0), ("meter", 1e-3), ("micron", 1e3)):
        image = nibabel.Nifti1Image(tubes(), np.diag([scale] * 3 + [1.0]) @ AFFINE)
        image.header.set_xyzt_units(unit)
        nibabel.save(image, tmp_path / "scan.nii")
        volume = read_labels(tmp_path / "scan.nii")
        first = volume.affine @ [0, 0, 0, 1]
        np.testing.assert_allclose(first[:3], 1e-3 * (AFFINE @ [10, 10, 0, 1])[:3], atol=1e-9)
        np.testing.assert_allclose(volume.spacing, [0.8e-3, 0.9e-3, 2e-3], rtol=1e-5)
        assert volume.names == ("aorta", "lcca")
        assert volume.shape == (40, 36, 30)


def test_qform_counts_where_there_is_no_sform_and_neither_is_noted(tmp_path: Path) -> None:
    image = nibabel.Nifti1Image(tubes(), AFFINE)
    image.set_sform(None, code=0)
    image.set_qform(AFFINE, code=1)
    nibabel.save(image, tmp_path / "scan.nii.gz")
    np.testing.assert_allclose(read_labels(tmp_path / "scan.nii.gz").frame, np.diag([-1.0, -1.0, 1.0]))
    image.set_qform(None, code=0)
    nibabel.save(image, tmp_path / "scan.nii.gz")
    volume = read_labels(tmp_path / "scan.nii.gz")
    assert "says nothing of the patient's axes" in volume.notes[0]
    in_patient = volume.frame @ volume.affine[:3, :3]  # rows left, posterior, superior; a column each axis of the file
    np.testing.assert_allclose(np.sign(np.diag(in_patient)), [1, -1, 1])


SPACES = {
    "left-posterior-superior": np.eye(3), "RAS": np.diag([-1.0, -1.0, 1.0]), "right-posterior-superior-time":
    np.diag([-1.0, 1.0, 1.0]), "las": np.diag([1.0, -1.0, 1.0]), "PIR": np.eye(3)[[2, 0, 1]] * [1.0, -1.0, -1.0],
    "scanner-xyz": np.eye(3),
}  # fmt: skip


@pytest.mark.parametrize("space", SPACES)
def test_nrrd_in_any_space(tmp_path: Path, space: str) -> None:
    header = {"space": space, "space directions": AFFINE[:3, :3].T, "space origin": AFFINE[:3, 3]}
    nrrd.write(str(tmp_path / "a.nrrd"), tubes(), header)
    volume = read_labels(tmp_path / "a.nrrd")
    np.testing.assert_array_equal(volume.frame, SPACES[space])
    assert any("the file's space, scanner-xyz, is not" in note for note in volume.notes) == (space == "scanner-xyz")
    np.testing.assert_array_equal(volume.vessels[:10, :10, :], 1)


def test_segments_of_slicer_in_layers_may_overlap_and_are_named_by_their_codes(tmp_path: Path) -> None:
    # Written by slicerio 1.4.0: two segments with automatic names, in a second layer a thrombus over both.
    path = Path(__file__).parent / "slicer" / "overlapping.seg.nrrd"
    volume, labels = read_labels(path), tubes()
    assert volume.names == ("aorta", "lcca")
    assert any(note.endswith("thrombus") for note in volume.notes)
    for number, label in ((1, 52), (2, 58)):
        np.testing.assert_array_equal(volume.vessels == number, (labels == label)[10:30, 10:20])
    np.testing.assert_allclose(volume.affine[:3] @ [0, 0, 0, 1], 1e-3 * (AFFINE[:3] @ [10, 10, 0, 1]))
    np.testing.assert_array_equal(volume.frame, np.eye(3))
    fractions = tmp_path / "fractions.seg.nrrd"
    fractions.write_bytes(path.read_bytes().replace(b"Representation:=Binary", b"Representation:=Fractional"))
    refused(fractions, "fractions of segments")


def layers_of_slicer(path: Path, *fields: dict[str, str]) -> Path:
    """Writes tubes as segments in a layer each, of value 1, with further fields of each segment."""
    labels = np.stack([tubes() == 52, tubes() == 58]).astype(np.uint8)
    header: dict[str, Any] = {
        "space": "left-posterior-superior",
        "kinds": ["list", "domain", "domain", "domain"],
        "space directions": np.vstack([np.full(3, np.nan), np.diag([0.8, 0.9, 2.0])]),
        "space origin": np.zeros(3),
    }
    for number, (name, more) in enumerate(zip(("lcca", "aorta"), fields, strict=True)):
        header |= {f"Segment{number}_Name": name} | {f"Segment{number}_{key}": value for key, value in more.items()}
    nrrd.write(str(path), labels[::-1], header)
    return path


def test_layers_of_slicer_belong_to_their_segments_and_a_number_of_several_is_asked_for_by_name(tmp_path: Path) -> None:
    volume = read_labels(layers_of_slicer(tmp_path / "older.seg.nrrd", {}, {}))
    assert set(volume.names) == {"aorta", "lcca"}
    assert (volume.vessels == 1 + volume.names.index("lcca")).sum() == (tubes() == 58).sum()
    fields = [{"Layer": str(layer), "LabelValue": "1"} for layer in (0, 1)]
    path = layers_of_slicer(tmp_path / "a.seg.nrrd", *fields)
    refused(path, r"has the label 1 in 2 layers \(aorta, lcca\)", labels={1: "aorta"})
    assert set(read_labels(path, {"aorta": "aorta"}).names) == {"aorta", "lcca"}


def test_labels_that_a_file_does_not_name_are_told(tmp_path: Path) -> None:
    labels = tubes()
    labels[30:34, 30:34, 4:20] = 7
    path = save_slicer(tmp_path / "a.seg.nrrd", labels, AFFINE, {52: "aorta", 58: "lcca"})
    told = "labels without a name are not taken: 7"
    assert told in read_labels(path).notes
    assert told in read_labels(path, {58: "lsa"}).notes
    assert told not in read_labels(path, {7: None}).notes


@pytest.mark.parametrize(("spacings", "taken"), [(None, 1.0), ([np.nan] * 3, 1.0), ([-0.7, 0.7, 0.7], 0.7)])
def test_voxels_without_a_size_are_told(tmp_path: Path, spacings: Any, taken: float) -> None:
    nrrd.write(str(tmp_path / "a.nrrd"), tubes(), {} if spacings is None else {"spacings": spacings})
    volume = read_labels(tmp_path / "a.nrrd")
    np.testing.assert_allclose(volume.spacing, [1e-3 * taken] * 3)
    assert any("how large its voxels are" in note for note in volume.notes) == (taken == 1.0)


def test_names_in_the_header_of_totalsegmentator(tmp_path: Path) -> None:
    labels = np.where(tubes() == 52, 3, np.where(tubes() == 58, 9, 0)).astype(np.uint8)
    save_nifti(tmp_path / "a.nii.gz", labels, AFFINE, {3: "aorta", 9: "subclavian_artery_left"})
    assert read_labels(tmp_path / "a.nii.gz").names == ("aorta", "lsa")
    assert read_labels(tmp_path / "a.nii.gz", {9: "lcca"}).names == ("aorta", "lcca")
    assert read_labels(tmp_path / "a.nii.gz", {"subclavian_artery_left": None}).names == ("aorta",)


def test_volumes_of_four_axes(tmp_path: Path) -> None:
    nibabel.save(nibabel.Nifti1Image(np.zeros((8, 8, 8, 3), np.uint8), AFFINE), tmp_path / "a.nii.gz")
    refused(tmp_path / "a.nii.gz", "has 4 axes")
    nrrd.write(str(tmp_path / "a.nrrd"), np.zeros((8, 8, 8, 3), np.uint8))
    refused(tmp_path / "a.nrrd", "has 4 axes")
    nibabel.save(nibabel.Nifti1Image(tubes()[..., None], AFFINE), tmp_path / "one.nii.gz")
    assert open_volume(tmp_path / "one.nii.gz").shape == (40, 36, 30)


def test_an_affine_that_is_none(tmp_path: Path) -> None:
    singular, sheared, huge = AFFINE.copy(), AFFINE.copy(), AFFINE.copy()
    singular[:, 1] = singular[:, 0]
    sheared[0, 2] = 0.8
    huge[:3, :3] *= 100
    without_origin = AFFINE.copy()
    without_origin[0, 3] = np.nan
    for affine, match in (
        (singular, "do not span"),
        (sheared, "right angles"),
        (huge, "voxels of"),
        (without_origin, "missing or infinite"),
    ):
        header = {"space": "LPS", "space directions": affine[:3, :3].T, "space origin": affine[:3, 3]}
        nrrd.write(str(tmp_path / "a.nrrd"), tubes(), header)
        refused(tmp_path / "a.nrrd", match)


def test_wrong_label_numbers(tmp_path: Path) -> None:
    path = save_nifti(tmp_path / "a.nii.gz", tubes(), AFFINE)
    refused(path, "no label 99; it has 52, 58", labels={99: "aorta"})
    refused(path, "no label of the aorta", labels={52: "lsa"})
    many = 60 + np.arange(tubes().size).reshape(tubes().shape) % 33
    refused(save_nifti(tmp_path / "b.nii.gz", many.astype(np.uint8), AFFINE), "no label that is known as the aorta")


def test_an_image_instead_of_labels(tmp_path: Path) -> None:
    hounsfield = np.random.default_rng(0).normal(0, 300, (20, 20, 20))
    refused(save_nifti(tmp_path / "a.nii.gz", hounsfield.astype(np.int16), AFFINE), "no label volume")
    refused(save_nifti(tmp_path / "b.nii.gz", hounsfield.astype(np.float32), AFFINE), "no whole numbers")


def test_noise(tmp_path: Path) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (120, 120, 60)).astype(np.uint8)
    refused(save_nifti(tmp_path / "a.nii.gz", noise, AFFINE), "noise|no label")
    speckles = np.where(np.random.default_rng(1).random((90, 90, 60)) < 0.05, 52, 0).astype(np.uint8)
    speckles[3, 3, 3] = 58
    refused(save_nifti(tmp_path / "b.nii.gz", speckles, AFFINE), "is noise")
    many = np.random.default_rng(2).integers(0, 105, (120, 120, 60)).astype(np.uint8)  # as TotalSegmentator's
    refused(save_nifti(tmp_path / "d.nii.gz", many, AFFINE), "is noise, or no label volume: .* 1 %")
    large = np.full((120, 120, 60), 52, np.uint8)
    refused(save_nifti(tmp_path / "c.nii.gz", large, np.diag([3.0, 3.0, 3.0, 1.0])), "litres")


def test_damaged_files(tmp_path: Path) -> None:
    for name in ("a.nii.gz", "a.nii", "a.nrrd"):
        (tmp_path / name).write_bytes(b"no volume at all")
        refused(tmp_path / name, "no NIfTI file|no sound NRRD|damaged")
    refused(tmp_path / "absent.nii.gz", "there is no file")
    path = save_nifti(tmp_path / "large.nii", tubes(), AFFINE)
    content = bytearray(path.read_bytes())
    content[42:48] = np.array([2000, 2000, 2000], "<i2").tobytes()
    path.write_bytes(content)
    refused(path, "GB of values")


def test_folders(tmp_path: Path) -> None:
    folder = tmp_path / "patient"
    folder.mkdir()
    assert not is_anatomy_path(str(folder))
    save_nifti(folder / "liver.nii.gz", tubes(), AFFINE)
    assert is_anatomy_path(str(folder))
    refused(folder, "no file that is named after the aorta")
    save_nifti(folder / "aorta.nii.gz", np.zeros_like(tubes()), AFFINE)
    refused(folder, "aorta.nii.gz is empty")
    save_nifti(folder / "aorta.nii.gz", (tubes() == 52).astype(np.uint8), AFFINE)
    save_nifti(folder / "subclavian_artery_left.nii.gz", (tubes() == 58).astype(np.uint8), np.diag([1.0, 1, 1, 1]))
    refused(folder, "different lattices")
    refused(folder, "no branch|no label", labels={"spleen": "aorta"})


def test_axes_in_inches_and_in_a_unit_that_is_not_known(tmp_path: Path) -> None:
    header = {"space": "LPS", "space directions": np.diag([1.0, 1, 1]) / 25.4, "space origin": [0.0, 0, 0]}
    nrrd.write(str(tmp_path / "a.nrrd"), tubes(), header | {"space units": ["inch"] * 3})
    np.testing.assert_allclose(read_labels(tmp_path / "a.nrrd").spacing, 1e-3)
    nrrd.write(str(tmp_path / "b.nrrd"), tubes(), header | {"space units": ["ell"] * 3})
    assert any("the unit ell" in note for note in read_labels(tmp_path / "b.nrrd").notes)


def test_a_folder_of_nifti_and_nrrd_whose_files_hold_more_than_they_say(tmp_path: Path) -> None:
    two = (tubes() == 52).astype(np.uint8)
    two[:, :, 20:] *= 2
    save_nifti(tmp_path / "aorta.nii.gz", two, AFFINE)
    save_nifti(tmp_path / "left_subclavian_old.nii.gz", tubes(), AFFINE)
    lps = np.diag([-1.0, -1.0, 1.0]) @ AFFINE[:3]
    header = {"space": "LPS", "space directions": lps[:, :3].T, "space origin": lps[:, 3]}
    for name in ("lsa.nrrd", "lsa_new.nrrd"):
        nrrd.write(str(tmp_path / name), (tubes() == 58).astype(np.uint8), header)
    volume = read_labels(tmp_path)
    for number, label in enumerate((52, 58), 1):
        np.testing.assert_array_equal(volume.vessels == number, (tubes() == label)[10:30, 10:20])
    labels, others, of_one_name = volume.notes
    assert "aorta.nii.gz holds labels 1, 2" in labels
    assert others.endswith(": left_subclavian_old")
    assert of_one_name.endswith(": lsa and lsa_new")
    save_nifti(tmp_path / "lsa.nii.gz", (tubes() == 52).astype(np.uint8), AFFINE)
    refused(tmp_path, r"lsa\.nii\.gz and lsa\.nrrd have one name")
    save_slicer(tmp_path / "n.seg.nrrd", tubes(), AFFINE, {52: "Aorta", 58: "aorta"})
    assert any(note.endswith(": Aorta and aorta") for note in read_labels(tmp_path / "n.seg.nrrd").notes)


def test_files_of_no_kind_that_is_read(tmp_path: Path) -> None:
    (tmp_path / "series").mkdir()
    for path in (tmp_path / "series" / "1.dcm", tmp_path / "aorta.step"):
        path.write_text("x")
        for load in (import_anatomy, load_phantom):
            with pytest.raises(MeshRefusedError, match=f"{path.name} is no file of a kind"):
                load(str(path))
    with pytest.raises(MeshRefusedError, match="series holds no file of a kind"):
        load_phantom(str(tmp_path / "series"))
    for name in ("", "x" * 5000):
        with pytest.raises(ValueError, match="unknown phantom"):
            load_phantom(name)


def test_a_reader_that_is_not_installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def without(name: str, *rest: Any, **more: Any) -> Any:
        if name in ("SimpleITK", "nibabel", "nrrd"):
            raise ModuleNotFoundError(name)
        return real(name, *rest, **more)

    paths = save_nifti(tmp_path / "a.nii.gz", tubes(), AFFINE), save_slicer(tmp_path / "a.nrrd", tubes(), AFFINE, {})
    monkeypatch.setattr(builtins, "__import__", without)
    for path in paths:
        with pytest.raises(MeshRefusedError, match=r"install 'endonav-cathsim\[volumes\]'"):
            read_labels(path)
    (tmp_path / "a.mha").write_text("x")
    with pytest.raises(MeshRefusedError, match=r"install 'endonav-cathsim\[metaimage\]'"):
        read_labels(tmp_path / "a.mha")


def whole(vessels: np.ndarray, first: tuple[int, int, int], shape: tuple[int, int, int]) -> LabelVolume:
    affine = np.diag([1e-3, 1e-3, 1e-3, 1.0])
    return LabelVolume(vessels, ("aorta",), affine, first, shape, np.eye(3), "a.nii", "mm", 1e-3, "names", True, ())


def test_repeated_voxels_are_one_again() -> None:
    before = np.random.default_rng(0).integers(1, 3, (12, 9, 11)).astype(np.uint8)
    fine = before.repeat(3, axis=0).repeat(2, axis=2)
    joined = join_repeated(whole(fine, (6, 1, 4), (60, 12, 30)))
    np.testing.assert_array_equal(joined.vessels, before)
    assert (joined.first, joined.shape) == ((2, 1, 2), (20, 12, 15))
    assert joined.affine @ [0, 0, 0, 1] == pytest.approx([1e-3, 0, 0.5e-3, 1])
    assert joined.spacing == pytest.approx([3e-3, 1e-3, 2e-3])
    assert "3 x 1 x 2 mm" in joined.notes[0]


SIDES = np.array([0.7, 0.8, 2.0])


def larger_tubes() -> np.ndarray:
    labels = np.zeros((64, 64, 30), dtype=np.uint8)
    labels[20:36, 20:36] = 52
    labels[36:50, 25:31, 12:18] = 58
    return labels


def turned() -> np.ndarray:
    """An affine that is turned about all axes, whose numbers rounding touches."""
    affine = np.eye(4)
    affine[:3, :3], affine[:3, 3] = oblique() * SIDES, [12.0, -30.0, 4.0]
    return affine


def save(path: Path, sform: np.ndarray | None, qform: np.ndarray | None) -> Path:
    image = nibabel.Nifti1Image(larger_tubes(), np.eye(4))
    image.header.set_zooms(SIDES if sform is None else np.linalg.norm(sform[:3, :3], axis=0))
    image.set_sform(sform, 0 if sform is None else 1)
    image.set_qform(qform, 0 if qform is None else 1)
    image.header.set_xyzt_units("mm")
    nibabel.save(image, path)
    return path


def test_a_mirrored_qform_is_noted_and_may_be_chosen(tmp_path: Path) -> None:
    mirrored = np.diag([-1.0, 1, 1, 1])
    path = save(tmp_path / "a.nii.gz", np.eye(4), mirrored)
    note = "the header's sform and qform lie up to 126 apart and exchange two sides of the patient: the sform is taken"
    assert any(one.startswith(note) for one in read_labels(path).notes)
    np.testing.assert_allclose(read_labels(path).affine[0, 0], 1e-3)
    np.testing.assert_allclose(read_labels(path, transform="qform").affine[0, 0], -1e-3)
    assert any("the qform is taken" in note for note in read_labels(path, transform="qform").notes)
    source = {"path": path, "unit": None, "names": None}
    digests = {import_digest(source | {"transform": one}, 1e-3) for one in (None, "sform", "qform")}
    assert len(digests) == 3


def test_a_transform_that_is_not_there(tmp_path: Path) -> None:
    path = save(tmp_path / "a.nii.gz", turned(), None)
    with pytest.raises(MeshRefusedError, match="has no qform"):
        import_anatomy(path, transform="qform", cache_dir=tmp_path)
    with pytest.raises(ValueError, match="transform must be one of sform, qform, got 'affine'"):
        import_anatomy(path, transform="affine", cache_dir=tmp_path)
    nrrd.write(str(tmp_path / "a.nrrd"), larger_tubes())
    with pytest.raises(MeshRefusedError, match="has one affine"):
        read_labels(tmp_path / "a.nrrd", transform="sform")
    (tmp_path / "a.stl").write_text("solid")
    with pytest.raises(MeshRefusedError, match="no label volume; leave transform="):
        import_anatomy(tmp_path / "a.stl", transform="sform", cache_dir=tmp_path)


@pytest.mark.parametrize(("told", "noted"), [(0.72, True), (0.701, False)])
def test_a_rounded_spacing_is_noted_where_it_matters(tmp_path: Path, told: float, noted: bool) -> None:
    image = nibabel.Nifti1Image(larger_tubes(), turned())
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


def test_files_of_a_folder_whose_affines_differ_by_rounding_are_one_lattice(tmp_path: Path) -> None:
    for name, value, noise in (("aorta", 52, 0.0), ("common_carotid_artery_left", 58, 2e-3)):
        affine = turned()
        affine[0, 0] += noise
        image = nibabel.Nifti1Image((larger_tubes() == value).astype(np.uint8), affine)
        nibabel.save(image, tmp_path / f"{name}.nii.gz")
    assert set(read_labels(tmp_path).names) == {"aorta", "lcca"}
