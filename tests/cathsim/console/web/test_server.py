"""The server as pages and strangers meet it: who is let in; nonsense is answered, a flood refused; it stays small."""

import asyncio
import contextlib
import json
import random
import re
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("fastapi", reason="the extra cathsim[console] is not installed")
pytest.importorskip("websockets", reason="the extra cathsim[console] is not installed")

from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from cathsim.console.web.server import FLOODED, MOST_A_SECOND, MOST_AT_ONCE, OCCUPIED, REFUSED, Desk, Pace

Console = tuple[subprocess.Popen[str], str, str]
MEGABYTES = 60
KINDS = ("controls", "release", "choose", "restart", "replay", "answers", "shutdown", "", None, 5, ["x"])
FIELDS = ["advance", "rotate", "sequence", "catheter", "phantom", "target", "answers", "more"]
VALUES: list[Any] = [
    None, True, 0, -1, 2**70, 0.5, 1e308, float("nan"), float("inf"), "", "bca", "type_1", "x" * 5000, "\0", "../..",
    [], [[[]]], [0, float("nan")], [1, -1], [1, 2, 3], "simmons2_5f", {}, {"a": {"b": {"c": []}}}, [0] * 1000,
]  # fmt: skip


def started(folder: Path, *arguments: str) -> Console:
    """A console in a process of its own, and the addresses of its page and of its websocket."""
    process = subprocess.Popen(
        [sys.executable, "-m", "cathsim.console", "--port", "0", *arguments],
        cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
    )  # fmt: skip
    found = re.search(r"http://\S+", process.stdout.readline())
    assert found, "it printed no address"
    page, asked, token = found.group().partition("?")
    return process, page + asked + token, page.replace("http", "ws") + "ws" + asked + token


@pytest.fixture(scope="module")
def console(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Console]:
    """A console with a token."""
    running = started(tmp_path_factory.mktemp("console"), "--token", "secret", "--no-record")
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
    with connect(address, origin=origin) as stranger, pytest.raises(ConnectionClosed) as caught:  # type: ignore[arg-type]
        stranger.recv(timeout=10)
    return caught.value.rcvd.code, caught.value.rcvd.reason


def resident_mb(process: subprocess.Popen[str]) -> float:
    """Memory of a process."""
    status = Path(f"/proc/{process.pid}/status").read_text(encoding="utf-8")
    found = re.search(r"VmRSS:\s+(\d+)", status)
    assert found
    return int(found.group(1)) / 1024


def next_message(page: ClientConnection, kind: str, seconds: float = 20.0) -> dict[str, Any]:
    """Waits for a message of a kind."""
    while True:
        message = page.recv(timeout=seconds)
        if isinstance(message, str) and json.loads(message)["type"] == kind:
            return dict(json.loads(message))


def assert_works(address: str) -> None:
    """A page is introduced, may choose, and sees pictures."""
    with connect(address, max_size=None) as page:
        next_message(page, "task")
        page.send(json.dumps({"type": "choose", "phantom": "type_1", "target": "lcca"}))
        assert next_message(page, "task")["target"] == "lcca"
        while not (isinstance(frame := page.recv(timeout=20), bytes) and frame.startswith(b"FRME")):
            pass


def malformed(rng: random.Random) -> str | bytes:
    """A message that no page sends."""
    choice = rng.randrange(6)
    if choice == 0:
        return rng.randbytes(rng.randrange(2000))
    if choice == 1:
        return "[" * rng.randrange(1, 16_000)
    if choice == 2:
        return "".join(chr(rng.randrange(0x20, 0xD7FF)) for _ in range(rng.randrange(300)))
    if choice == 3:
        return '{"type": "controls", "advance": ' + "9" * rng.randrange(1, 15_000) + "}"
    message = {"type": rng.choice(KINDS)}
    for field in rng.sample(FIELDS, rng.randrange(5)):
        message[field] = rng.choice(VALUES)
    return json.dumps(message)


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
    _, page, wire = console
    origin = page.split("/?")[0]
    assert closing(wire.replace("secret", "guess"), origin)[0] == REFUSED
    code, reason = closing(wire, "http://example.org")
    assert code == REFUSED
    assert "other sites" in reason
    with connect(wire, origin=origin) as operator:  # type: ignore[arg-type]
        heard: set[str] = set()
        operator.send("{nonsense")
        wanted, end = {"MESH", "FRME", "a request must be JSON"}, time.monotonic() + 10
        while not wanted <= heard and time.monotonic() < end:
            message = operator.recv(timeout=5)
            heard.add(json.loads(message).get("text", "") if isinstance(message, str) else message[:4].decode())
        assert wanted <= heard
        assert closing(wire, origin)[0] == OCCUPIED, "another window is at the controls"


