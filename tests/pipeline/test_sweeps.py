"""Sweeps: the basic, joblib, submitit-local and Ray launchers run every job in a folder of its own."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
from hydra.errors import MissingConfigException

from pipeline.explain import one_line
from pipeline.store.manifest import read_manifest
from pipeline.store.provenance import PROJECT_ROOT
from pipeline.variants import variant_of
from tests.conftest import PipelineProcess

SMALL = ("stage.decisions=48", "stage.encoder_samples=150", "stage.expert_episodes=1")  # of the stage enn


@pytest.mark.parametrize("launcher", ["joblib", "submitit_local", "ray"])
def test_launcher_runs_every_job(launcher: str, pipeline_process) -> None:
    if launcher == "ray":
        pytest.importorskip("hydra_plugins.hydra_ray_launcher", reason="Ray's launcher is not installed: make ray")
        pipeline_process.environment["HOME"] = str(pipeline_process.folder)  # Ray keeps a token of its own there
        pipeline_process.environment["RAY_ADDRESS"] = "local"  # and not a cluster that another test started
    overrides = ["-m", "stage=report", "budget=smoke", "name=sweep", "seed=3,4", f"hydra/launcher={launcher}"]
    if launcher == "joblib":
        overrides.append("hydra.launcher.n_jobs=2")
    done = pipeline_process.run(*overrides, timeout_s=600)
    assert done.returncode == 0, done.stderr
    for seed in (3, 4):
        folder = pipeline_process.runs / "sweep" / f"report@budget=smoke,seed={seed}"
        assert json.loads((folder / "manifest.json").read_text())["seed"] == seed
        assert (folder / "index.html").is_file()
    assert not [name for name in ("outputs", "multirun", ".submitit") if (PROJECT_ROOT / name).exists()]


@pytest.fixture(scope="module")
def expert_run(tmp_path_factory: pytest.TempPathFactory, anatomy_cache: Path) -> PipelineProcess:
    """A run with the episodes that learning reads, of one arch and one target."""
    process = PipelineProcess(tmp_path_factory.mktemp("sweep"), {**os.environ, "CATHSIM_CACHE": str(anatomy_cache)})
    process.environment["HOME"] = str(process.folder)  # Ray keeps a token of its own there
    process.environment["RAY_ADDRESS"] = "local"  # and not a cluster that another test started
    for stage in (
        ["stage=phantoms", "stage.phantoms=[type_1]"],
        ["stage=expert", "stage.phantoms=[type_1]", "stage.targets=[bca]", "stage.episodes=1"],
    ):
        done = process.run(*stage, "budget=smoke", "name=sweep")
        assert done.returncode == 0, done.stderr
    return process


def test_two_workers_learn_beside_each_other(expert_run: PipelineProcess) -> None:
    pytest.importorskip("hydra_plugins.hydra_ray_launcher", reason="Ray's launcher is not installed: make ray")
    seeds = (2, 3)
    done = expert_run.run(
        "-m", "stage=enn", "budget=smoke", "name=sweep", f"seed={','.join(map(str, seeds))}", "phantom.name=type_1",
        "target=bca", "modality=I", "stage.workers=1", *SMALL, "hydra/launcher=ray",
        "+hydra.launcher.ray.init.num_cpus=2", timeout_s=900,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    for seed in seeds:
        (folder,) = (expert_run.runs / "sweep").glob(f"enn@*seed={seed},*")
        assert list(folder.rglob("policy.pt"))
        assert json.loads((folder / "manifest.json").read_text())["seed"] == seed


def test_ray_where_it_is_not_installed_is_one_sentence() -> None:
    error = MissingConfigException("not found", missing_cfg_file="hydra/launcher/ray")
    assert one_line(error, []) == (
        "Ray's launcher is not installed: run `make ray`, or choose basic, joblib or submitit_local"
    )


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
def test_each_seed_of_a_sweep_learns_from_its_own_teacher(expert_run: PipelineProcess) -> None:
    common = ("budget=smoke", "name=sweep", "phantom.name=type_1", "target=bca", "modality=I+V+M")
    for stage, further in (("enn", SMALL), ("imitation", ("stage.workers=1",))):
        done = expert_run.run("-m", "seed=0,1", f"stage={stage}", *further, *common, timeout_s=600)
        assert done.returncode == 0, done.stdout + done.stderr
    alone = expert_run.run("stage=imitation", "seed=1", *common, timeout_s=300)
    assert alone.returncode == 0, alone.stderr
    run = expert_run.runs / "sweep"
    for seed in (0, 1):
        (folder,) = run.glob(f"imitation@*modality=I+V+M,*seed={seed},*")
        (teacher,) = run.glob(f"enn@*modality=I+V+M,*seed={seed},*")
        found = read_manifest(folder)
        assert found is not None
        assert found.seed == seed
        assert list(found.identity.input_hashes) == [teacher.name]
    single = read_manifest(run / "imitation@seed=1")
    assert single is not None
    assert [name.count("seed=1") for name in single.identity.input_hashes] == [1]
    lost = expert_run.run("stage=imitation", "seed=7", *common)
    assert lost.returncode == 2
    assert "fits" in lost.stderr
    assert "seed=7" in lost.stderr
