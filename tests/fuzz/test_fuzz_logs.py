"""Episode logs: damaged bytes, and contents that are wrong behind right checksums."""

import json
import random
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.episodes import EpisodeReader, EpisodeReadError, EpisodeWriteError
from pipeline.episodes.checking import check
from pipeline.episodes.encoding.container import McapFile
from pipeline.episodes.recovery import recover
from pipeline.episodes.writer import register_topics
from tests.fuzz.mutations import altered, damaged, text_of
from tests.fuzz.promise import BrokenPromiseError, fuzz, refused
from tests.pipeline.episodes.conftest import draw_episode
from tests.pipeline.episodes.forged_logs import sealed


@dataclass(frozen=True)
class Sample:
    """An episode, its log, and what the log holds."""

    folder: Path
    episode: Any
    data: bytes
    truth: dict[str, Any]
    messages: dict[str, list[tuple[int, bytes]]]


@pytest.fixture(scope="module")
def sample(tmp_path_factory: pytest.TempPathFactory) -> Sample:
    """A log of twelve steps."""
    folder = tmp_path_factory.mktemp("logs")
    episode = draw_episode(12)
    path = episode.write(folder / "sample.mcap")
    with EpisodeReader(path) as log:
        messages = {topic: list(log.payloads(topic)) for topic in log._topics if log._chunks[log._topics[topic]]}
    return Sample(folder, episode, path.read_bytes(), read(path), messages)


@fuzz()
def test_logs_of_damaged_bytes(rng: random.Random, sample: Sample) -> str:
    """A log with damaged bytes is refused, and has a problem, or holds the same; what is recovered is right."""
    path = sample.folder / "victim.mcap"
    path.write_bytes(damaged(sample.data, rng))
    verdict = read_and_check(path)
    if verdict == "accepted" and not same(read(path), sample.truth):
        raise BrokenPromiseError("damaged bytes were read as something else")
    if verdict == "refused" and not check(path).problems:
        raise BrokenPromiseError("a log that cannot be read has no problem")
    saved = recovered(path)
    if saved is not None:
        with EpisodeReader(saved) as log:
            for record in log:
                given = sample.episode.records[record.step]
                if record.tip.tobytes() != given.tip.tobytes() or record.extra != given.extra:
                    raise BrokenPromiseError(f"step {record.step} was recovered as something else")
    return "equal" if verdict == "accepted" else verdict


@fuzz(2256)
def test_logs_of_forged_contents(rng: random.Random, sample: Sample) -> str:
    """A log with right checksums in which one thing is wrong is refused or read; what is recovered opens."""
    path = sample.folder / "victim.mcap"
    forge(path, sample, rng)
    verdict = read_and_check(path)
    saved = recovered(path)
    if saved is not None:
        with EpisodeReader(saved):
            pass
    return verdict


def read_and_check(path: Path) -> str:
    """The verdict over a log; each problem is a sentence."""
    try:
        read(path)
    except EpisodeReadError as error:
        verdict = refused(error)
    else:
        verdict = "accepted"
    for problem in check(path).problems:
        if "\n" in problem:
            raise BrokenPromiseError(f"a problem is no sentence: {problem[:300]!r}")
    return verdict


def recovered(path: Path) -> Path | None:
    """What the recovery saves of a log, if anything."""
    saved = path.with_name("saved.mcap")
    try:
        recover(path, saved, overwrite=True)
    except (EpisodeReadError, EpisodeWriteError) as error:
        refused(error)
        return None
    return saved


def forge(path: Path, sample: Sample, rng: random.Random) -> None:
    """Writes a log with right checksums in which one thing is wrong."""
    path.unlink(missing_ok=True)
    out = McapFile(path)
    ids = register_topics(out, sample.episode.cameras, devices=False)
    cameras = [{"name": name, **camera.to_json()} for name, camera in sample.episode.cameras.items()]
    info = {"info": asdict(sample.episode.info), "cameras": cameras}
    victim = rng.choice(["info", "outcome", *sample.messages])
    text = text_of(altered(info, rng), rng) if victim == "info" else json.dumps(info)
    out.add_metadata("endonav.episode", sealed(without_surrogates(text)))
    for topic, messages in sample.messages.items():
        chosen = rng.randrange(len(messages))
        for index, (time_ns, payload) in enumerate(messages):
            wrong = topic == victim and (index == chosen or rng.random() < 0.2)
            late = rng.choice((0, 1, 10**8, 2**62)) if wrong and rng.random() < 0.2 else 0
            out.add(ids[topic], time_ns + late, index, damaged(payload, rng) if wrong else payload)
    out.flush()
    outcome = asdict(sample.episode.outcome)
    text = text_of(altered(outcome, rng), rng) if victim == "outcome" else json.dumps(outcome)
    out.add_metadata("endonav.outcome", sealed(without_surrogates(text)))
    out.close_with_index()


def without_surrogates(text: str) -> str:
    return text.encode("utf-8", "replace").decode()


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
