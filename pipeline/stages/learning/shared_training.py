"""A training that two stages of a run define alike is made once: the second takes the files of the first.

So the row "V" of the stage enn is "sac_image" of the baselines on the same phantom, target and seed. What a training is
defined by decides, code and versions included; where it is not known, each stage trains.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.store.atomic_files import atomic_path, write_json
from pipeline.store.file_cache import CACHE
from pipeline.store.provenance import (
    hash_file,
    hash_value,
    present_commit,
    software_versions,
    uncommitted_changes,
)

if TYPE_CHECKING:
    from pipeline.stages.learning.training import PolicyTrainingJob

POLICY, RECORD, CURVE, CHECKPOINT = "policy.pt", "training.json", "training.csv", "checkpoint"
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
            found = json.loads(self.note.read_text(encoding="utf-8"))
            source = self.run / found["folder"]
            if source == folder or hash_file(source / POLICY) != found["policy"]:
                return False
            record = json.loads((source / RECORD).read_text(encoding="utf-8"))
            changed = {**record["metadata"], **metadata, TAKEN_FROM: found["folder"]}
            policy = Policy.load(source / POLICY)
            policy.metadata = {**policy.metadata, **changed}
            folder.mkdir(parents=True, exist_ok=True)
            for name in _FOLDERS:
                if (source / name).is_dir():
                    shutil.copytree(source / name, folder / name, dirs_exist_ok=True)
            with atomic_path(folder / CURVE) as curve:
                shutil.copyfile(source / CURVE, curve)
            policy.save(folder / POLICY, critics=policy.critics)
            write_json(folder / RECORD, {**record, "metadata": changed})  # last: it says that the training is finished
        except (KeyError, OSError, TypeError, ValueError):  # none, or moved aside meanwhile: this stage trains
            return False
        return True

    def offer(self, folder: Path) -> None:
        """Names a finished training of this definition."""
        self.note.parent.mkdir(parents=True, exist_ok=True)
        found = {"folder": folder.relative_to(self.run).as_posix(), "policy": hash_file(folder / POLICY)}
        write_json(self.note, found)


def shared_training(job: PolicyTrainingJob, device: str) -> SharedTraining | None:
    """The trainings of a job's definition; None where the code's commit is unknown, or the anatomy is of a file."""
    commit = present_commit()
    if commit == "unknown" or job.task.file is not None:
        return None
    definition = {
        "settings": asdict(job.settings),
        "task": asdict(job.task),
        "keys": job.keys,
        "seed": job.origin.training_seed,
        "encoder": None if job.encoder is None else hash_file(job.encoder),
        "demonstrations": [hash_file(log) for log in job.demonstrations],
        "code": (commit, uncommitted_changes(), software_versions(), device),
    }
    return SharedTraining(job.run / CACHE / "trainings" / f"{hash_value(definition)}.json", job.run)
