"""Sweeps: the basic, joblib, submitit-local and Ray launchers run every job in a folder of its own."""

from __future__ import annotations

import importlib.util
import json

import pytest
from hydra.errors import MissingConfigException

from pipeline.launch import one_line
from pipeline.store.manifest import read_manifest
from pipeline.store.provenance import PROJECT_ROOT
from pipeline.variants import variant_of
from tests.conftest import PipelineProcess

RAY = importlib.util.find_spec("hydra_plugins") and importlib.util.find_spec("hydra_plugins.hydra_ray_launcher")
COMMON = ("budget=smoke", "name=sweep", "phantom.name=type_1", "target=bca", "modality=I+V+M")
SMALL = ("stage.decisions=48", "stage.encoder_samples=150", "stage.expert_episodes=1")  # of the stage enn
SHORT = ("stage.episodes=[1]", "stage.epochs=1", "stage.evaluation_episodes=1", "stage.drawn_episodes=1")  # imitation


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


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> PipelineProcess:
    """A run whose stage enn has two seeds, of one arch and one target."""
    process = PipelineProcess(tmp_path_factory.mktemp("sweep"))
    process.environment["HOME"] = str(process.folder)  # Ray keeps a token of its own there
    process.environment["RAY_ADDRESS"] = "local"  # and not a cluster that another test started
    for stage in (
        ["stage=phantoms", "stage.phantoms=[type_1]"],
        ["stage=expert", "stage.phantoms=[type_1]", "stage.targets=[bca]", "stage.episodes=1"],
    ):
        done = process.run_here(*stage, "budget=smoke", "name=sweep")
        assert done.returncode == 0, done.stderr
    beside = ("hydra/launcher=ray", "+hydra.launcher.ray.init.num_cpus=2") if RAY else ()
    done = process.run("-m", "seed=0,1", "stage=enn", "stage.workers=1", *SMALL, *COMMON, *beside, timeout_s=900)
    assert done.returncode == 0, done.stderr
    return process


@pytest.mark.skipif(not RAY, reason="Ray's launcher is not installed: make ray")
def test_two_workers_learn_beside_each_other(trained: PipelineProcess) -> None:
    for seed in (0, 1):
        (folder,) = (trained.runs / "sweep").glob(f"enn@*seed={seed},*")
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
def test_each_seed_of_a_sweep_learns_from_its_own_teacher(trained: PipelineProcess) -> None:
    done = trained.run("-m", "seed=0,1", "stage=imitation", "stage.workers=1", *SHORT, *COMMON, timeout_s=600)
    assert done.returncode == 0, done.stdout + done.stderr
    alone = trained.run_here("stage=imitation", "seed=1", *SHORT, *COMMON)
    assert alone.returncode == 0, alone.stderr
    run = trained.runs / "sweep"
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
    lost = trained.run_here("stage=imitation", "seed=7", *COMMON)
    assert lost.returncode == 2
    assert "fits" in lost.stderr
    assert "seed=7" in lost.stderr
