"""VTK PolyData is read in every way that VTK writes it."""

from __future__ import annotations

import base64
import zlib
from pathlib import Path

import numpy as np
import pytest
import trimesh

from cathsim.anatomy.mesh.reading import read_triangles
from cathsim.anatomy.mesh.report import MeshRefusedError

SPHERE = trimesh.creation.icosphere(2, 10.0)


def _packed(data: bytes, compressed: bool) -> list[bytes]:
    """Header and body of an array, as VTK writes them."""
    if not compressed:
        return [np.uint64(len(data)).tobytes() + data]
    half = len(data) // 2
    blocks = [zlib.compress(data[:half]), zlib.compress(data[half:])]
    header = np.array([2, half, len(data) - half, *map(len, blocks)], "<u8")
    return [header.tobytes(), b"".join(blocks)]


def write_vtp(path: Path, form: str, *, compressed: bool = False, quads: bool = False) -> Path:
    faces = np.asarray(SPHERE.faces)
    polygons = faces if not quads else np.concatenate([faces, faces[:, :1]], axis=1)
    arrays = {
        "points": ("Float64", np.asarray(SPHERE.vertices, "<f8")),
        "connectivity": ("Int64", polygons.astype("<i8")),
        "offsets": ("Int64", (polygons.shape[1] * np.arange(1, len(faces) + 1)).astype("<i8")),
    }
    appended = b""
    text = {}
    for name, (kind, values) in arrays.items():
        parts = _packed(values.tobytes(), compressed)
        components = ' NumberOfComponents="3"' if name == "points" else ""
        head = f'<DataArray type="{kind}" Name="{name}"{components}'
        if form == "ascii":
            text[name] = f'{head} format="ascii">{" ".join(map(str, values.ravel().tolist()))}</DataArray>'
        elif form == "binary":
            body = b"".join(map(base64.b64encode, parts)).decode()
            text[name] = f'{head} format="binary">\n{body}\n</DataArray>'
        else:
            text[name] = f'{head} format="appended" offset="{len(appended)}"/>'
            appended += b"".join(parts if form == "raw" else map(base64.b64encode, parts))
    attribute = ' compressor="vtkZLibDataCompressor"' if compressed else ""
    content = (
        f'<?xml version="1.0"?><VTKFile type="PolyData" version="1.0" byte_order="LittleEndian" header_type="UInt64"'
        f'{attribute}><PolyData><Piece NumberOfPoints="{len(SPHERE.vertices)}" NumberOfPolys="{len(faces)}">'
        f"<Points>{text['points']}</Points><Polys>{text['connectivity']}{text['offsets']}</Polys></Piece></PolyData>"
    ).encode()
    if form in ("raw", "base64"):
        content += f'<AppendedData encoding="{form}">_'.encode() + appended + b"</AppendedData>"
    path.write_bytes(content + b"</VTKFile>")
    return path


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("form", ["ascii", "binary", "raw", "base64"])
def test_all_encodings_give_the_same_triangles(form: str, compressed: bool, tmp_path: Path):
    mesh = read_triangles(write_vtp(tmp_path / "sphere.vtp", form, compressed=compressed))
    assert np.allclose(mesh.vertices, SPHERE.vertices)
    assert np.array_equal(mesh.faces, SPHERE.faces)


def test_polygons_are_divided(tmp_path: Path):
    assert len(read_triangles(write_vtp(tmp_path / "quads.vtp", "ascii", quads=True)).faces) == 2 * len(SPHERE.faces)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"no xml", "cannot be read as a mesh: it is no XML"),
        (b'<VTKFile type="ImageData"/>', "it holds ImageData, expected VTK PolyData"),
        (b'<VTKFile type="PolyData" compressor="vtkLZ4DataCompressor"/>', "compressed by vtkLZ4DataCompressor"),
        (b'<VTKFile type="PolyData"/>', "it holds no points or no polygons"),
    ],
)
def test_what_is_no_polydata_is_refused(content: bytes, message: str, tmp_path: Path):
    (tmp_path / "bad.vtp").write_bytes(content)
    with pytest.raises(MeshRefusedError, match=message):
        read_triangles(tmp_path / "bad.vtp")