def test_ending_the_program_keeps_the_episode_that_was_going_on(tmp_path: Path) -> None:
    process, page, wire = started(tmp_path, "--record", str(tmp_path))
    try:
        with connect(wire, origin=page.rstrip("/"), close_timeout=0.1) as operator:  # type: ignore[arg-type]
            request = {"type": "controls", "advance": 1.0, "rotate": 0.0, "sequence": 1}
            for _ in range(4):
                operator.send(json.dumps(request))
                time.sleep(0.15)
            process.send_signal(signal.SIGTERM)
            process.wait(15)
    finally:
        process.kill()
    files = [path.name for path in (tmp_path / "type_1" / "bca").iterdir()]
    assert len(files) == 1
    assert re.fullmatch(r"000\.(npz|mcap)", files[0])


def test_a_hundred_malformed_messages_leave_the_console_working(console: Console) -> None:
    address = console[2]
    rng = random.Random(20)
    with connect(address, max_size=None) as page:
        next_message(page, "task")
        for _ in range(100):
            page.send(malformed(rng))
        page.send(json.dumps({"type": "choose", "phantom": "type_1", "target": 5}))
        while "target should be a valid string, got 5" not in next_message(page, "notice")["text"]:
            pass
    assert_works(address)


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="memory is read from /proc")
def test_a_flood_is_refused_with_a_sentence_and_memory_stays(console: Console) -> None:
    process, _, address = console
    assert_works(address)
    before, sent = resident_mb(process), 0
    wishes = [
        json.dumps({"type": "choose", "phantom": "type_1", "target": 5, "more": "x" * 15_000}),
        json.dumps({"type": "choose", "phantom": "type_1", "target": "bca"}),
        json.dumps({"type": "controls", "advance": 1, "rotate": 0, "sequence": 1}),
        "x" * 15_000,
    ]
    with connect(address, max_size=None) as page:
        with contextlib.suppress(ConnectionClosed):
            for number in range(50_000):  # and nothing is read meanwhile
                page.send(wishes[number % len(wishes)])
                sent += 1
        grown = resident_mb(process) - before
        with pytest.raises(ConnectionClosed) as ended:
            next_message(page, "nothing of that name")
    assert sent > MOST_AT_ONCE
    assert grown < MEGABYTES
    assert ended.value.rcvd.code == FLOODED
    assert f"more than {MOST_A_SECOND} messages a second" in ended.value.rcvd.reason
    assert resident_mb(process) - before < MEGABYTES
    assert_works(address)


def test_a_desk_keeps_the_latest_of_each_kind_for_a_page_that_does_not_read() -> None:
    async def flood() -> list[Any]:
        desk = Desk()
        assert desk.take()
        for number in range(1000):
            desk.say({"type": "notice", "kind": "error", "text": f"wrong {number}"})
            desk.say({"type": "task", "number": number})
            desk.say(b"MESH" + bytes(1000))
            desk.show(b"FRME")
        return await desk.next()

    waiting = asyncio.run(flood())
    assert len(waiting) == 8 + 1 + 1 + 1
    assert {"type": "task", "number": 999} in waiting
    assert waiting[-1] == b"FRME"
    assert [m["text"] for m in waiting if isinstance(m, dict) and m["type"] == "notice"][-1] == "wrong 999"


def test_the_pace_allows_a_gamepad_and_refuses_a_flood() -> None:
    now = 0.0
    pace = Pace(lambda: now)
    for _ in range(10 * 240):  # ten seconds of a fast screen
        now += 1 / 240
        assert pace.allows()
    allowed = sum(pace.allows() for _ in range(10_000))
    assert allowed <= MOST_AT_ONCE
    now += 10.0
    assert pace.allows()
