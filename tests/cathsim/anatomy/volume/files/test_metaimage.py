"""Label volumes in MetaImage files: places, data beside the header, and those that cannot be read."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cathsim.anatomy.importing import import_anatomy, import_digest
from cathsim.anatomy.mesh.report import MeshRefusedError
from cathsim.anatomy.volume.files.reading import open_volume, read_labels
from tests.cathsim.anatomy.volume.rasterising import tubes

SimpleITK = pytest.importorskip("SimpleITK", reason="MetaImage files need SimpleITK")

SPACING, ORIGIN = (0.8, 0.9, 2.0), (40.0, -30.0, 12.0)
TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def written(path: Path, labels: np.ndarray, *, packed: bool = False, vector: bool = False) -> Path:
    image = SimpleITK.GetImageFromArray(labels.T, isVector=vector)
    if image.GetDimension() == 3:
        image.SetSpacing(SPACING)
        image.SetOrigin(ORIGIN)
        image.SetDirection(TURN.ravel().tolist())
    image.SetMetaData("dim[0]", "3")  # a field as conversions of NIfTI leave them
    SimpleITK.WriteImage(image, str(path), packed)
    return path


@pytest.mark.parametrize(
    ("name", "packed", "kind"), [("a.mha", False, np.int16), ("a.mhd", False, np.uint8), ("a.mhd", True, np.float32)]
)
def test_voxels_lie_where_itk_says(tmp_path: Path, name: str, packed: bool, kind: type) -> None:
    volume = read_labels(written(tmp_path / name, tubes().astype(kind), packed=packed))
    assert volume.names == ("aorta", "lcca")
    np.testing.assert_allclose(volume.frame, np.eye(3))  # left, posterior, superior
    at = 1e-3 * (TURN @ (np.array(SPACING) * [10, 10, 0]) + ORIGIN)
    np.testing.assert_allclose((volume.affine @ [0, 0, 0, 1])[:3], at, atol=1e-9)
    np.testing.assert_array_equal(volume.vessels[:10, :10], 1)
    np.testing.assert_array_equal(volume.vessels[10:20, 3:7, 14:18], 2)
    assert np.count_nonzero(volume.vessels) == np.count_nonzero(tubes())


def test_a_header_without_axes_is_noted(tmp_path: Path) -> None:
    file = written(tmp_path / "a.mha", tubes())
    lines = file.read_bytes().split(b"\n", 13)
    file.write_bytes(b"\n".join(line for line in lines if not line.startswith(b"TransformMatrix")))
    assert "says nothing of the patient's axes" in open_volume(file).notes[0]
    assert not open_volume(written(tmp_path / "b.mha", tubes())).notes
    file.write_bytes(b"\n".join(line for line in lines if not line.startswith(b"ElementSpacing")))
    assert "does not say how large its voxels are" in open_volume(file).notes[0]


@pytest.mark.parametrize(
    ("damage", "match"),
    [
        (lambda content: b"hello", "is no MetaImage file"),
        (lambda content: content.replace(b"DimSize = 40", b"DimSize = no"), "is damaged: its header cannot be read"),
        (lambda content: content.replace(b"MET_UCHAR", b"MET_COLOR"), "is damaged: its header cannot be read"),
        (lambda content: content[:-5000], "is damaged: it ends before its last value"),
    ],
)
def test_what_is_damaged_is_refused(tmp_path: Path, damage: Callable[[bytes], bytes], match: str) -> None:
    file = written(tmp_path / "a.mha", tubes())
    file.write_bytes(damage(file.read_bytes()))
    with pytest.raises(MeshRefusedError, match=match):
        import_anatomy(file, cache_dir=tmp_path)


def test_what_is_no_volume_of_labels_is_refused(tmp_path: Path) -> None:
    series = written(tmp_path / "series.mha", np.zeros((8, 9, 8, 3), np.uint8))
    colours = written(tmp_path / "colours.mha", np.zeros((3, 8, 9, 8), np.uint8), vector=True)
    for file, match in (
        (series, r"has 4 axes \(8 x 9 x 8 x 3\)"),
        (colours, "has 3 values a voxel"),
    ):
        with pytest.raises(MeshRefusedError, match=match):
            import_anatomy(file, cache_dir=tmp_path)


@pytest.mark.parametrize("name", ["a.mhd", "a.nhdr"])
def test_data_beside_a_header_are_part_of_what_is_hashed(tmp_path: Path, name: str) -> None:
    header = tmp_path / name
    SimpleITK.WriteImage(SimpleITK.GetImageFromArray(tubes().T), str(header))
    data = next(file for file in tmp_path.iterdir() if file != header)
    source = {"path": header, "unit": None, "names": None}
    before = import_digest(source, 1e-3)
    assert import_digest(source, 1e-3) == before
    content = bytearray(data.read_bytes())
    content[-1] ^= 1
    data.write_bytes(content)
    assert import_digest(source, 1e-3) != before
    header.write_bytes(header.read_bytes().replace(data.name.encode(), b"x" * 5000))
    assert import_digest(source, 1e-3) != before
