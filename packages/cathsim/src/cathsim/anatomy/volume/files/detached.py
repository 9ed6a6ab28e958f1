"""Headers of volumes whose values lie in files of their own (.nhdr, .mhd), and the names of these files."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from cathsim.anatomy.volume.dicom.reading import beside
from cathsim.guarded_reading import UnreadableFileError, open_regular, referenced_file

HEADERS = (".nhdr", ".mhd")
HEADER_BYTES = 1 << 16
_DATA = ("datafile", "elementdatafile")


def header_fields(path: Path) -> tuple[dict[str, str], list[str], int]:
    """Fields of a MetaImage or NRRD header as far as the one that names the data.

    Returns:
        Values by key in small letters without spaces; the lines that follow it, without empty ones; and where in the
        file the line that names the data ends.

    Raises:
        UnreadableFileError: it is no regular file.
    """
    with open_regular(path) as file:
        content = file.read(HEADER_BYTES)
    fields: dict[str, str] = {}
    at = 0
    for line in content.splitlines(keepends=True):
        at += len(line)
        signs = [sign for sign in (line.find(b"="), line.find(b":")) if sign > 0]
        if not signs or b"\0" in line:
            if line.startswith((b"NRRD", b"#")):
                continue
            break
        cut = min(signs)
        key = line[:cut].decode(errors="replace").lower().replace(" ", "").strip()
        fields[key] = line[cut + 1 :].strip(b"= \t\r\n").decode(errors="replace")
        if key in _DATA:
            rest = (one.strip().decode(errors="replace") for one in content[at:].split(b"\n"))
            return fields, [name for name in rest if name], at
    return fields, [], at


def named_files(path: Path) -> list[str]:
    """Names of the files that a header names, as they stand there; none where the values follow it.

    Raises:
        UnreadableFileError: it is no regular file, or names files by a pattern.
    """
    fields, behind, _ = header_fields(path)
    name = next((fields[key] for key in _DATA if key in fields), "")
    words = name.split()
    if not words or name.upper() == "LOCAL":
        return []
    if words[0].upper() == "LIST":
        return behind
    if "%" in name:
        raise UnreadableFileError(f"{path.name} names its values' files by a pattern; save the volume as one file.")
    return [name]


def with_detached_data(files: Iterable[Path]) -> list[Path]:
    """The same files, each followed by those that it refers to: a header by its data, contours by their slices."""
    all_files = []
    for file in files:
        all_files.append(file)
        if file.suffix.lower() not in HEADERS:
            all_files += beside(file)
        elif file.is_file():
            try:
                all_files += [referenced_file(file, name) for name in named_files(file)]
            except UnreadableFileError:
                continue  # its reader says what is wrong
    return all_files
