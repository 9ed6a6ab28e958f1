"""Text files: byte order marks, separators, decimal commas, what is no text."""

from __future__ import annotations

import codecs
import os
from pathlib import Path

import pytest

from guide3d.files import files_in
from guide3d.text_file import cells_of, numbers_in, read_json, read_text


@pytest.mark.parametrize(
    ("line", "numbers"),
    [
        ("1.5,-2,3e2", [1.5, -2, 300]),
        ("1.5, -2, 3", [1.5, -2, 3]),
        ("1.5;-2;3", [1.5, -2, 3]),
        ("1,5;-2;3,25e1", [1.5, -2, 32.5]),
        ("1,5\t-2,5\t3", [1.5, -2.5, 3]),
        ("1,5  -2,5 3", [1.5, -2.5, 3]),
        ("1.5 -2.5   3", [1.5, -2.5, 3]),
        ('"1,5","-2,5","3"', [1.5, -2.5, 3]),
        ("1,2,,,", [1, 2]),
        ("1;2;\r", [1, 2]),
        ("4711", [4711]),
        ("1,5", [1, 5]),
        ("1.234,5;2;3", None),  # neither a thousand nor a decimal is sure
        ("1_000,2", None),
        ("x,y,z", None),
        ("1,,2", None),
        ("", []),
    ],
)
def test_numbers_of_a_line(line: str, numbers: list[float] | None) -> None:
    assert numbers_in(line) == numbers


def test_a_cell_without_end_is_one_line_of_no_numbers() -> None:
    assert numbers_in('"' + "1," * 100_000) is None
    assert cells_of("x ; y") == ["x", "y"]


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_text_with_and_without_a_mark(encoding: str, tmp_path: Path) -> None:
    path = tmp_path / "marks.json"
    path.write_bytes('["ä"]'.encode(encoding))
    assert read_text(path, "file") == '["ä"]'
    assert read_json(path, "file") == ["ä"]


def test_what_is_no_text_is_refused(tmp_path: Path) -> None:
    (tmp_path / "binary").write_bytes(b"\x89PNG\r\n")
    (tmp_path / "half").write_bytes(codecs.BOM_UTF16_LE + b"a")
    os.mkfifo(tmp_path / "pipe")
    for name in ("binary", "half"):
        with pytest.raises(ValueError, match=f"{name}: expected a text file, a camera file, found binary data"):
            read_text(tmp_path / name, "camera file")
    for name in ("pipe", ""):
        with pytest.raises(ValueError, match="is no regular file"):
            read_text(tmp_path / name, "camera file")
    with pytest.raises(FileNotFoundError, match=r"^camera file .*none is missing$"):
        read_text(tmp_path / "none", "camera file")
    with (tmp_path / "large").open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(ValueError, match=r"large has 1.1e.03 GB, at most .* are read"):
        read_text(tmp_path / "large", "camera file")


def test_names_in_any_capitals_and_numeric_order(tmp_path: Path) -> None:
    for name in ("10.png", "2.PNG", "a2b10.png", "a2b9.png", "A1.png", "._2.png", ".png", "x.jpg"):
        (tmp_path / name).touch()
    names = [file.name for file in files_in(tmp_path, "*.PNG")]
    assert names == ["2.PNG", "10.png", "A1.png", "a2b9.png", "a2b10.png"]
    assert not files_in(tmp_path / "none", "*")
