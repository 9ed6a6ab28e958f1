"""What a page may send: any nonsense is answered, a flood is refused, and the console works and stays small."""

import asyncio
import contextlib
import json
import random
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("fastapi", reason="the extra cathsim[console] is not installed")
pytest.importorskip("websockets", reason="the extra cathsim[console] is not installed")

from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from cathsim.console.web.server import FLOODED, MOST_A_SECOND, MOST_AT_ONCE, Desk, Pace

Console = tuple[subprocess.Popen[str], str]
MEGABYTES = 60
KINDS = ("controls", "release", "choose", "restart", "replay", "answers", "shutdown", "", None, 5, ["x"])
FIELDS = ["advance", "rotate", "sequence", "catheter", "phantom", "target", "answers", "more"]
VALUES: list[Any] = [
    None, True, 0, -1, 2**70, 0.5, 1e308, float("nan"), float("inf"), "", "bca", "type_1", "x" * 5000, "\0", "../..",
    [], [[[]]], [0, float("nan")], [1, -1], [1, 2, 3], "simmons2_5f", {}, {"a": {"b": {"c": []}}}, [0] * 1000,
]  # fmt: skip


@pytest.fixture(scope="module")
def console(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Console]:
    """A console in a process of its own, and the address of its websocket."""
    process = subprocess.Popen(
        [sys.executable, "-m", "cathsim.console", "--port", "0", "--no-record"],
        cwd=tmp_path_factory.mktemp("console"), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    found = re.search(r"http://\S+", process.stdout.readline())
    assert found, "it printed no address"
    yield process, found.group().replace("http", "ws").rstrip("/") + "/ws"
    process.terminate()
    process.wait(15)


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


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="memory is read from /proc")
def test_a_hundred_malformed_messages_leave_the_console_working(console: Console) -> None:
    _, address = console
    rng = random.Random(20)
    with connect(address, max_size=None) as page:
        next_message(page, "task")
        for _ in range(100):
            page.send(malformed(rng))
        page.send(json.dumps({"type": "choose", "phantom": "type_1", "target": 5}))
        while "target should be a valid string, got 5" not in next_message(page, "notice")["text"]:
            pass
    assert_works(address)


def test_what_cannot_be_asked_of_two_devices_is_answered_with_one_sentence(console: Console) -> None:
    _, address = console
    controls: dict[str, Any] = {"type": "controls", "advance": 1, "rotate": 0, "sequence": 1}
    choice = {"type": "choose", "phantom": "type_1", "target": "bca"}
    with connect(address, max_size=None) as page:
        next_message(page, "task")
        for message, answer in (
            ({**controls, "catheter": [1, 0]}, "there is no catheter to steer: choose one first"),
            ({**choice, "catheter": "moon"}, "unknown catheter 'moon'; there are straight_4f, "),
            ({**choice, "catheter": "../../mine.yaml"}, "unknown catheter '../../mine.yaml'; "),
            ({**choice, "catheter": ["vertebral"]}, "catheter should be a valid string, got ['vertebral']"),
        ):
            page.send(json.dumps(message))
            assert answer in next_message(page, "notice")["text"]
        page.send(json.dumps({**choice, "catheter": "vertebral_4f"}))
        assert next_message(page, "task")["devices"] == 2
        for catheter, answer in (
            ([1], "catheter should have 2 numbers, got 1"),
            ([1, 0, 1, 0], "catheter should have 2 numbers, got 4"),
            ([float("nan"), 0], "catheter.0 should be a finite number, got nan"),
            ([0, float("inf")], "catheter.1 should be a finite number, got inf"),
            (["1", 0], "catheter.0 should be a valid number, got '1'"),
        ):
            page.send(json.dumps({**controls, "catheter": catheter}))
            assert answer in next_message(page, "notice")["text"]
        page.send(json.dumps({**controls, "catheter": [1, 0]}))
        while True:
            frame = page.recv(timeout=20)
            if isinstance(frame, bytes) and b'"state": "running"' in frame and b'"lead_mm"' in frame:
                break
        page.send(json.dumps({**choice, "catheter": None}))
        assert next_message(page, "task")["devices"] == 1


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="memory is read from /proc")
def test_a_flood_is_refused_with_a_sentence_and_memory_stays(console: Console) -> None:
    process, address = console
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
    assert ended.value.rcvd.reason == f"more than {MOST_A_SECOND} messages a second: close what sends them"
    assert resident_mb(process) - before < MEGABYTES
    assert_works(address)


def test_a_desk_keeps_the_latest_of_each_kind_for_a_page_that_does_not_read() -> None:
    async def flood() -> list[Any]:
        desk = Desk()
        assert desk.take()
        for number in range(50_000):
            desk.say({"type": "notice", "kind": "error", "text": f"wrong {number}"})
            desk.say({"type": "task", "number": number})
            desk.say(b"MESH" + bytes(1000))
            desk.show(b"FRME")
        return await desk.next()

    waiting = asyncio.run(flood())
    assert len(waiting) == 8 + 1 + 1 + 1
    assert {"type": "task", "number": 49_999} in waiting
    assert waiting[-1] == b"FRME"
    assert [m["text"] for m in waiting if isinstance(m, dict) and m["type"] == "notice"][-1] == "wrong 49999"


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
