"""Episode logs and run folders: damaged bytes, contents wrong behind right checksums, files exchanged or removed."""

import json
import random
import shutil
import time
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
from pipeline.store.errors import PipelineError
from pipeline.store.manifest import MANIFEST, Identity, read_manifest
from pipeline.store.run_folder import RunFolder
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


IDENTITY = Identity("settings", {"phantoms": "inputs"}, 1)
ITEMS = ("a", "b", "c")


def make(stage: RunFolder, items: tuple[str, ...] = ITEMS) -> None:
    """Runs what is not done of a stage whose items are text files."""
    stage.prepare()
    for name in stage.resumable(list(items)):
        (stage.path / f"{name}.txt").write_text(name * 100)
    if items == ITEMS:
        stage.finish(stage="s", run="r", budget="smoke", seed=0, config={"a": 1}, started=time.monotonic())


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished and an unfinished stage."""
    folder = tmp_path_factory.mktemp("run_folders")
    for name, items in (("finished", ITEMS), ("unfinished", ITEMS[:2])):
        stage = RunFolder(folder / name, IDENTITY)
        with stage.locked():
            make(stage, items)
    return folder


def right(path: Path) -> bool:
    """Whether every output is there, as it was written."""
    contents = {name: path / f"{name}.txt" for name in ITEMS}
    return all(file.is_file() and file.read_bytes() == name.encode() * 100 for name, file in contents.items())


@fuzz(92, 1110, 1118, 1148, 1150, 1328, 138574)
def test_run_folders(rng: random.Random, folder: Path) -> str:
    """A stage's folder counts as up to date only when every output is as it was written."""
    whole = "finished" if rng.random() < 0.6 else "unfinished"
    path = folder / "victim"
    shutil.rmtree(path, ignore_errors=True)
    shutil.copytree(folder / whole, path)
    victim = rng.choice(sorted(file for file in path.rglob("*") if file.is_file()))
    if victim.name == MANIFEST and rng.random() < 0.7:
        victim.write_text(text_of(altered(json.loads(victim.read_text()), rng), rng), "utf-8", "replace")
    elif rng.random() < 0.2:
        victim.unlink()
    else:
        victim.write_bytes(damaged(victim.read_bytes(), rng))
    stage, intact = RunFolder(path, IDENTITY), right(path)
    try:
        with stage.locked():
            if stage.is_up_to_date():
                if whole == "unfinished" or not intact:
                    raise BrokenPromiseError("a changed folder counts as up to date")
                return "equal"
            read_manifest(path)
            make(stage)
            kept = whole == "unfinished" and victim.stem in ITEMS  # what an interrupted stage has done is not compared
            if not (kept or right(path)):
                raise BrokenPromiseError("a damaged result was kept")
            if not stage.is_up_to_date():
                raise BrokenPromiseError("a folder that was just finished is not up to date")
    except PipelineError as error:
        return refused(error)
    return "refused"  # and made anew
