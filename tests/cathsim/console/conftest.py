"""Doubles of the console's tests: a recorder that keeps everything in memory, and a page that collects."""

import json
import struct
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cathsim import NavigateEnv
from cathsim.metrics import EpisodeMetrics


class Memory:
    """A recorder that keeps its episodes in lists."""

    def __init__(self, *, fails_at: int | None = None) -> None:
        self.fails_at = fails_at
        self.episodes: list[dict[str, Any]] = []

    def start(self, environment: NavigateEnv, info: Mapping[str, Any], *, seed: int) -> None:
        self.episodes.append({"seed": seed, "actions": [], "tips": [info["tip"]], "state": "going"})

    def step(
        self, environment: NavigateEnv, action: np.ndarray, reward: float, info: Mapping[str, Any],
        *, terminated: bool, truncated: bool,
    ) -> None:  # fmt: skip
        if self.fails_at == len(self.episodes[-1]["actions"]):
            raise OSError("disk full")
        self.episodes[-1]["actions"].append(action)
        self.episodes[-1]["tips"].append(info["tip"])

    def finish(self, metrics: EpisodeMetrics | None) -> Path | None:
        self.episodes[-1] |= {"state": "finished" if metrics else "broken off", "metrics": metrics}
        return Path(f"{len(self.episodes) - 1}.memory") if self.episodes[-1]["actions"] else None

    def answer(self, episode: Path, answers: Mapping[str, Any]) -> Path:
        self.episodes[int(episode.stem)]["answers"] = dict(answers)
        return episode


class Collector:
    """A page that keeps all pictures and messages."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.headers: list[dict[str, Any]] = []
        self.times: list[float] = []
        self.messages: list[dict[str, Any]] = []
        self.surfaces = 0

    def show(self, frame: bytes) -> None:
        length = struct.unpack_from("<I", frame, 4)[0]
        header = json.loads(frame[8 : 8 + length])
        assert frame[8 + length + 12 * (header["points"] + header.get("catheter_points", 0)) :][:2] == b"\xff\xd8", (
            "a JPEG follows the points"
        )
        with self._lock:
            self.headers.append(header)
            self.times.append(time.monotonic())

    def say(self, message: dict[str, Any] | bytes) -> None:
        if isinstance(message, bytes):
            self.surfaces += 1
        else:
            self.messages.append(message)

    def messages_of(self, kind: str) -> list[dict[str, Any]]:
        return [message for message in self.messages if message["type"] == kind]

    @property
    def last(self) -> dict[str, Any]:
        with self._lock:
            return self.headers[-1] if self.headers else {"state": "", "step": -1}


@pytest.fixture
def wait_until() -> Callable[..., Any]:
    """Waits for a condition and returns its value; fails after some seconds."""

    def wait(condition: Callable[[], Any], seconds: float = 8.0) -> Any:
        end = time.monotonic() + seconds
        while not (value := condition()):
            assert time.monotonic() < end, "waited in vain"
            time.sleep(0.01)
        return value

    return wait


@pytest.fixture
def page() -> Collector:
    return Collector()


@pytest.fixture
def memory() -> Memory:
    return Memory()
