"""Run folders: manifests, marks and outputs that were damaged, exchanged or removed."""

import json
import random
import shutil
import time
from pathlib import Path

import pytest

from pipeline.store.errors import PipelineError
from pipeline.store.manifest import MANIFEST, Identity, read_manifest
from pipeline.store.run_folder import RunFolder
from tests.fuzz.mutations import altered, damaged, text_of
from tests.fuzz.promise import BrokenPromiseError, fuzz, refused

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
            if not right(path):
                raise BrokenPromiseError("a damaged result was kept")
            if not stage.is_up_to_date():
                raise BrokenPromiseError("a folder that was just finished is not up to date")
    except PipelineError as error:
        return refused(error)
    return "refused"  # and made anew
