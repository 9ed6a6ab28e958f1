"""The sources that a stage's results depend on: its module, whatever that imports, and the files those read.

Found by reading the sources, not by importing them, among the project's own packages. A package's native code and data
(C sources, templates, tables) belong to the module that names them beside its own file.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib.util
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pipeline.store.file_cache import FileCache
from pipeline.store.provenance import hash_file
from pipeline.store.source_references import references
from pipeline.store.user_cache import user_cache

PACKAGES = ("pipeline", "cathsim", "enn", "guide3d", "splineformer")
# These carry work out, share out memory, keep files and check what the user wrote: results do not depend on them.
WITHOUT_EFFECT = frozenset(
    f"pipeline.{name}"
    for name in (
        "config", "execution", "explain", "jobs", "launch", "settings.checks", "settings.kinds", "stages", "store",
        "variants",
    )
)  # fmt: skip
_FOLDERS_WITHOUT_EFFECT = ("pipeline.jobs.", "pipeline.store.")
# But these decide what the files of a stage hold.
_WITH_EFFECT = frozenset({"pipeline.jobs.costs", "pipeline.store.atomic_files"})
_NO_DATA = {".py", ".pyc", ".so", ".pyd", ".o"}


class SourceClosure:
    """The sources behind modules, with a cache of what each file refers to."""

    def __init__(self, cache: Path | None = None, roots: Mapping[str, Path] | None = None) -> None:
        """Args:
        cache: file that remembers what was read; None: nothing is kept.
        roots: top-level packages whose modules are followed, with their folders; by default the project's own.
        """
        own = Path(__file__)
        version = hash_file(own) + hash_file(own.with_name("source_references.py"))
        self._cache = FileCache(cache, Path("/"), version=version)
        self._roots = dict(installed_packages() if roots is None else roots)
        self._files: dict[str, Path | None] = {}
        self._references: dict[Path, dict[str, Any]] = {}

    def modules(self, *names: str) -> set[str]:
        """The modules that some modules reach, those themselves and the packages around all of them.

        Raises:
            ModuleNotFoundError: one is none of the packages'.
        """
        found: set[str] = set()
        for name in names:
            if self._file(name) is None:
                raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        todo = list(names)
        while todo:
            name = todo.pop()
            if name in found or is_without_effect(name) or self._file(name) is None:
                continue
            found.add(name)
            todo += [name.rpartition(".")[0], *self._referred(name)]
        return found

    def files(self, *names: str) -> dict[str, Path]:
        """The files that results of modules depend on: sources of all modules reached, and what those read.

        Returns:
            A name that is the same on every machine to the file.
        """
        files: dict[str, Path] = {}
        for name in self.modules(*names):
            file, root = self._require(name), self._roots[name.partition(".")[0]]
            for one in (file, *self._data(name, file, root)):
                files[f"{root.name}/{one.relative_to(root).as_posix()}"] = one
        return files

    def hash(self, *names: str) -> str:
        """Hashes the files that results of modules depend on.

        Args:
            names: import names, e.g. ``pipeline.stages.enn``.
        """
        digest = hashlib.sha256()
        for name, file in sorted(self.files(*names).items()):
            digest.update(f"{name}\0{self._read(file)['sha256']}\n".encode())
        with contextlib.suppress(OSError):  # a cache that cannot be written to only costs time
            self._cache.save()
        return digest.hexdigest()

    def _referred(self, name: str) -> Iterator[str]:
        found = self._read(self._require(name), name)
        for module, wanted in found["imports"]:
            yield module
            if wanted and self._file(module) is not None:
                yield from self._home(module, wanted)
        yield from found["strings"]

    def _home(self, module: str, wanted: str) -> Iterator[str]:
        """Where a name wanted of a module comes from, if that is another module."""
        if self._file(f"{module}.{wanted}") is not None:
            yield f"{module}.{wanted}"
            return
        lazy = self._read(self._require(module), module)["lazy"]
        for name in lazy if wanted == "*" else [wanted]:
            if name in lazy:
                inside = f"{module}.{lazy[name]}"
                yield inside if self._file(inside) is not None else lazy[name]

    def _data(self, name: str, file: Path, root: Path) -> Iterator[Path]:
        """Files beside a module, or beside a package around it, that it names."""
        for text in self._read(file, name)["files"]:
            folder = file.parent
            while folder.is_relative_to(root):
                place = folder / text
                if place.is_file() and place.suffix not in _NO_DATA:
                    yield place
                elif place.is_dir():
                    yield from (p for p in sorted(place.rglob("*")) if p.is_file() and p.suffix not in _NO_DATA)
                folder = folder.parent

    def _file(self, name: str) -> Path | None:
        """The source of a module; None where the packages have none of that name."""
        if name not in self._files:
            package, _, inside = name.partition(".")
            root = self._roots.get(package)
            if root is None:
                return None
            place = root.joinpath(*inside.split(".")) if inside else root
            choices = [place / "__init__.py", *([place.with_suffix(".py")] if inside else [])]
            self._files[name] = next((choice for choice in choices if choice.is_file()), None)
        return self._files[name]

    def _require(self, name: str) -> Path:
        file = self._file(name)
        if file is None:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        return file

    def _read(self, file: Path, name: str = "") -> dict[str, Any]:
        """Digest of a file, and what a module refers to."""

        def read(file: Path) -> dict[str, Any]:
            digest = {"sha256": hash_file(file)}
            if file.suffix != ".py":
                return digest
            return digest | references(file.read_text(encoding="utf-8"), name, is_package=file.name == "__init__.py")

        if file not in self._references:
            known = self._cache.recall(file)
            self._references[file] = dict(known if known is not None else self._cache.compute(file, read))
        return self._references[file]


def is_without_effect(name: str) -> bool:
    """Whether results never depend on a module."""
    return name in WITHOUT_EFFECT or (name.startswith(_FOLDERS_WITHOUT_EFFECT) and name not in _WITH_EFFECT)


def installed_packages() -> dict[str, Path]:
    """The project's own packages and their folders, as far as they are installed."""
    specs = {package: importlib.util.find_spec(package) for package in PACKAGES}
    return {
        package: Path(next(iter(spec.submodule_search_locations)))
        for package, spec in specs.items()
        if spec is not None and spec.submodule_search_locations
    }


def source_closure() -> SourceClosure:
    """The sources behind modules; what each file refers to is kept in the user's cache, for all runs."""
    return SourceClosure(user_cache() / "sources.json")
