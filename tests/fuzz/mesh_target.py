"""Meshes: damaged files and surfaces with faces missing, turned, doubled or moved."""

from __future__ import annotations

import logging
import random
from pathlib import Path

import numpy as np
import trimesh

from cathsim.anatomy import import_mesh
from tests.cathsim.anatomy.generator.drawn_arch import arch_mesh
from tests.fuzz.mutations import damaged
from tests.fuzz.target import Target, WrongError, refused

COARSE = 2.5e-3  # m


class MeshTarget(Target):
    """The import: a phantom with a lumen and targets, or a refusal, within the import's own budget."""

    name = "meshes"
    seconds = 120.0
    megabytes = 3000
    share = 3.0

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        logging.getLogger("trimesh").setLevel(logging.CRITICAL)
        self.mesh = arch_mesh(0.03)
        self.data = {kind: bytes(self._export(kind)) for kind in ("stl", "ply", "obj")}

    def _export(self, kind: str) -> bytes:
        exported = self.mesh.export(file_type=kind)
        return exported.encode() if isinstance(exported, str) else bytes(exported)

    def run(self, seed: int) -> None:
        rng = random.Random(seed)
        kind = rng.choice(sorted(self.data))
        path = self.folder / f"victim.{kind}"
        if rng.random() < 0.7:
            data = self.data[kind]
            for _ in range(rng.choice((1, 3))):
                data = damaged(data, rng)
            path.write_bytes(data)
        else:
            self._altered(rng).export(path)
        try:
            phantom = import_mesh(path, resolution=COARSE, cache_dir=self.folder / "cache")
        except ValueError as error:
            self.counts[refused(error)] += 1
            return
        ends = np.array([target.position for target in phantom.targets.values()])
        if not np.isfinite(ends).all() or not phantom.targets:
            raise WrongError("a phantom without finite targets was imported")
        self.counts["accepted"] += 1

    def _altered(self, rng: random.Random) -> trimesh.Trimesh:
        draw = np.random.default_rng(rng.randrange(2**32))
        vertices, faces = self.mesh.vertices.copy(), self.mesh.faces.copy()
        kind = rng.randrange(6)
        if kind == 0:
            faces = faces[draw.random(len(faces)) < rng.choice((0.5, 0.9, 0.99))]
        elif kind == 1:
            turned = draw.random(len(faces)) < 0.5
            faces[turned] = faces[turned, ::-1]
        elif kind == 2:
            vertices += draw.normal(size=vertices.shape) * rng.choice((1e-4, 1e-3, 1e-2))
        elif kind == 3:
            vertices *= np.array(rng.choice(((1, 1, 0), (1e-6, 1e-6, 1e-6), (1e6, 1e6, 1e6), (1, 1, 5))))
        elif kind == 4:
            faces = np.concatenate((faces, faces[draw.integers(len(faces), size=2000)]))
        else:
            faces = draw.integers(len(vertices), size=(500, 3))
        return trimesh.Trimesh(vertices, faces, process=False)
