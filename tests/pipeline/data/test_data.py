"""The command `endonav data`: files of a server arrive whole and verified, or a sentence says why not."""

import hashlib
import re
import threading
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from pipeline.data.command import main
from pipeline.data.sources import read_sources
from pipeline.store.errors import ConfigurationError

CONTENT = bytes(range(256)) * 1000
COMMIT = "ab12"


class Handler(SimpleHTTPRequestHandler):
    """A file server that gives parts, unless told not to, and cuts what it sends where it is told to."""

    cut_at: int | None = None
    parts = True
    asked: tuple[str, ...] = ()

    def do_GET(self) -> None:
        content = Path(self.translate_path(self.path)).read_bytes()
        asked = self.headers.get("Range")
        Handler.asked += (asked or "",)
        start = int(re.findall(r"\d+", asked)[0]) if asked and Handler.parts else 0
        self.send_response(206 if start else 200)
        if start:
            self.send_header("Content-Range", f"bytes {start}-{len(content) - 1}/{len(content)}")
        self.send_header("Content-Length", str(len(content) - start))
        self.end_headers()
        self.wfile.write(content[start : Handler.cut_at])
        self.close_connection = True

    def log_message(self, *_: object) -> None:
        """Says nothing."""


@pytest.fixture
def sources(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A file of sources, whose address is a server's on this machine."""
    Handler.cut_at, Handler.parts, Handler.asked = None, True, ()
    monkeypatch.setenv("ENDONAV_DATA", str(tmp_path / "data"))
    served = tmp_path / "served" / "who" / "what" / COMMIT / "some folder"
    served.mkdir(parents=True)
    (served / "vessel.stl").write_bytes(CONTENT)
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Handler, directory=str(tmp_path / "served")))
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield _write(tmp_path, f"http://127.0.0.1:{server.server_port}/{{repository}}/{{commit}}/{{path}}")
    server.shutdown()
    server.server_close()
    thread.join()


def _write(folder: Path, address: str, sha256: str = hashlib.sha256(CONTENT).hexdigest()) -> Path:
    path = folder / "sources.yaml"
    path.write_text(
        f"address: {address}\nsources:\n  tree:\n    use: open\n    vessels: arch\n    repository: who/what\n"
        f"    commit: {COMMIT}\n    licence: MIT\n    files:\n"
        f"      - {{path: some folder/vessel.stl, bytes: {len(CONTENT)}, sha256: {sha256}}}\n"
    )
    return path


def _data(sources: Path, *words: str) -> int:
    return main(["--sources", str(sources), *words])


def test_a_file_is_downloaded_once(sources: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert _data(sources, "list") == 0
    assert "tree: missing, open, arch, 256,000 bytes, MIT" in capsys.readouterr().out
    assert _data(sources, "fetch") == 0
    place = read_sources(sources).anatomy("tree")
    assert place.read_bytes() == CONTENT
    assert [path.name for path in place.parent.iterdir()] == ["vessel.stl"]
    assert _data(sources, "fetch", "tree") == 0
    assert len(Handler.asked) == 1
    assert _data(sources, "list") == 0
    assert "tree: here" in capsys.readouterr().out


@pytest.mark.parametrize("parts", [True, False])
def test_a_download_that_was_cut_off_goes_on(sources: Path, parts: bool, capsys: pytest.CaptureFixture[str]) -> None:
    Handler.cut_at, Handler.parts = 100_000, parts
    assert _data(sources, "fetch") == 1
    assert "was cut off at 100,000 of 256,000 bytes" in capsys.readouterr().err
    place = read_sources(sources).anatomy("tree")
    assert not place.exists()
    Handler.cut_at = None
    assert _data(sources, "fetch") == 0
    assert Handler.asked == ("", "bytes=100000-")
    assert place.read_bytes() == CONTENT


def test_another_file_is_not_kept(sources: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = sources.read_text()
    sources.write_text(text.replace(hashlib.sha256(CONTENT).hexdigest(), "f" * 64))
    assert _data(sources, "fetch") == 1
    assert "is another file" in capsys.readouterr().err
    assert not list((sources.parent / "data" / "tree").iterdir())
    sources.write_text(text.replace("some folder/vessel.stl", "some folder"))
    assert _data(sources, "fetch") == 1


def test_a_longer_part_is_thrown_away(sources: Path) -> None:
    place = read_sources(sources).anatomy("tree")
    place.parent.mkdir(parents=True)
    place.with_name(".vessel.stl.part").write_bytes(CONTENT + b"more")
    assert _data(sources, "fetch") == 1
    assert _data(sources, "fetch") == 0


def test_without_a_network_files_come_from_a_folder(
    sources: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _write(tmp_path, "https://127.0.0.1:9/{repository}/{path}")
    assert _data(sources, "fetch") == 1
    said = capsys.readouterr().err
    assert "tree: https://127.0.0.1:9/who/what/some%20folder/vessel.stl cannot be reached" in said
    brought = tmp_path / "brought"
    (brought / "deep").mkdir(parents=True)
    (brought / "deep" / "other name.bin").write_bytes(CONTENT)
    (brought / "same size.bin").write_bytes(CONTENT[::-1])
    assert _data(sources, "add", str(brought)) == 0
    assert "1 files taken; missing: 0" in capsys.readouterr().out
    assert read_sources(sources).anatomy("tree").read_bytes() == CONTENT
    assert _data(sources, "add", str(tmp_path / "nowhere")) == 2


def test_an_entry_that_is_not_understood_is_refused(tmp_path: Path) -> None:
    text = _write(tmp_path, "https://127.0.0.1/{path}").read_text()
    for old, new, message in (
        ("use: open", "use: tuned", "tree.use"),
        (COMMIT, "main", "commit"),
        ("some folder/vessel.stl", "../vessel", "path"),
        ("sources:", "vessels:", "sources: Field required"),
        ("sources:", "sources: [", "no sources"),
    ):
        (tmp_path / "sources.yaml").write_text(text.replace(old, new))
        with pytest.raises(ConfigurationError, match=message):
            read_sources(tmp_path / "sources.yaml")


def test_wrong_words_end_in_a_sentence(sources: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert _data(sources, "fetch", "heart") == 2
    assert "there is no source 'heart'" in capsys.readouterr().err
    assert main(["--sources", str(sources.parent / "none.yaml"), "list"]) == 2
    sources.write_text(sources.read_text().replace("http://127.0.0.1", "http://example.invalid"))
    assert _data(sources, "fetch") == 1
    assert "is no address of HTTPS" in capsys.readouterr().err


def test_the_projects_sources_have_commits_and_half_of_those_that_were_found_are_reserved() -> None:
    entries = read_sources().entries
    assert all(len(source.commit) == 40 for source in entries.values())
    uses = [source.use for source in entries.values()]
    assert uses.count("open") == uses.count("reserved") >= 6
    assert not any(source.branches for source in entries.values() if source.use == "reserved")
    files = [file.sha256 for source in entries.values() for file in source.files]
    assert len(set(files)) == len(files)
