"""Starting the console: the port, the token, what is missing; and its server as a stranger meets it."""

import json
import re
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from cathsim.console import NpzRecorder, launch

pytest.importorskip("fastapi", reason="the extra cathsim[console] is not installed")
pytest.importorskip("websockets", reason="the extra cathsim[console] is not installed")


Console = tuple[subprocess.Popen[str], str, Path]


def started(folder: Path, *arguments: str) -> Console:
    """A console in a process of its own, and the address that it printed."""
    process = subprocess.Popen(
        [sys.executable, "-m", "cathsim.console", "--port", "0", "--record", str(folder), *arguments],
        cwd=folder, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    found = re.search(r"http://\S+", process.stdout.readline())
    assert found, "it printed no address"
    return process, found.group(), folder


@pytest.fixture(scope="module")
def console(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Console]:
    """A console with a token."""
    running = started(tmp_path_factory.mktemp("episodes"), "--token", "secret")
    yield running
    running[0].terminate()
    running[0].wait(15)


def status(address: str, **headers: str) -> int:
    try:
        with urllib.request.urlopen(urllib.request.Request(address, headers=headers), timeout=10) as answer:
            return int(answer.status)
    except urllib.error.HTTPError as error:
        return error.code


def closing(address: str, origin: str) -> tuple[int, str]:
    """Code and reason with which the websocket is closed."""
    from websockets.exceptions import ConnectionClosed
    from websockets.sync.client import connect

    with connect(address, origin=origin) as stranger, pytest.raises(ConnectionClosed) as caught:  # type: ignore[arg-type]
        stranger.recv(timeout=10)
    return caught.value.rcvd.code, caught.value.rcvd.reason


def test_a_port_in_use_is_one_sentence_and_exit_code_1(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        assert launch.main(["--port", str(port), "--record", str(tmp_path)]) == 1
    said = capsys.readouterr()
    assert said.err == (
        f"port {port} on 127.0.0.1 is in use, perhaps by another console: close that, or choose another --port\n"
    )
    assert said.out == ""


def test_what_cannot_be_is_one_sentence_and_exit_code_1(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    folder = ["--record", str(tmp_path), "--port", "0"]
    (tmp_path / "file").touch()
    for arguments, words in (
        (["--phantom", "moon", *folder], "moon"),
        (["--target", "moon", *folder], "unknown target 'moon'"),
        (["--catheter", "moon", *folder], "unknown catheter 'moon'"),
        (["--catheter", "moon.yaml", *folder], "there is no device's file moon.yaml"),
        (["--success-radius-mm", "80", *folder], "success_radius must lie in 0.001 to 0.05 m"),
        (["--force-limit", "0", *folder], "force must lie in 0 (excluded) to 100 N"),
        (["--host", "no.such.host.invalid", *folder], "no address of this machine"),
        (["--port", "70000", "--record", str(tmp_path)], "--port must lie in 0 to 65535"),
        (["--record", str(tmp_path / "file" / "below"), "--port", "0"], "episodes cannot go to"),
    ):
        assert launch.main(arguments) == 1
        error = capsys.readouterr().err
        assert words in error
        assert error.count("\n") == 1


def test_a_missing_extra_is_one_sentence(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setitem(launch.EXTRA, "no_such_module_here", "fastest-api")
    assert launch.main(["--record", str(tmp_path)]) == 1
    assert capsys.readouterr().err == "the console needs fastest-api: pip install 'endonav-cathsim[console]'\n"


def test_the_address_carries_the_token_and_names_a_machine_that_can_be_reached() -> None:
    assert launch.address_of("127.0.0.1", 8000, None) == "http://127.0.0.1:8000/"
    assert launch.address_of("::1", 8000, "abc") == "http://[::1]:8000/?token=abc"
    assert launch.address_of("0.0.0.0", 80, "abc") == f"http://{socket.gethostname()}:80/?token=abc"


def test_recorders_of_other_distributions_come_first(monkeypatch: pytest.MonkeyPatch) -> None:
    from cathsim.console import recorder

    class Entry:
        name = "other"

        def __init__(self, loaded: Any) -> None:
            self.loaded = loaded

        def load(self) -> Any:
            if self.loaded is None:
                raise ImportError("gone")
            return self.loaded

    for entries, expected in (([Entry(str)], str), ([Entry(None)], NpzRecorder), ([], NpzRecorder)):
        monkeypatch.setattr(recorder, "entry_points", lambda group, entries=entries: entries)
        assert recorder.find_recorder() is expected


def test_the_page_needs_the_token_and_its_files_do_not(console: Console) -> None:
    address = console[1]
    plain = address.split("?")[0]
    assert address.endswith("/?token=secret")
    assert status(address) == 200
    assert status(plain) == status(plain + "?token=wrong") == 403
    assert status(address, Origin="http://example.org") == 403
    for name in ("console.js", "controls.js", "space.js", "console.css"):
        assert status(f"{plain}page/{name}") == 200
    assert status(f"{plain}page/../server.py") == status(f"{plain}page/%2e%2e/server.py") == 404


def test_the_websocket_refuses_strangers_and_answers_nonsense(console: Console) -> None:
    from websockets.sync.client import connect

    page = console[1]
    origin = page.split("/?")[0]
    wire = page.replace("http", "ws").replace("/?", "/ws?")
    assert closing(wire.replace("secret", "guess"), origin)[0] == 4401
    assert closing(wire, "http://example.org") == (4401, "pages of other sites may not use the console")
    with connect(wire, origin=origin) as operator:  # type: ignore[arg-type]
        heard: set[str] = set()
        operator.send("{nonsense")
        wanted, end = {"MESH", "FRME", "a request must be JSON"}, time.monotonic() + 10
        while not wanted <= heard and time.monotonic() < end:
            message = operator.recv(timeout=5)
            heard.add(json.loads(message).get("text", "") if isinstance(message, str) else message[:4].decode())
    assert wanted <= heard


def test_ending_the_program_keeps_the_episode_that_was_going_on(tmp_path: Path) -> None:
    from websockets.sync.client import connect

    process, page, folder = started(tmp_path)
    try:
        wire, origin = page.replace("http", "ws") + "ws", page.rstrip("/")
        with connect(wire, origin=origin, close_timeout=0.1) as operator:  # type: ignore[arg-type]
            request = {"type": "controls", "advance": 1.0, "rotate": 0.0, "sequence": 1}
            for _ in range(4):
                operator.send(json.dumps(request))
                time.sleep(0.15)
            process.send_signal(signal.SIGTERM)
            process.wait(15)
    finally:
        process.kill()
    files = [path.name for path in (folder / "type_1" / "bca").iterdir()]
    assert len(files) == 1
    assert re.fullmatch(r"000\.(npz|mcap)", files[0])


def test_wrong_arguments_are_one_line_and_exit_code_2(capsys: pytest.CaptureFixture[str]) -> None:
    for arguments, words in ((["--port", "abc"], "--port: invalid int value: 'abc'"), (["--moon"], "--moon")):
        with pytest.raises(SystemExit) as caught:
            launch.main(arguments)
        error = capsys.readouterr().err
        assert caught.value.code == 2
        assert words in error
        assert error.count("\n") == 1
