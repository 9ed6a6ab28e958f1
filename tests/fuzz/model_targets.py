"""Model files and checkpoints: damaged bytes, and files that are missing or exchanged."""

from __future__ import annotations

import random
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch

from enn.encoder import Encoder, EncoderSettings
from enn.networks.network import NetworkSettings, build_network
from enn.policy import Policy
from enn.reinforcement.checkpoint import CheckpointError, CheckpointFolder
from guide3d.learning.build import SHAPE_SIZES, build_shape_network
from guide3d.learning.predictor import ShapePredictor
from guide3d.learning.preprocessing import Preprocessing
from splineformer import build as splineformer_build
from splineformer.predictor import Predictor
from tests.fuzz.mutations import damaged
from tests.fuzz.target import Target, WrongError, refused


def policy() -> Policy:
    """A small policy."""
    space = gymnasium.spaces.Dict({"tip": gymnasium.spaces.Box(-np.inf, np.inf, (3,), np.float32)})
    actions = gymnasium.spaces.Box(-1, 1, (2,), np.float32)
    settings = NetworkSettings(keys=("tip",), hidden=(8, 8))
    return Policy(settings, build_network(settings, space, actions), space, actions)


def encoder() -> Encoder:
    """A small encoder."""
    return Encoder(EncoderSettings(keys=("image", "joints"), shapes=((1, 36, 36), (4,)), hidden=8, features=6))


def shape() -> ShapePredictor:
    """A small shape predictor."""
    size = SHAPE_SIZES["smoke"]
    return ShapePredictor.of(build_shape_network(size, None, 6), size, Preprocessing(size.image_px))


def wire_reader() -> Predictor:
    """A small SplineFormer."""
    return Predictor(splineformer_build.build(splineformer_build.size_of("ordered", "smoke")), source_px=256)


def weights(model: Any) -> dict[str, torch.Tensor]:
    """The numbers of a model; those of a policy's critic are not kept."""
    network = model.module if isinstance(model, Policy) else getattr(model, "network", model)
    return {name: values for name, values in network.state_dict().items() if not name.startswith("critic")}


class ModelTarget(Target):
    """The files of trained networks: a file that opens has the very weights that were written."""

    name = "models"

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        torch.manual_seed(0)
        self.kinds: list[tuple[Callable[[Path], Any], bytes, dict[str, torch.Tensor]]] = []
        for number, model in enumerate((policy(), encoder(), shape(), wire_reader())):
            path = folder / f"{number}.pt"
            model.save(path)
            self.kinds.append((type(model).load, path.read_bytes(), weights(type(model).load(path))))

    def run(self, seed: int) -> None:
        rng = random.Random(seed)
        load, data, truth = rng.choice(self.kinds)
        path = self.folder / "victim.pt"
        if rng.random() < 0.1:
            data, load = rng.choice(self.kinds)[1], rng.choice(self.kinds)[0]  # perhaps a model of another kind
            truth = next(kind[2] for kind in self.kinds if kind[1] is data)
            path.write_bytes(data)
        else:
            path.write_bytes(damaged(data, rng))
        try:
            found = weights(load(path))
        except ValueError as error:
            self.counts[refused(error)] += 1
            return
        if found.keys() != truth.keys() or not all(torch.equal(found[name], truth[name]) for name in truth):
            raise WrongError("a damaged model was loaded with other weights")
        self.counts["equal"] += 1


class CheckpointTarget(Target):
    """The checkpoints of trainings."""

    name = "checkpoints"

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        rng = np.random.default_rng(0)
        self.state = {"weights": {"a": torch.arange(40.0)}, "decisions": 7, "generator": rng.bit_generator.state}
        self.rows = rng.normal(size=(50, 3)).astype(np.float32)
        self.whole = folder / "whole"
        for version in (1, 2):
            self._folder(self.whole, fresh=version == 1).write(
                self.state, [("rows", version, self.rows), ("more", 1, np.arange(9))]
            )

    def _folder(self, path: Path, *, fresh: bool = False) -> CheckpointFolder:
        if fresh:
            shutil.rmtree(path, ignore_errors=True)
        return CheckpointFolder(path, {"algorithm": "sac", "hidden": (16, 16)})

    def run(self, seed: int) -> None:
        rng = random.Random(seed)
        path = self.folder / "victim"
        shutil.rmtree(path, ignore_errors=True)
        shutil.copytree(self.whole, path)
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
        checkpoint = self._folder(path)
        if not checkpoint.exists():
            self.counts["refused"] += 1  # the training begins anew
            return
        try:
            state, pieces = checkpoint.read()
        except CheckpointError as error:
            self.counts[refused(error)] += 1
            return
        same = torch.equal(state["weights"]["a"], self.state["weights"]["a"]) and state["decisions"] == 7
        if (
            not same
            or not np.array_equal(pieces["rows"], self.rows)
            or not np.array_equal(pieces["more"], np.arange(9))
        ):
            raise WrongError("a damaged checkpoint was read as something else")
        self.counts["equal"] += 1
