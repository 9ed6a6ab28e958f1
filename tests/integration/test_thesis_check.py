"""The check of the thesis's sizes: every stage of budget=thesis runs through with its real networks and images."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pipeline.stages import available_stages
from tests.conftest import PROJECT_ROOT

pytestmark = pytest.mark.slow

# Rows that have the network of another one, or one whose size the tests of guide3d's networks count, are left out.
FEWER_ROWS = (
    "stage@baselines.observations=[internal,sequential]",
    "stage@enn.modalities=[]",
    "stage@shape.rows=[spherical,fgrn]",
    "stage@segmentation.rows=[swinunet]",
    "stage@splineformer.rival=swinunet",
    "stage@splineformer.variants=[ordered]",
)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory, anatomy_cache: Path) -> Path:
    """The folder of a run of the check."""
    runs = tmp_path_factory.mktemp("runs")
    done = subprocess.run(
        [sys.executable, "-m", "pipeline.thesis_check", f"runs_dir={runs}", *FEWER_ROWS],
        cwd=PROJECT_ROOT, env={**os.environ, "CATHSIM_CACHE": str(anatomy_cache)}, capture_output=True, text=True,
        timeout=3600, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr + done.stdout[-4000:]
    assert (runs / "thesis-check" / "thesis_check.md").read_text() in done.stdout
    return runs / "thesis-check"


def test_every_stage_and_job_succeeds_and_tells_what_it_took(run: Path) -> None:
    told = json.loads((run / "thesis_check.json").read_text())
    rows = told["rows"]
    assert {row["result"] for row in rows} == {"ok"}
    assert [row["stage"] for row in rows if not row["job"]] == list(available_stages())
    jobs = {f"{row['stage']}/{row['job']}" for row in rows}
    for key in (
        *(f"baselines/type_1/bca/{a}_{o}/seed0" for a in ("ppo", "sac") for o in ("internal", "sequential")),
        "baselines/type_1/bca/path_follower/seed0",
        *(f"enn/type_1/bca/{sees}/seed0" for sees in ("I+V+M", "I+V+M safe 5")),
        "imitation/type_1/bca/dagger", "force/V+M/16", "unseen/roadmap", "unseen/image_true_mask", "unseen/xray",
        *(f"shape/{row}" for row in ("spherical", "fgrn")),
        "segmentation/swinunet",
        "splineformer/ordered", "navigation/splineformer_dagger",
        "navigation/splineformer_arches",
    ):  # fmt: skip
        assert key in jobs, key
    assert all(row["seconds"] > 0 and row["peak memory, MB"] > 10 for row in rows)
    assert told["command"].startswith("python -m pipeline.thesis_check")
    assert {"torch", "numpy"} <= set(told["versions"])


def test_policies_have_the_wire_images_and_actions_of_the_thesis(run: Path) -> None:
    from enn.policy import Policy
    from pipeline.task import TASK, Task, task_from

    def policy(path: str) -> Policy:
        return Policy.load(run / path / "policy.pt")

    expert = policy("enn/type_1/bca/I+V+M/seed0")
    shapes = {key: expert.observation_space[key].shape for key in expert.keys}  # type: ignore[index]
    assert shapes == {"joints": (336,), "image": (1, 80, 80), "mask": (1, 80, 80)}
    assert expert.action_space.shape == (2,)
    assert task_from(expert.metadata[TASK]) == Task(wire="thesis", start_rotation_deg=0.0, max_steps=6)
    for algorithm in ("ppo", "sac"):
        baseline = policy(f"baselines/type_1/bca/{algorithm}_sequential/seed0")
        assert baseline.observation_space["sequential"].shape == (3, 128, 128)  # type: ignore[index]
        assert baseline.action_space.shape == (21,)
        assert baseline.network.algorithm == algorithm


def test_networks_have_the_sizes_of_the_thesis(run: Path) -> None:
    from guide3d.learning.build import SEGMENTER_SIZES, SHAPE_SIZES
    from guide3d.learning.predictor import SegmentationPredictor, ShapePredictor
    from splineformer.build import size_of
    from splineformer.predictor import Predictor

    shape = ShapePredictor.load(run / "shape" / "spherical" / "predictor.pt")
    assert sum(weight.numel() for weight in shape.network.parameters()) > 85e6  # ViT-B/16
    assert shape.preprocessing.size_px == SHAPE_SIZES["thesis"].image_px == 224
    segmenter = SegmentationPredictor.load(run / "segmentation" / "swinunet" / "predictor.pt")
    assert segmenter.preprocessing.size_px == 224
    assert segmenter.size["sizes"] == SEGMENTER_SIZES["swinunet"]["thesis"]
    predictor = Predictor.load(run / "splineformer" / "ordered" / "predictor.pt")
    assert predictor.network.settings == size_of("ordered", "thesis")
    losses = json.loads((run / "splineformer" / "ordered" / "training.json").read_text())["rows"]
    assert np.isfinite([row["loss"] for row in losses]).all()
