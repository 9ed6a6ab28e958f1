"""Checkpoints of a training: damaged bytes, and files that are missing or exchanged."""

import random
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch

from enn.reinforcement.checkpoint import CheckpointError, CheckpointFolder
from tests.fuzz.mutations import damaged
from tests.fuzz.promise import BrokenPromiseError, fuzz, refused

STATE = {
    "weights": {"a": torch.arange(40.0)},
    "decisions": 7,
    "generator": np.random.default_rng(0).bit_generator.state,
}
ROWS = np.random.default_rng(0).normal(size=(50, 3)).astype(np.float32)


def checkpoint_folder(path: Path) -> CheckpointFolder:
    """The checkpoints of a small training."""
    return CheckpointFolder(path, {"algorithm": "sac", "hidden": (16, 16)})


@pytest.fixture(scope="module")
def checkpoints(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of two checkpoints."""
    folder = tmp_path_factory.mktemp("checkpoints") / "whole"
    for version in (1, 2):
        checkpoint_folder(folder).write(STATE, [("rows", version, ROWS), ("more", 1, np.arange(9))])
    return folder


@fuzz()
def test_checkpoints(rng: random.Random, checkpoints: Path) -> str:
    """A checkpoint that is read is the one that was written."""
    path = checkpoints.with_name("victim")
    shutil.rmtree(path, ignore_errors=True)
    shutil.copytree(checkpoints, path)
    files = sorted(path.iterdir())
    victim, other = rng.choice(files), rng.choice(files)
    kind = rng.randrange(6)
    if kind == 0:
        victim.unlink()
    elif kind == 1:
        victim.write_bytes(other.read_bytes())
    elif kind == 2:
        victim.unlink()
        victim.mkdir()
    else:
        victim.write_bytes(damaged(victim.read_bytes(), rng))
    checkpoint = checkpoint_folder(path)
    if not checkpoint.exists():
        return "refused"  # the training begins anew
    try:
        state, pieces = checkpoint.read()
    except CheckpointError as error:
        return refused(error)
    same = torch.equal(state["weights"]["a"], STATE["weights"]["a"]) and state["decisions"] == 7
    if not same or not np.array_equal(pieces["rows"], ROWS) or not np.array_equal(pieces["more"], np.arange(9)):
        raise BrokenPromiseError("a damaged checkpoint was read as something else")
    return "equal"
