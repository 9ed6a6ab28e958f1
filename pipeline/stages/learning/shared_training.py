"""A training that two stages of a run define alike is made once: the second takes the files of the first.

So the row "V" of the stage enn is "sac_image" of the baselines on the same phantom, target and seed. What a training is
defined by decides, code and versions included; where it is not known, each stage trains.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline.recording.trials import POLICY
from pipeline.store.atomic_files import read_json, write_json, write_text
from pipeline.store.provenance import (
    hash_file,
    hash_value,
    present_commit,
    software_versions,
    uncommitted_changes,
)

CACHE = ".cache"  # below the run's folder; it may be deleted
RECORD, CURVE, CHECKPOINT = "training.json", "training.csv", "checkpoint"
TAKEN_FROM = "taken_from"  # in the policy's and the record's metadata: the folder, below the run's
_FOLDERS = ("tensorboard", "films")


@dataclass(frozen=True)
class SharedTraining:
    """Where a run's trainings of one definition are named, and the run's folder."""

    note: Path
    run: Path

    def take(self, folder: Path, metadata: Mapping[str, Any]) -> bool:
        """Fills a training's folder with a finished one of this definition, if there is one; its metadata are new."""
        from enn.policy import Policy

        try:
            note = read_json(self.note)
            source = self.run / note["folder"]
            if source == folder or hash_file(source / POLICY) != note["policy"]:
                return False
            record, curve = read_json(source / RECORD), (source / CURVE).read_text("utf-8")
            changed = {**record["metadata"], **metadata, TAKEN_FROM: note["folder"]}
            policy = Policy.load(source / POLICY)
            policy.metadata = {**policy.metadata, **changed}
            folder.mkdir(parents=True, exist_ok=True)
            for name in _FOLDERS:
                if (source / name).is_dir():
                    shutil.copytree(source / name, folder / name, dirs_exist_ok=True)
            write_text(folder / CURVE, curve)
            policy.save(folder / POLICY, critics=policy.critics)
            write_json(folder / RECORD, {**record, "metadata": changed})  # last: it says that the training is finished
        except (KeyError, OSError, TypeError, ValueError):  # none, or moved aside meanwhile: this stage trains
            return False
        return True

    def offer(self, folder: Path) -> None:
        """Names a finished training of this definition."""
        self.note.parent.mkdir(parents=True, exist_ok=True)
        note = {"folder": folder.relative_to(self.run).as_posix(), "policy": hash_file(folder / POLICY)}
        write_json(self.note, note)


def shared_training(run: Path, definition: Mapping[str, Any]) -> SharedTraining | None:
    """A run's trainings of a definition by the present code; None where that code's commit is unknown."""
    commit = present_commit()
    if commit == "unknown":
        return None
    whole = {**definition, "code": (commit, uncommitted_changes(), software_versions())}
    return SharedTraining(run / CACHE / "trainings" / f"{hash_value(whole)}.json", run)
