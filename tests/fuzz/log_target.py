"""Episode logs: damaged bytes, and contents that are wrong behind right checksums."""

from __future__ import annotations

import json
import random
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.episodes import EpisodeReader, EpisodeReadError, EpisodeWriteError, check, recover
from pipeline.episodes.encoding.container import McapFile
from pipeline.episodes.encoding.schema import topic_messages
from pipeline.episodes.metadata import _checksum
from pipeline.episodes.writer import schema_data
from tests.fuzz.mutations import altered, damaged, text_of
from tests.fuzz.target import Target, WrongError, refused
from tests.pipeline.episodes.conftest import draw_episode


class LogTarget(Target):
    """The reader, the check and the recovery of episode logs."""

    name = "logs"
    share = 1.5

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.episode = draw_episode(12)
        self.sample = self.episode.write(folder / "sample.mcap")
        self.data = self.sample.read_bytes()
        self.truth = read(self.sample)
        with EpisodeReader(self.sample) as log:
            self.messages = {
                topic: list(log.payloads(topic)) for topic in log._topics if log._chunks[log._topics[topic]]
            }
        cameras = [{"name": name, **camera.to_json()} for name, camera in self.episode.cameras.items()]
        self.info = {"info": self.episode.info.to_json(), "cameras": cameras}

    def run(self, seed: int) -> None:
        rng = random.Random(seed)
        path = self.folder / "victim.mcap"
        raw = rng.random() < 0.5
        if raw:
            path.write_bytes(damaged(self.data, rng))
        else:
            self._forge(path, rng)
        try:
            found = read(path)
        except EpisodeReadError as error:
            verdict = refused(error)
        else:
            if raw and not same(found, self.truth):
                raise WrongError("damaged bytes were read as something else")
            verdict = "equal" if raw else "accepted"
        self.counts[verdict] += 1
        for problem in check(path).problems:
            if "\n" in problem:
                raise WrongError(f"a problem is no sentence: {problem[:300]!r}")
        if raw and verdict == "refused" and not check(path).problems:
            raise WrongError("a log that cannot be read has no problem")
        self._recover(path, raw)

    def _recover(self, path: Path, raw: bool) -> None:
        saved = self.folder / "saved.mcap"
        try:
            recover(path, saved, overwrite=True)
        except (EpisodeReadError, EpisodeWriteError) as error:
            refused(error)
            return
        if not raw:
            with EpisodeReader(saved):
                return
        with EpisodeReader(saved) as log:
            for record in log:
                given = self.episode.records[record.step]
                if record.tip.tobytes() != given.tip.tobytes() or record.extra != given.extra:
                    raise WrongError(f"step {record.step} was recovered as something else")

    def _forge(self, path: Path, rng: random.Random) -> None:
        """Writes a log with right checksums in which one thing is wrong."""
        path.unlink(missing_ok=True)
        out = McapFile(path, "endonav")
        ids = {
            topic: out.register(topic, message.DESCRIPTOR.full_name, schema_data(message))
            for topic, message in topic_messages(tuple(self.episode.cameras)).items()
        }
        victim = rng.choice(["info", "outcome", *self.messages])
        info = altered(self.info, rng) if victim == "info" else self.info
        out.add_metadata("endonav.episode", sealed(text_of(info, rng) if victim == "info" else json.dumps(info)))
        for topic, messages in self.messages.items():
            chosen = rng.randrange(len(messages))
            for index, (time_ns, payload) in enumerate(messages):
                wrong = topic == victim and (index == chosen or rng.random() < 0.2)
                late = rng.choice((0, 1, 10**8, 2**62)) if wrong and rng.random() < 0.2 else 0
                out.add(ids[topic], time_ns + late, index, damaged(payload, rng) if wrong else payload)
        out.flush()
        outcome = self.episode.outcome.to_json()
        text = text_of(altered(outcome, rng), rng) if victim == "outcome" else json.dumps(outcome)
        out.add_metadata("endonav.outcome", sealed(text))
        out.close_with_index()


def sealed(text: str) -> dict[str, str]:
    """A metadata record with a right checksum."""
    text = text.encode("utf-8", "replace").decode()
    return {"schema_version": "1", "json": text, "crc32": _checksum("1", text)}


def read(path: Path) -> dict[str, Any]:
    """All that a log holds."""
    with EpisodeReader(path) as log:
        arrays: dict[str, Any] = dict(log.load_arrays())
        mesh = log.phantom_mesh()
        arrays["mesh"] = np.zeros(0) if mesh is None else mesh.vertices
        arrays["said"] = (log.info, log.outcome, len(log))
        return arrays


def same(one: dict[str, Any], other: dict[str, Any]) -> bool:
    """Whether two logs hold the same, bit for bit."""
    if one.keys() != other.keys() or one["said"] != other["said"]:
        return False
    return all(one[key].tobytes() == other[key].tobytes() for key in one if key != "said")
