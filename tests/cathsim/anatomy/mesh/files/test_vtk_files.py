"""VTK PolyData is read in every way that VTK writes it; what is damaged, or swells, is refused."""

import time
import tracemalloc
import zlib
from pathlib import Path

import numpy as np
import pytest

from cathsim.anatomy.mesh.parts.vessel_parts import Surface, read_parts
from cathsim.anatomy.mesh.reading import read_surfaces
from cathsim.anatomy.mesh.report import MeshRefusedError

WRITTEN = Path(__file__).parent / "vtk"
FILES = sorted(path.name for path in WRITTEN.iterdir() if path.suffix in (".vtp", ".vtk", ".stl", ".ply"))
FACES = 36
AREA = 1057.45  # of the sphere with six by five points
FRAMES = {"ras": [-1, -1, 1], "lps": [1, 1, 1]}  # the patient's left, posterior and superior axis


def _check(surface: Surface, name: str) -> None:
    mesh = surface.parts[0].mesh
    a, b, c = np.moveaxis(mesh.corners, 1, 0)
    assert (surface.faces, len(surface.parts), len(mesh.faces)) == (FACES, 1, FACES)
    assert 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() == pytest.approx(AREA, abs=0.02)
    np.testing.assert_allclose(np.linalg.norm(mesh.vertices, axis=1), 10.0, atol=2e-4)
    frame = FRAMES.get(name[:3])
    assert (None if surface.frame is None else np.diag(surface.frame).tolist()) == frame
    assert surface.notes == ()


@pytest.mark.parametrize("name", [name for name in FILES if name != "grid.vtk"])
def test_files_that_vtk_wrote(name: str):
    if "lz4" in name:
        pytest.importorskip("lz4")
    _check(read_parts(WRITTEN / name), name)


def test_an_older_file_of_version_3_without_metadata(tmp_path: Path):
    text = (WRITTEN / "polys_ascii_42.vtk").read_text().replace("Version 4.2", "Version 3.0")
    assert "METADATA" in text
    head, rest = text.split("METADATA")
    (tmp_path / "old.vtk").write_text(head + rest[rest.index("POLYGONS") :])
    _check(read_parts(tmp_path / "old.vtk"), "old")


PLACE = '<Points><DataArray type="Float64" NumberOfComponents="3" format="{}</DataArray></Points>'
POINTS = PLACE.format('ascii">0 0 0 1 0 0 0 1 0 0 0 1')
ARRAY = '<DataArray type="Int64" Name="{}" format="ascii">{}</DataArray>'
HEAD = '<VTKFile type="PolyData" header_type="UInt64"{}><PolyData><Piece NumberOfPoints="4">'


def _vtp(connectivity: str, ends: str) -> bytes:
    cells = ARRAY.format("connectivity", connectivity) + ARRAY.format("offsets", ends)
    empty = ARRAY.format("connectivity", "") + ARRAY.format("offsets", " \n ")
    polys = f"<Strips>{empty}</Strips><Polys>{cells}</Polys></Piece></PolyData></VTKFile>"
    return (HEAD.format("") + POINTS + polys).encode()


def test_empty_strips_beside_polygons_of_several_sizes(tmp_path: Path):
    (tmp_path / "a.vtp").write_bytes(_vtp("0 2 1  0 1 3 2  0 3 2  1 2 3", "3 7 10 13"))
    faces = read_surfaces(tmp_path / "a.vtp")[0].mesh.faces
    assert faces.tolist() == [[0, 2, 1], [0, 1, 3], [0, 3, 2], [0, 3, 2], [1, 2, 3]]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"no xml", "cannot be read as a mesh: it is no XML"),
        (b'<VTKFile type="ImageData"/>', "it holds ImageData, expected VTK PolyData"),
        (b'<VTKFile type="PolyData" compressor="vtkOther"/>', "compressed by vtkOther, expected zlib"),
        (b'<VTKFile type="PolyData"/>', "it holds no points or no polygons"),
        (_vtp("0 1 2 0 1 2", "6 3"), "its polygons do not lie within their list"),
        (_vtp("0 1 99 0 1 2", "3 6"), "it has faces of points that it does not have"),
        (_vtp("0 1 2 0,5 1", "3 5"), "something else than numbers stands among its numbers"),
    ],
)
def test_what_is_no_sound_polydata_is_refused(content: bytes, message: str, tmp_path: Path):
    (tmp_path / "bad.vtp").write_bytes(content)
    with pytest.raises(MeshRefusedError, match=message):
        read_surfaces(tmp_path / "bad.vtp")


