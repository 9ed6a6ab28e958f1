"""Starting the console: the port, the token, what is missing, what cannot be."""

import socket
from pathlib import Path
from typing import Any

import pytest

from cathsim.console import NpzRecorder, launch

pytest.importorskip("fastapi", reason="the extra cathsim[console] is not installed")


def test_a_port_in_use_is_one_sentence_and_exit_code_1(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        assert launch.main(["--port", str(port), "--record", str(tmp_path)]) == 1
    said = capsys.readouterr()
    assert f"port {port} on 127.0.0.1 is in use" in said.err
    assert (said.err.count("\n"), said.out) == (1, "")


def test_what_cannot_be_is_one_sentence_and_exit_code_1(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    folder = ["--record", str(tmp_path), "--port", "0"]
    (tmp_path / "file").touch()
    for arguments, words in (
        (["--phantom", "moon", *folder], "moon"),
        (["--catheter", "moon.yaml", *folder], "there is no device's file moon.yaml"),
        (["--success-radius-mm", "80", *folder], "success_radius must lie in"),
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
    assert "fastest-api: pip install 'endonav-cathsim[console]'\n" in capsys.readouterr().err


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


def test_wrong_arguments_are_one_line_and_exit_code_2(capsys: pytest.CaptureFixture[str]) -> None:
    for arguments, words in ((["--port", "abc"], "--port: invalid int value: 'abc'"), (["--moon"], "--moon")):
        with pytest.raises(SystemExit) as caught:
            launch.main(arguments)
        error = capsys.readouterr().err
        assert caught.value.code == 2
        assert words in error
        assert error.count("\n") == 1
