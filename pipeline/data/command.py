"""The command `endonav data`: lists real vessels with a public address, downloads them, or takes them from a folder."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable
from pathlib import Path

from pipeline.data.download import DownloadError, download
from pipeline.data.sources import Sources, read_sources
from pipeline.printing import Parser, say
from pipeline.store.atomic_files import atomic_path
from pipeline.store.errors import ConfigurationError
from pipeline.store.provenance import hash_file

_FINE, _FAILED, _USAGE = 0, 1, 2
_PERCENT = 100


def main(arguments: list[str]) -> int:
    """Runs the command; 1 if files are still missing, 2 for wrong usage."""
    parser = Parser(prog="endonav data", description=__doc__)
    parser.add_argument("--sources", type=Path, metavar="FILE", help="instead of the project's")
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="list|fetch|add")
    verbs.add_parser("list", help="a line for each source")
    verbs.add_parser("fetch", help="download what is missing").add_argument("names", nargs="*", metavar="NAME")
    verbs.add_parser("add", help="take files by their content").add_argument("folder", type=Path, metavar="FOLDER")
    options = parser.parse_args(arguments)
    try:
        sources = read_sources(options.sources)
        if options.verb == "list":
            return _list(sources)
        return _fetch(sources, options.names) if options.verb == "fetch" else _add(sources, options.folder)
    except (ConfigurationError, OSError) as error:
        say(f"endonav data: {error}", error=True)
        return _USAGE


def _list(sources: Sources) -> int:
    say(f"# in {sources.folder}")
    for name, source in sources.entries.items():
        presence = "missing" if sources.missing(name) else "here"
        say(f"{name}: {presence}, {source.use}, {source.vessels}, {source.size:,} bytes, {source.licence}, "
            f"github.com/{source.repository}")  # fmt: skip
    return _FINE


def _fetch(sources: Sources, names: list[str]) -> int:
    failed = False
    for name in sources.select(names):
        for file in sources.missing(name):
            url, place = sources.url(name, file), sources.place(name, file)
            try:
                download(url, place, file.bytes, file.sha256, _progress(f"{name}/{file.name}", file.bytes))
            except DownloadError as error:
                failed = True
                say(f"{name}: {url} {error}; or bring {file.name}: `endonav data add FOLDER`", error=True)
        if not sources.missing(name):
            say(f"{name}: {sources.anatomy(name)}")
    return _FAILED if failed else _FINE


def _add(sources: Sources, folder: Path) -> int:
    """Copies the files of a folder whose content is a source's."""
    if not folder.is_dir():
        raise ConfigurationError(f"{folder} is no folder")
    files_by_hash = {file.sha256: (name, file) for name in sources.entries for file in sources.missing(name)}
    sizes = {file.bytes for _, file in files_by_hash.values()}
    taken = 0
    for path in sorted(path for path in folder.rglob("*") if path.is_file() and path.stat().st_size in sizes):
        if entry := files_by_hash.pop(hash_file(path), None):
            with atomic_path(sources.place(*entry)) as temporary:
                shutil.copyfile(path, temporary)
            taken += 1
            say(f"{entry[0]}: {path.name}")
    say(f"{taken} files taken; missing: {len(files_by_hash)}")
    return _FINE if taken or not files_by_hash else _FAILED


def _progress(what: str, size: int) -> Callable[[int], None]:
    def tell(byte_count: int) -> None:
        if sys.stderr.isatty():
            sys.stderr.write(f"\r{what}: {_PERCENT * byte_count // size} %" + "\n" * (byte_count >= size))

    return tell
