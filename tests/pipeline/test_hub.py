"""Policies and data sets go to the Hub and come back as they were; a server on this machine stands in for it."""

import base64
import json
import sys
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

from pipeline import hub
from tests.pipeline.protocol.test_board import random_policy

pytest.importorskip("huggingface_hub")
COMMIT = "a" * 40


class StandIn(BaseHTTPRequestHandler):
    """What huggingface_hub asks of the Hub to make a repository, to commit small files and to fetch them."""

    repositories: dict[str, dict[str, bytes]]
    address: str

    def log_message(self, *words: Any) -> None:
        pass

    def answer(self, content: Any, code: int = 200, **headers: str) -> None:
        body = content if isinstance(content, bytes) else json.dumps(content).encode()
        self.send_response(code)
        for name, value in {"Content-Length": str(len(body)), "X-Repo-Commit": COMMIT, **headers}.items():
            self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
        parts = self.path.strip("/").split("/")
        if self.headers.get("Authorization") != "Bearer hf_right":
            return self.answer({"error": "Invalid username or password."}, 401)
        if self.path == "/api/repos/create":
            asked = json.loads(body)
            kind = asked.get("type") or "model"
            name = f"{kind}s/{asked['organization']}/{asked['name']}"
            self.repositories.setdefault(name, {})
            return self.answer({"url": f"{self.address}/{name.removeprefix('models/')}"})
        if self.path == "/api/validate-yaml":  # of a card's head
            return self.answer({"errors": [], "warnings": []})
        name, verb = "/".join(parts[1:4]), parts[4]
        if verb == "preupload":
            files = [{"path": one["path"], "uploadMode": "regular", "shouldIgnore": False}
                     for one in json.loads(body)["files"]]  # fmt: skip
            return self.answer({"files": files})
        assert verb == "commit"
        for line in body.decode().splitlines():
            one = json.loads(line)
            if one["key"] == "file":
                self.repositories[name][one["value"]["path"]] = base64.b64decode(one["value"]["content"])
        return self.answer(
            {"commitUrl": f"{self.address}/{name.removeprefix('models/')}/commit/{COMMIT}", "commitOid": COMMIT}
        )

    def do_GET(self) -> None:
        parts = self.path.partition("?")[0].strip("/").split("/")
        if parts[0] == "api":
            name = "/".join(parts[1:4])
            if name not in self.repositories:
                return self.answer({"error": "Repository not found"}, 404, **{"X-Error-Code": "RepoNotFound"})
            files = self.repositories[name]
            if len(parts) > 4 and parts[4] == "tree":
                tree = [
                    {"type": "file", "path": path, "size": len(kept), "oid": "b" * 40} for path, kept in files.items()
                ]
                return self.answer(tree)
            return self.answer(
                {"id": name.partition("/")[2], "sha": COMMIT, "siblings": [{"rfilename": path} for path in files]}
            )
        name = "/".join(parts[:3]) if parts[0] == "datasets" else "models/" + "/".join(parts[:2])
        path = "/".join(parts[parts.index("resolve") + 2 :])
        return self.answer(self.repositories[name][path], ETag=f'"{len(path)}"')

    do_HEAD = do_GET


@pytest.fixture(scope="module")
def repositories(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, dict[str, bytes]]]:
    """What lies on the Hub; the tests' repositories have different names."""
    StandIn.repositories = {}
    with ThreadingHTTPServer(("127.0.0.1", 0), StandIn) as server, pytest.MonkeyPatch.context() as patch:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        StandIn.address = f"http://127.0.0.1:{server.server_port}"
        home = str(tmp_path_factory.mktemp("hub"))
        told = {"HF_ENDPOINT": StandIn.address, "HF_TOKEN": "hf_right", "HF_HOME": home}
        for name, value in {**told, "HF_HUB_DISABLE_XET": "1", "HF_HUB_DISABLE_PROGRESS_BARS": "1"}.items():
            patch.setenv(name, value)
        for name in [name for name in sys.modules if name.partition(".")[0] == "huggingface_hub"]:
            patch.delitem(sys.modules, name)  # it reads them once
        yield StandIn.repositories
        server.shutdown()


def test_a_policy_comes_back_as_it_was_and_brings_a_card(
    repositories: dict[str, dict[str, bytes]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = random_policy(tmp_path / "mine.pt")
    assert hub.main(["upload", str(file), "me/mine"]) == 0
    kept = repositories["models/me/mine"]
    assert kept["mine.pt"] == file.read_bytes()
    card = kept["README.md"].decode()
    assert card.startswith("---\nlibrary_name: endonav\n")
    assert "| steps of an action | `2` |" in card
    file.with_suffix(".md").write_text("---\nlibrary_name: enn\n---\n# mine\n")  # a card of its own, as shipped ones
    assert hub.main(["upload", str(file), "me/mine"]) == 0
    assert kept["README.md"].decode() == "---\nlibrary_name: enn\n---\n# mine\n"
    assert hub.main(["download", "me/mine", "--to", str(tmp_path / "back")]) == 0
    assert (tmp_path / "back" / "mine.pt").read_bytes() == file.read_bytes()
    assert str(tmp_path / "back" / "mine.pt") in capsys.readouterr().out


def test_a_data_set_comes_back_without_what_is_hidden(
    repositories: dict[str, dict[str, bytes]], tmp_path: Path
) -> None:
    folder = tmp_path / "episodes"
    (folder / "deterministic").mkdir(parents=True)
    (folder / ".jobs").mkdir()
    (folder / "deterministic" / "000.mcap").write_bytes(b"log")
    (folder / ".jobs" / "note.txt").write_text("own")
    assert hub.main(["upload", str(folder), "datasets/me/episodes"]) == 0
    assert repositories["datasets/me/episodes"] == {"deterministic/000.mcap": b"log"}
    [back] = hub.download("datasets/me/episodes", tmp_path / "back")
    assert back == tmp_path / "back" / "deterministic" / "000.mcap"
    assert back.read_bytes() == b"log"


def test_what_cannot_be_is_one_sentence(
    repositories: dict[str, dict[str, bytes]],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    file = random_policy(tmp_path / "mine.pt")

    def told(code: int, *words: object) -> str:
        assert hub.main(list(map(str, words))) == code
        said = capsys.readouterr().err
        assert said.count("\n") == 1
        return said

    assert "is not USER/NAME" in told(2, "upload", file, "mine")
    assert "a policy goes to USER/NAME" in told(2, "upload", file, "datasets/me/mine")
    assert "there is no folder" in told(2, "upload", tmp_path / "none", "datasets/me/none")
    assert "there is no policy" in told(2, "upload", tmp_path / "none.pt", "me/mine")
    assert "404" in told(1, "download", "me/none", "--to", tmp_path / "back")
    repositories["models/me/bad"] = {"bad.pt": file.read_bytes()[:-1] + b"0"}
    assert "bad.pt" in told(1, "download", "me/bad", "--to", tmp_path / "bad")
    monkeypatch.setenv("HF_TOKEN", "hf_wrong")
    assert "401" in told(1, "upload", file, "me/mine")
    monkeypatch.setattr("huggingface_hub.constants.ENDPOINT", "http://127.0.0.1:9")  # where nobody answers
    assert told(1, "upload", file, "me/mine")
