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


OFF = "OFF\n4 4 6\n0 0 0\n3 0 0\n0 5 0\n0 0 7\n3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n"


@pytest.mark.parametrize(
    "content",
    [
        OFF,
        OFF.replace("OFF", "# made by hand\nCOFF").replace("0 5 0", "0 5 0 1.0 0.5 0.5 1.0  # red"),
        OFF.replace("3 1 2 3", " 3\t1 2 3 0.5 0.5 0.5").replace("\n", "\r\n\r\n"),
        OFF.replace("OFF\n", "OFF "),
        OFF.removeprefix("OFF\n"),
        codecs.BOM_UTF8 + OFF.encode(),
        OFF.encode("utf-16"),
    ],
)
def test_an_off_as_the_format_allows_it(content: str | bytes, tmp_path: Path):
    np.testing.assert_array_equal(_read(tmp_path / "a.off", content)[""], POINTS[FACES - 1])


@pytest.mark.parametrize("kind", ["obj", "off"])
def test_polygons_are_fans_of_triangles(kind: str, tmp_path: Path):
    angle = np.linspace(0, 2 * np.pi, 6, endpoint=False)
    points = np.c_[np.tile(np.c_[np.cos(angle), np.sin(angle)], (2, 1)), np.repeat([0, 1], 6)]
    walls = [[k, (k + 1) % 6, (k + 1) % 6 + 6, k + 6] for k in range(5)] + [[5, 0, 6], [5, 6, 11]]
    polygons = [list(range(5, -1, -1)), *walls, list(range(6, 12))]
    rows = [*("v {} {} {}".format(*row) for row in points), *(f"f {' '.join(str(k + 1) for k in p)}" for p in polygons)]
    if kind == "off":
        faces = [f"{len(polygon)} {' '.join(map(str, polygon))}" for polygon in polygons]
        rows = ["OFF", f"12 {len(polygons)} 0", *(row[2:] for row in rows[:12]), *faces]
    (corners,) = _read(tmp_path / f"a.{kind}", "\n".join(rows)).values()
    fans = [[polygon[0], *polygon[k : k + 2]] for polygon in polygons for k in range(1, len(polygon) - 1)]
    np.testing.assert_allclose(corners, points[fans])


@pytest.mark.parametrize(
    ("whole", "damage"),
    [
        ("3 1 2 3", "4 1 2 3"),
        ("3 1 2 3", "3 1 2 4"),
        ("3 1 2 3", "-3 1 2 3"),
        ("0 0 7", "0 0"),
        ("OFF", "OFF BINARY"),
        ("OFF", "4OFF"),
    ],
)
def test_a_damaged_off_is_refused(whole: str, damage: str, tmp_path: Path):
    with pytest.raises(MeshRefusedError, match="expected a triangle mesh in OFF format; export it again"):
        _read(tmp_path / "a.off", OFF.replace(whole, damage))
