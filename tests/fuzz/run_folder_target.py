"""Run folders: manifests, marks and outputs that were damaged, exchanged or removed."""

from __future__ import annotations

import json
import random
import shutil
import time
from pathlib import Path

from pipeline.store.errors import PipelineError
from pipeline.store.manifest import MANIFEST, Identity, read_manifest
from pipeline.store.run_folder import RunFolder
from tests.fuzz.mutations import altered, damaged, text_of
from tests.fuzz.target import Target, WrongError, refused

IDENTITY = Identity("settings", {"phantoms": "inputs"}, 1)
ITEMS = ("a", "b", "c")


class RunFolderTarget(Target):
    """A finished stage's folder: it counts as up to date only when every output is as it was written."""

    name = "run_folders"

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.whole = folder / "whole"
        self._build(self.whole, finish=True)
        self.unfinished = folder / "unfinished"
        self._build(self.unfinished, finish=False)

    def _build(self, path: Path, *, finish: bool) -> None:
        stage = RunFolder(path, IDENTITY)
        with stage.locked():
            stage.prepare()
            for name in stage.resumable(list(ITEMS if finish else ITEMS[:2])):
                (path / f"{name}.txt").write_text(name * 100)
            if finish:
                stage.finish(stage="s", run="r", budget="smoke", seed=0, config={"a": 1}, started=time.monotonic())

    def _right(self, path: Path) -> bool:
        contents = {name: path / f"{name}.txt" for name in ITEMS}
        return all(file.is_file() and file.read_bytes() == name.encode() * 100 for name, file in contents.items())

    def run(self, seed: int) -> None:
        rng = random.Random(seed)
        finished = rng.random() < 0.6
        path = self.folder / "victim"
        shutil.rmtree(path, ignore_errors=True)
        shutil.copytree(self.whole if finished else self.unfinished, path)
        files = sorted(file for file in path.rglob("*") if file.is_file())
        victim = rng.choice(files)
        if victim.name == MANIFEST and rng.random() < 0.7:
            victim.write_text(text_of(altered(json.loads(victim.read_text()), rng), rng), "utf-8", "replace")
        elif rng.random() < 0.2:
            victim.unlink()
        else:
            victim.write_bytes(damaged(victim.read_bytes(), rng))
        stage = RunFolder(path, IDENTITY)
        right = self._right(path)
        try:
            with stage.locked():
                if stage.is_up_to_date():
                    if not (finished and right):
                        raise WrongError("a changed folder counts as up to date")
                    self.counts["equal"] += 1
                    return
                read_manifest(path)
                stage.prepare()
                for name in stage.resumable(list(ITEMS)):
                    (path / f"{name}.txt").write_text(name * 100)
                stage.finish(stage="s", run="r", budget="smoke", seed=0, config={"a": 1}, started=time.monotonic())
                if not self._right(path):
                    raise WrongError("a damaged result was kept")
                if not stage.is_up_to_date():
                    raise WrongError("a folder that was just finished is not up to date")
        except PipelineError as error:
            self.counts[refused(error)] += 1
            return
        self.counts["refused"] += 1  # and made anew
