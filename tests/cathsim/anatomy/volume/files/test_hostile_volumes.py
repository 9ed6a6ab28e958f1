"""Damaged and hostile volumes: no label changes without a word, nothing is read from elsewhere, nothing hangs."""

import bz2
import gzip
import os
import time
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cathsim.anatomy.importing import import_anatomy, import_digest
from cathsim.anatomy.mesh.report import MeshRefusedError
from cathsim.anatomy.volume.files import reading
from cathsim.anatomy.volume.files.reading import read_labels
from cathsim.guarded_reading import UnreadableFileError
from tests.cathsim.anatomy.volume.rasterising import whole_lattice

nibabel = pytest.importorskip("nibabel", reason="label volumes need nibabel")
nrrd = pytest.importorskip("nrrd", reason="label volumes need pynrrd")

OWN = {1: "aorta", 2: "lsa"}
NRRD = (
    "NRRD0004\ntype: uint8\ndimension: 3\nsizes: {sizes}\nspace: left-posterior-superior\n"
    "space directions: (1,0,0) (0,1,0) (0,0,1)\nspace origin: (0,0,0)\n{more}\n\n"
)
META = (
    "ObjectType = Image\nNDims = {axes}\nBinaryData = True\n{more}DimSize = {sizes}\nElementSpacing = 1 1 1\n"
    "ElementType = MET_UCHAR\nElementDataFile = {data}\n"
)


def tubes() -> np.ndarray:
    x, y = np.mgrid[:40, :40]
    labels = np.repeat(((x - 20) ** 2 + (y - 20) ** 2 < 80).astype(np.uint8)[..., None], 40, axis=2)
    labels[29:34, 18:22] = 2
    return labels


BYTES = tubes().tobytes(order="F")


def nifti() -> bytes:
    return gzip.compress(nibabel.Nifti1Image(tubes(), np.eye(4)).to_bytes(), mtime=0)


def packed_nrrd(encoding: str) -> bytes:
    packed = gzip.compress(BYTES, mtime=0) if encoding == "gzip" else bz2.compress(BYTES)
    return NRRD.format(sizes="40 40 40", more=f"encoding: {encoding}").encode() + packed


def packed_meta() -> bytes:
    packed = zlib.compress(BYTES)
    more = f"CompressedData = True\nCompressedDataSize = {len(packed)}\n"
    return META.format(axes=3, more=more, sizes="40 40 40", data="LOCAL").encode() + packed


WRITERS = {
    "a.nii.gz": nifti,
    "a.nrrd": lambda: packed_nrrd("gzip"),
    "b.nrrd": lambda: packed_nrrd("bzip2"),
    "a.mha": packed_meta,
}


def written(path: Path, content: bytes | str) -> Path:
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def read(path: Path) -> np.ndarray:
    if path.name.endswith((".mha", ".mhd")):
        pytest.importorskip("SimpleITK", reason="MetaImage files need SimpleITK")
    return whole_lattice(read_labels(path, OWN))


def refused(path: Path, match: str | None = None) -> None:
    if path.name.endswith((".mha", ".mhd")):
        pytest.importorskip("SimpleITK", reason="MetaImage files need SimpleITK")
    began = time.monotonic()
    with pytest.raises(MeshRefusedError, match=match) as caught:
        read_labels(path, OWN)
    assert time.monotonic() - began < 20.0
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 500


def called_here(function: Callable[..., Any], *arguments: Any, subject: str, seconds: float) -> Any:
    """In the place of `call_in_child`, whose fork takes longer than the reading; raises the same errors."""
    try:
        return function(*arguments)
    except MeshRefusedError:
        raise
    except Exception as error:
        raise UnreadableFileError(subject) from error