LEGACY = "# vtk DataFile Version {}\na\nASCII\nDATASET POLYDATA\nPOINTS 4 float\n0 0 0 1 0 0 0 1 0 0 0 1\n{}\n"
LISTS = "{} 3 6\nOFFSETS vtktypeint64\n0 3 {}\nCONNECTIVITY vtktypeint64\n0 1 2 0 1 2"


@pytest.mark.parametrize("end", [5_000_000, -5_000_000])
@pytest.mark.parametrize("cells", ["Polys", "Strips", "POLYGONS", "TRIANGLE_STRIPS", "POLYGONS of version 4"])
def test_an_offset_beyond_its_list_takes_no_memory(cells: str, end: int, tmp_path: Path):
    path = tmp_path / ("a.vtk" if cells.isupper() or "version" in cells else "a.vtp")
    if path.suffix == ".vtp":
        path.write_bytes(_vtp("0 1 2", f"3 {end}").replace(b"Strips", b"Lines").replace(b"Polys", cells.encode()))
    elif cells.isupper():
        path.write_text(LEGACY.format("5.1", LISTS.format(cells, end)))
    else:
        path.write_text(LEGACY.format("4.2", f"POLYGONS 2 8\n3 0 1 2 {end} 0 1 2"))
    tracemalloc.start()
    try:
        with pytest.raises(MeshRefusedError, match="its polygons do not lie within their list of points"):
            read_surfaces(path)
        assert tracemalloc.get_traced_memory()[1] < 5e6
    finally:
        tracemalloc.stop()


def test_files_that_are_cut_off_or_no_polydata_are_refused(tmp_path: Path):
    with pytest.raises(MeshRefusedError, match="it holds DATASET UNSTRUCTURED_GRID, expected POLYDATA"):
        read_surfaces(WRITTEN / "grid.vtk")
    for name in set(FILES) - {"grid.vtk"}:
        whole = (WRITTEN / name).read_bytes()
        path = tmp_path / name
        path.write_bytes(whole[: len(whole) // 2])
        with pytest.raises(MeshRefusedError, match="cannot be read as a "):
            read_surfaces(path)


@pytest.mark.parametrize("name", ["ras_appended_zlib_32_little.vtp", "strips_appended_lzma_64_little.vtp"])
def test_the_checksum_of_every_block_is_reached(name: str, tmp_path: Path):
    sound = (WRITTEN / name).read_bytes()
    end = sound.rindex(b"</AppendedData>")
    start = sound.index(b"_", sound.index(b"<AppendedData")) + 1
    expected, other = read_surfaces(WRITTEN / name)[0].mesh, 0
    for at in range(start, end, 3):
        damaged = bytearray(sound)
        damaged[at] ^= 1 << at % 8
        (tmp_path / name).write_bytes(damaged)
        try:
            mesh = read_surfaces(tmp_path / name)[0].mesh
        except MeshRefusedError:
            continue
        same = np.array_equal(mesh.vertices, expected.vertices) and np.array_equal(mesh.faces, expected.faces)
        other += not same
    assert other == 0


def test_a_small_file_that_unpacks_to_much_is_refused_at_once(tmp_path: Path):
    size = 1 << 30
    block = zlib.compress(bytes(1 << 24), 9)
    blocks = size >> 24
    header = np.array([blocks, 1 << 24, 0, *[len(block)] * blocks], "<u8").tobytes()
    content = HEAD.format(' compressor="vtkZLibDataCompressor"') + PLACE.format('appended" offset="0">')
    content += '</Piece></PolyData><AppendedData encoding="raw">_'
    path = tmp_path / "bomb.vtp"
    path.write_bytes(content.encode() + header + block * blocks + b"</AppendedData></VTKFile>")
    assert path.stat().st_size < size / 500
    start = time.monotonic()
    with pytest.raises(MeshRefusedError, match=r"it has an array of 1\.07 GB, at most 0\.72 GB are read"):
        read_parts(path)
    assert time.monotonic() - start < 5
