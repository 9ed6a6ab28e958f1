"""Real vessels with a public address, read from `evaluation/sources.yaml`, and where they are on this machine."""

from __future__ import annotations

import os
from dataclasses import field
from pathlib import Path
from typing import Annotated, Literal, TypeVar
from urllib.parse import quote

import yaml
from pydantic import ConfigDict, Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass as checked

from pipeline.store.errors import ConfigurationError
from pipeline.store.provenance import hash_file, project_file

Hex = Annotated[str, Field(pattern="^[0-9a-f]+$")]
Name = Annotated[str, Field(pattern="^[a-z0-9_]+$")]
_STRICT = ConfigDict(extra="forbid")
_Declared = TypeVar("_Declared")


@checked(frozen=True, config=_STRICT)
class SourceFile:
    """A file of a source: its path in the repository, its size and SHA-256."""

    path: Annotated[str, Field(pattern=r"^[^/\\.][^/\\]*(/[^/\\.][^/\\]*)*$")]
    bytes: Annotated[int, Field(gt=0)]
    sha256: Annotated[Hex, Field(min_length=64, max_length=64)]

    @property
    def name(self) -> str:
        """Its name without folders."""
        return self.path.rsplit("/", 1)[-1]


@checked(frozen=True, kw_only=True, config=_STRICT)
class Source:
    """Vessels of one origin.

    Attributes:
        use: `seen`, `open` or `reserved`: whether something was chosen on it, it was looked at, or neither.
        vessels: what it shows, as its documents say.
        repository, commit: of the public repository.
        branches: right names, where they are known.
        unit: of files that have none; None: it is detected.
    """

    use: Literal["seen", "open", "reserved"]
    vessels: Literal["arch", "abdomen", "carotid", "pulmonary"]
    repository: str
    commit: Hex
    licence: str
    files: Annotated[tuple[SourceFile, ...], Field(min_length=1)]
    branches: tuple[str, ...] = ()
    unit: Literal["m", "cm", "mm"] | None = None

    @property
    def size(self) -> int:
        """Of all files, bytes."""
        return sum(file.bytes for file in self.files)


@checked(frozen=True)
class Sources:
    """All sources by name, and where they are kept."""

    address: str  # of a file, with the fields {repository}, {commit} and {path}
    entries: Annotated[dict[Name, Source], Field(alias="sources")]
    folder: Path = field(default_factory=lambda: data_folder())

    def select(self, names: list[str]) -> list[str]:
        """The names, or without any all of them; a ConfigurationError lists them if one is unknown."""
        for name in names:
            if name not in self.entries:
                raise ConfigurationError(f"there is no source {name!r}: choose from {', '.join(self.entries)}")
        return names or list(self.entries)

    def url(self, name: str, file: SourceFile) -> str:
        """The public address of a file."""
        source = self.entries[name]
        return self.address.format(repository=source.repository, commit=source.commit, path=quote(file.path))

    def place(self, name: str, file: SourceFile) -> Path:
        """Where a file is kept."""
        return self.folder / name / file.name

    def anatomy(self, name: str) -> Path:
        """What is imported: the only file of a source, or the folder of all."""
        files = self.entries[name].files
        return self.place(name, files[0]) if len(files) == 1 else self.folder / name

    def missing(self, name: str) -> list[SourceFile]:
        """Files that are not here, or are others than they should be."""
        places = [(file, self.place(name, file)) for file in self.entries[name].files]
        return [file for file, place in places if not (place.is_file() and hash_file(place) == file.sha256)]


def data_folder() -> Path:
    """Where data are kept: $ENDONAV_DATA, else `endonav` in the user's cache directory."""
    if chosen := os.environ.get("ENDONAV_DATA"):
        return Path(chosen).expanduser()
    base = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA") or "~/.cache"
    return Path(base).expanduser() / "endonav"


def private_data(name: str) -> Path:
    """A file or folder of data that are not public, which somebody put into the data folder.

    Raises:
        ConfigurationError: it is not there.
    """
    path = data_folder() / name
    if not path.exists():
        raise ConfigurationError(f"{path} is missing: it is not public, so put it there")
    return path


def read_sources(path: Path | None = None) -> Sources:
    """Reads the sources, by default the project's; errors are those of `read_declared`."""
    return read_declared(path or project_file("evaluation/sources.yaml"), Sources, "has no sources")


def read_declared(path: Path, kind: type[_Declared], otherwise: str) -> _Declared:
    """Reads a YAML file as a class of pydantic.

    Raises:
        ConfigurationError: it is missing, no YAML, which `otherwise` words, or an entry is not understood.
    """
    try:
        return TypeAdapter(kind).validate_python(yaml.safe_load(path.read_text(encoding="utf-8")))
    except OSError as error:
        raise ConfigurationError(f"{path} cannot be read: {error.strerror}") from None
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        raise ConfigurationError(f"{path}{f': {place}' if place else ''}: {first['msg']}") from None
    except (yaml.YAMLError, ValueError) as error:
        raise ConfigurationError(f"{path} {otherwise} ({error})") from None
