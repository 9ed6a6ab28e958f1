"""Sweeps: the basic, joblib, submitit-local and Ray launchers run every job in a folder of its own."""

from __future__ import annotations

import importlib.util
import json

import pytest
from hydra.errors import MissingConfigException

from pipeline.launch import one_line
from pipeline.store.manifest import read_manifest
from pipeline.store.provenance import PROJECT_ROOT
from pipeline.store.variants import variant_of

RAY = importlib.util.find_spec("hydra_plugins") and importlib.util.find_spec("hydra_plugins.hydra_ray_launcher")
COMMON = ("budget=smoke", "name=sweep")
EXPERT = ("stage=expert", *COMMON, "stage.episodes=1", "stage.evaluation_episodes=1", "stage.film=false",
          "stage.phantoms=[type_1]", "stage.targets=[bca]", "stage.task.max_steps=4")  # fmt: skip
VALIDATE = ("stage=validate", *COMMON, "stage.speed_steps=3", "stage.speed_rounds=1", "stage.physics=false")


@pytest.mark.parametrize("launcher", ["joblib", "submitit_local", "ray"])
def test_launcher_runs_every_job(launcher: str, pipeline_process) -> None:
    if launcher == "ray":
        if not RAY:
            pytest.skip("Ray's launcher is not installed: make ray")
        pipeline_process.environment["HOME"] = str(pipeline_process.folder)  # Ray keeps a token of its own there
        pipeline_process.environment["RAY_ADDRESS"] = "local"  # and not a cluster that another test started
    overrides = ["-m", "stage=user_study", "budget=smoke", "name=sweep", "seed=3,4", f"hydra/launcher={launcher}"]
    if launcher == "joblib":
        overrides.append("hydra.launcher.n_jobs=2")
    done = pipeline_process.run(*overrides, timeout_s=600)
    assert done.returncode == 0, done.stderr
    for seed in (3, 4):
        folder = pipeline_process.runs / "sweep" / f"user_study@budget=smoke,seed={seed}"
        assert json.loads((folder / "manifest.json").read_text())["seed"] == seed
    assert not [name for name in ("outputs", "multirun", ".submitit") if (PROJECT_ROOT / name).exists()]


def test_ray_where_it_is_not_installed_is_one_sentence() -> None:
    error = MissingConfigException("not found", missing_cfg_file="hydra/launcher/ray")
    assert one_line(error, []).startswith("Ray's launcher is not installed: run `make ray`")


def test_variants_of_different_jobs_differ() -> None:
    assert variant_of(["stage=phantoms", "name=x", "seed=1"]) == "seed=1"
    assert variant_of(["stage=phantoms"]) == ""
    lists = [variant_of([f"stage.phantoms=[{names}]"]) for names in ("a,b", "a_b", "b,a")]
    assert len(set(lists)) == 3
    long = [variant_of([f"stage.phantoms={'x' * 200}{end}"]) for end in "ab"]
    assert long[0] != long[1]
    assert all(len(name) < 150 and "/" not in name for name in [*lists, *long])
    assert variant_of(["seed=1", "budget=smoke"]) == variant_of(["budget=smoke", "seed=1"])


@pytest.mark.slow
def test_each_seed_of_a_sweep_reads_what_its_own_left(pipeline_process) -> None:
    done = pipeline_process.run_here("stage=phantoms", "stage.phantoms=[type_1]", "stage.picture=false", *COMMON)
    assert done.returncode == 0, done.stderr
    for stage in (EXPERT, VALIDATE):
        done = pipeline_process.run_here("-m", "seed=0,1", *stage)
        assert done.returncode == 0, done.stdout + done.stderr
    run = pipeline_process.runs / "sweep"
    for seed in (0, 1):
        (folder,) = run.glob(f"validate@*seed={seed},*")
        (expert,) = run.glob(f"expert@*seed={seed},*")
        found = read_manifest(folder)
        assert found is not None
        assert found.seed == seed
        assert list(found.identity.input_hashes) == ["phantoms", expert.name]
