"""Model files and checkpoints: damaged bytes, and files that are missing or exchanged."""

import random
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from enn.encoder import Encoder, EncoderSettings
from enn.policy import Policy
from enn.reinforcement.checkpoint import CheckpointError, CheckpointFolder
from splineformer import build as splineformer_build
from splineformer.predictor import Predictor
from tests.enn.test_model_file import policy
from tests.fuzz.mutations import damaged
from tests.fuzz.promise import BrokenPromiseError, fuzz, refused
from tests.guide3d.test_shipped import shape

STATE = {
    "weights": {"a": torch.arange(40.0)},
    "decisions": 7,
    "generator": np.random.default_rng(0).bit_generator.state,
}
ROWS = np.random.default_rng(0).normal(size=(50, 3)).astype(np.float32)


def encoder() -> Encoder:
    """A small encoder."""
    return Encoder(EncoderSettings(keys=("image", "joints"), shapes=((1, 36, 36), (4,)), hidden=8, features=6))


def wire_reader() -> Predictor:
    """A small SplineFormer."""
    return Predictor(splineformer_build.build(splineformer_build.size_of("ordered", "smoke")), source_px=256)


def weights(model: Any) -> dict[str, torch.Tensor]:
    """The numbers of a model; those of a policy's critic are not kept."""
    network = model.module if isinstance(model, Policy) else getattr(model, "network", model)
    return {name: values for name, values in network.state_dict().items() if not name.startswith("critic")}


Kind = tuple[Callable[[Path], Any], bytes, dict[str, torch.Tensor]]


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where damaged files go."""
    return tmp_path_factory.mktemp("models") / "victim.pt"


@pytest.fixture(scope="module")
def kinds(path: Path) -> list[Kind]:
    """Each kind of model: what loads it, its file, its weights."""
    torch.manual_seed(0)
    found: list[Kind] = []
    for model in (policy(), encoder(), shape(), wire_reader()):
        model.save(path)
        found.append((type(model).load, path.read_bytes(), weights(type(model).load(path))))
    return found


@fuzz()
def test_models(rng: random.Random, path: Path, kinds: list[Kind]) -> str:
    """A file that opens has the very weights that were written."""
    load, data, truth = rng.choice(kinds)
    if rng.random() < 0.1:
        path.write_bytes(data)  # perhaps a model of another kind
        load = rng.choice(kinds)[0]
    else:
        path.write_bytes(damaged(data, rng))
    try:
        found = weights(load(path))
    except ValueError as error:
        return refused(error)
    if found.keys() != truth.keys() or not all(torch.equal(found[name], truth[name]) for name in truth):
        raise BrokenPromiseError("a damaged model was loaded with other weights")
    return "equal"


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
