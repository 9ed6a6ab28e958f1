"""OBJ and OFF as their formats allow them: relative indices, comments, tabs, byte-order marks, polygons."""

import codecs
from pathlib import Path

import numpy as np
import pytest

from cathsim.anatomy.mesh.reading import read_surfaces
from cathsim.anatomy.mesh.report import MeshRefusedError

POINTS = np.array([[0, 0, 0], [3, 0, 0], [0, 5, 0], [0, 0, 7]])
FACES = np.array([[1, 3, 2], [1, 2, 4], [1, 4, 3], [2, 3, 4]])
RELATIVE = FACES - 5  # -1: the vertex before the face


def _obj(points: np.ndarray = POINTS, faces: np.ndarray = FACES) -> str:
    return "".join("{} {} {} {}\n".format(key, *row) for key, rows in (("v", points), ("f", faces)) for row in rows)


def _read(path: Path, content: str | bytes) -> dict[str, np.ndarray]:
    """Corners of the triangles of each surface."""
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return {surface.name: surface.mesh.corners for surface in read_surfaces(path)}


def test_relative_indices_of_obj_count_from_the_vertices_read_so_far(tmp_path: Path):
    shifted = POINTS + np.array([100, 0, 0])
    parts = f"o aorta\n{_obj(POINTS, RELATIVE)}o lsa\n{_obj(shifted, RELATIVE)}"
    found = _read(tmp_path / "a.obj", parts)
    assert list(found) == ["aorta", "lsa"]
    np.testing.assert_array_equal(found["aorta"], POINTS[FACES - 1])
    np.testing.assert_array_equal(found["lsa"], shifted[FACES - 1])
    (whole,) = _read(tmp_path / "a.obj", parts.replace("o ", "# ").replace("f -4", "f -4/-1/-1")).values()
    np.testing.assert_array_equal(whole, np.concatenate([POINTS[FACES - 1], shifted[FACES - 1]]))


@pytest.mark.parametrize(
    "content",
    [
        _obj().replace(" ", "\t"),
        _obj().replace("v", "  v").replace("f", "\tf"),
        _obj().replace("\n", "  # made by hand\n"),
        _obj().replace("\n", " # 1\r\n"),
        _obj().replace("\n", "\r"),
        _obj().replace(" 4\n", " \\\n 4\n"),
        codecs.BOM_UTF8 + _obj().encode(),
        _obj().encode("utf-16"),
        f"vt 0 0\nvn 0 0 1\n{_obj()}l 1 2\n",
        _obj().replace("0\n", "0 1.0 0.5 0.5 0.5\n", 1).replace("f 1", "f 1/1/1"),
    ],
)
def test_an_obj_as_the_format_allows_it(content: str | bytes, tmp_path: Path):
    np.testing.assert_array_equal(_read(tmp_path / "a.obj", content)[""], POINTS[FACES - 1])


def test_faces_before_the_first_object_and_of_an_object_in_two_places(tmp_path: Path):
    faces = _obj(POINTS[:0])
    found = _read(tmp_path / "a.obj", f"{codecs.BOM_UTF8.decode()}o aorta\n{_obj()}\to lsa\n{faces}o aorta\n{faces}")
    assert {name: len(corners) for name, corners in found.items()} == {"aorta": 8, "lsa": 4}
    found = _read(tmp_path / "a.obj", f"{_obj()}o\taorta\n{faces}")
    assert {name: len(corners) for name, corners in found.items()} == {"default": 4, "aorta": 4}


@pytest.mark.parametrize("damage", ["f 0 1 2\n", "f -5 1 2\n", "f 1 2 5\n", "f 1 2 x\n", "v 1 2\n", "v 1 2 3,5\n"])
def test_a_damaged_obj_is_refused(damage: str, tmp_path: Path):
    with pytest.raises(MeshRefusedError, match="expected a triangle mesh in OBJ format; export it again"):
        _read(tmp_path / "a.obj", _obj() + damage)