@pytest.mark.parametrize("name", WRITERS)
def test_a_flipped_bit_changes_no_label(tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    sound = WRITERS[name]()
    np.testing.assert_array_equal(read(written(tmp_path / name, sound)), tubes())
    monkeypatch.setattr(reading, "call_in_child", called_here)
    begin = sound.index(b"\n\n") + 2 if name.endswith(".nrrd") else len(sound) - len(zlib.compress(BYTES))
    begin = 0 if name.endswith(".gz") else begin
    outcomes = []
    for k in range(40):
        damaged = bytearray(sound)
        damaged[begin + k * (len(sound) - begin) // 40] ^= 1 << k % 8
        try:
            np.testing.assert_array_equal(read(written(tmp_path / name, bytes(damaged))), tubes())
            outcomes.append("same")
        except MeshRefusedError:
            outcomes.append("refused")
    assert outcomes.count("refused") >= 30


@pytest.mark.parametrize("name", WRITERS)
def test_what_is_cut_or_followed_by_something_is_refused(tmp_path: Path, name: str) -> None:
    sound = WRITERS[name]()
    for cut in (1, 5, 9, 200):
        refused(written(tmp_path / name, sound[:-cut]), "damaged")
    refused(written(tmp_path / name, sound + b"something else"))


def test_values_in_a_file_of_their_own_are_read_to_their_end(tmp_path: Path) -> None:
    for encoding, packed in (("gzip", gzip.compress(BYTES)), ("raw", BYTES)):
        more = f"encoding: {encoding}\ndata file: values.bin"
        header = written(tmp_path / f"{encoding}.nhdr", NRRD.format(sizes="40 40 40", more=more).rstrip("\n") + "\n")
        written(tmp_path / "values.bin", packed)
        np.testing.assert_array_equal(read(header), tubes())
        written(tmp_path / "values.bin", packed[:-4])
        refused(header, "damaged")
        written(tmp_path / "values.bin", packed + b"more")
        refused(header, "damaged")


def test_lines_and_bytes_that_a_header_skips(tmp_path: Path) -> None:
    values = {"line skip: 2\nbyte skip: 3": b"a\nb\nxyz" + BYTES, "byte skip: -1": b"anything" + BYTES}
    for skip, content in values.items():
        more = f"encoding: raw\n{skip}"
        header = NRRD.format(sizes="40 40 40", more=more).encode()
        np.testing.assert_array_equal(read(written(tmp_path / "a.nrrd", header + content)), tubes())
    text = " ".join(map(str, tubes().ravel(order="F"))).encode()
    header = NRRD.format(sizes="40 40 40", more="encoding: text").encode()
    np.testing.assert_array_equal(read(written(tmp_path / "a.nrrd", header + text)), tubes())
    many = NRRD.format(sizes="40 40 40", more="encoding: raw\nline skip: 1000000000").encode()
    refused(written(tmp_path / "a.nrrd", many + BYTES), "ends within the lines")


@pytest.mark.parametrize(
    ("name", "content", "match"),
    [
        ("two_sizes.nrrd", NRRD.format(sizes="40 40", more="encoding: raw"), "2 sizes for 3 axes"),
        ("huge.nrrd", NRRD.format(sizes="4294967296 4294967296 4", more="encoding: raw"), "GB of values"),
        ("empty.nrrd", NRRD.format(sizes="0 40 40", more="encoding: raw"), "sizes below 1"),
        ("list.nhdr", NRRD.format(sizes="40 40 40", more="encoding: raw\ndata file: LIST"), "several files"),
        ("pattern.nhdr", NRRD.format(sizes="40 40 40", more="encoding: raw\ndata file: %03d.raw 1 9 1"), "a pattern"),
        ("away.nhdr", NRRD.format(sizes="40 40 40", more="encoding: raw\ndata file: ../a.raw"), "its own folder"),
        ("printf.mhd", META.format(axes=3, more="", sizes="40 40 40", data="%s%s%n%n.raw 1 64 1"), "by a pattern"),
        ("large.mhd", META.format(axes=3, more="", sizes="1600 1600 1600", data="LOCAL"), "thousand million values"),
        ("minus_one.mhd", META.format(axes=-1, more="", sizes="40 40 40", data="x"), "header cannot be read"),
        ("axes.mhd", META.format(axes=999999, more="", sizes="40 40 40", data="x"), "header cannot be read"),
        ("any_file.mhd", META.format(axes=3, more="", sizes="40 40 40", data="/etc/passwd"), "its own folder"),
        ("missing.mhd", META.format(axes=3, more="", sizes="40 40 40", data="x.raw"), "not beside it"),
        ("spaces.mhd", " " * 65_000, "no MetaImage file"),
        ("newlines.mhd", "\n" * 65_530, "no MetaImage file"),
        ("name.mhd", META.format(axes=3, more="", sizes="40 40 40", data="a" + " " * 65_000 + "b"), "not beside it"),
    ],
)
def test_headers_that_ask_for_too_much(tmp_path: Path, name: str, content: str, match: str) -> None:
    refused(written(tmp_path / name, content), match)


def test_a_bomb_is_read_to_what_its_header_says(tmp_path: Path) -> None:
    packed = zlib.compress(bytes(200_000_000), 9)
    more = f"CompressedData = True\nCompressedDataSize = {len(packed)}\n"
    content = META.format(axes=3, more=more, sizes="40 40 40", data="LOCAL").encode() + packed
    refused(written(tmp_path / "a.mha", content), "more values than the 64000 bytes")


def test_pipes_are_no_data(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.raw")
    refused(written(tmp_path / "a.mhd", META.format(axes=3, more="", sizes="40 40 40", data="pipe.raw")), "no regular")
    more = "encoding: raw\ndata file: pipe.raw"
    refused(written(tmp_path / "a.nhdr", NRRD.format(sizes="40 40 40", more=more)), "no regular")
    os.mkfifo(tmp_path / "b.nii.gz")
    refused(tmp_path / "b.nii.gz", "no regular file")
    with pytest.raises(MeshRefusedError, match="no regular file"):
        import_anatomy(tmp_path / "b.nii.gz", cache_dir=tmp_path)


def test_slices_in_files_of_their_own_are_read_and_part_of_the_hash(tmp_path: Path) -> None:
    names = [f"{k}.raw" for k in range(40)]
    for k, name in enumerate(names):
        written(tmp_path / name, tubes()[:, :, k].tobytes(order="F"))
    header = written(
        tmp_path / "a.mhd", META.format(axes=3, more="", sizes="40 40 40", data="LIST\n" + "\n".join(names))
    )
    np.testing.assert_array_equal(read(header), tubes())
    source = {"path": header, "unit": None, "names": None}
    before = import_digest(source, 1e-3)
    written(tmp_path / "20.raw", bytes(1600))
    assert import_digest(source, 1e-3) != before
    (tmp_path / "20.raw").unlink()
    (tmp_path / "20.raw").symlink_to("/etc/passwd")
    refused(header, "its own folder")


def test_an_analyze_file_is_to_be_converted(tmp_path: Path) -> None:
    nibabel.save(nibabel.AnalyzeImage(tubes().astype(np.int16), np.eye(4)), tmp_path / "analyze.img")
    for name in ("analyze.img", "analyze.hdr"):
        refused(tmp_path / name, "no NIfTI file but one of the kind")
        with pytest.raises(MeshRefusedError, match=f"{name} is no file of a kind that is read"):
            import_anatomy(tmp_path / name, cache_dir=tmp_path)


def test_a_reader_that_takes_too_much_memory_ends_in_a_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def greedy(*_: object) -> None:
        np.ones(1 << 34)

    monkeypatch.setattr("cathsim.anatomy.volume.files.reading.choose_labels", greedy)
    refused(written(tmp_path / "a.nii.gz", nifti()), "takes more than 4 GB of memory")


@pytest.mark.parametrize("size", [0, 10])
def test_files_of_no_content_are_refused_in_a_sentence(size: int, tmp_path: Path) -> None:
    for ending in ("nrrd", "seg.nrrd", "nhdr", "nii", "nii.gz", "mha", "mhd", "dcm", "stl", "glb", "vtp"):
        path = written(tmp_path / f"aorta.{ending}", b"NRRD0005\n\n"[:size])
        with pytest.raises(MeshRefusedError, match=rf"^aorta\.{ending} .+[.\w]$"):
            import_anatomy(path)
