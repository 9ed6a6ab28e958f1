"""Variants and sweeps: each run reads the results that belong to it, checked; launchers run every job of a sweep."""

import importlib.util
import json
import shutil
import time
from pathlib import Path

import pytest
from hydra.errors import MissingConfigException

from pipeline.launch import one_line
from pipeline.store.errors import StageError
from pipeline.store.manifest import Identity, read_manifest
from pipeline.store.provenance import PROJECT_ROOT
from pipeline.store.run_folder import RunFolder
from pipeline.store.variants import RunRequest, require_input, variant_of


def leave(run: Path, stage: str, *variant: str, seed: int = 0) -> Path:
    """Leaves the finished results of a stage."""
    place = run / "@".join([stage, *([variant_of(variant)] if variant else [])])
    folder = RunFolder(place, Identity("config", {}, 1))
    with folder.locked():
        folder.prepare()
        (place / "type_1").mkdir()
        (place / "type_1" / "policy.pt").write_text(f"{stage} {variant} {seed}")
        (place / "results.json").write_text("{}")
        folder.finish(
            stage=stage, run=run.name, budget="desk", seed=seed, config={}, started=time.monotonic(),
            overrides=["budget=smoke", *variant], variant=variant,
        )  # fmt: skip
    return place


def read(run: Path, *overrides: str, in_sweep: bool = False, seed: int = 0) -> str:
    return require_input(run, "enn", "force", RunRequest(overrides, in_sweep, seed))[0].name


def test_every_seed_of_a_sweep_finds_its_own_teacher(tmp_path: Path) -> None:
    for seed in (0, 1, 2):
        leave(tmp_path, "enn", f"seed={seed}", "stage.seeds=1", seed=seed)
    for seed in (0, 1, 2):
        assert read(tmp_path, f"seed={seed}", in_sweep=True, seed=seed) == f"enn@seed={seed},stage.seeds=1"
    assert read(tmp_path) == "enn@seed=0,stage.seeds=1"  # outside a sweep, by the default seed
    assert read(tmp_path, "seed=2", seed=2) == "enn@seed=2,stage.seeds=1"


def test_a_sweep_of_several_overrides_chooses_by_all_of_them(tmp_path: Path) -> None:
    for seed in (0, 1):
        for target in ("bca", "lcca"):
            leave(tmp_path, "enn", f"seed={seed}", f"target={target}", seed=seed)
        leave(tmp_path, "enn", f"seed={seed}", seed=seed)
    assert read(tmp_path, "seed=1", "target=lcca", in_sweep=True, seed=1) == "enn@seed=1,target=lcca"
    assert read(tmp_path, "seed=1", "target=lsa", in_sweep=True, seed=1) == "enn@seed=1"
    assert read(tmp_path, "seed=1", "stage.epochs=3", in_sweep=True, seed=1) == "enn@seed=1"
    assert read(tmp_path, "+seed=1", "target=bca", "budget=desk", in_sweep=True, seed=1) == "enn@seed=1,target=bca"


def test_what_was_run_once_serves_every_seed_until_the_stage_runs_for_several(tmp_path: Path) -> None:
    leave(tmp_path, "enn")
    assert read(tmp_path, "seed=3", seed=3) == "enn"
    leave(tmp_path, "enn", "seed=1", seed=1)
    assert read(tmp_path) == "enn"
    assert read(tmp_path, "seed=1", seed=1) == "enn@seed=1"
    with pytest.raises(StageError, match=r"none of enn, enn@seed=1 in .* fits seed=3: run `.* force -- seed=3 "):
        read(tmp_path, "seed=3", seed=3)


def test_two_that_fit_equally_well_are_named(tmp_path: Path) -> None:
    first = leave(tmp_path, "enn", "seed=1", "stage.decisions=500", seed=1)
    second = leave(tmp_path, "enn", "seed=1", "stage.decisions=900", seed=1)
    with pytest.raises(StageError, match="stage force could read") as raised:
        read(tmp_path, "seed=1", in_sweep=True, seed=1)
    assert all(str(place) in str(raised.value) for place in (first, second))


def test_folders_of_runs() -> None:
    for seeded in (True, False):
        assert RunRequest(("stage=enn",), False, 0).variant(seeded=seeded) == []
        assert RunRequest(("stage=enn", "seed=1"), False, 1).variant(seeded=seeded) == (["seed=1"] if seeded else [])
        swept = RunRequest(("stage=enn", "seed=1", "target=bca"), True, 1)
        assert swept.variant(seeded=seeded) == ["seed=1", "target=bca"]


@pytest.mark.parametrize("damage", ["a file gone", "a bit flipped", "a folder gone"])
def test_damaged_inputs_are_refused_with_the_command_that_makes_them_again(damage: str, tmp_path: Path) -> None:
    place = leave(tmp_path / "run", "enn", "seed=1", seed=1)
    file = place / "type_1" / "policy.pt"
    assert read(tmp_path / "run", "seed=1", seed=1) == "enn@seed=1"
    if damage == "a file gone":
        file.unlink()
    elif damage == "a folder gone":
        shutil.rmtree(file.parent)
    else:
        content = bytearray(file.read_bytes())
        content[3] ^= 4
        file.write_bytes(content)
    words = "was changed" if damage == "a bit flipped" else "is missing"
    with pytest.raises(StageError) as raised:
        read(tmp_path / "run", "seed=1", seed=1)
    command = f"python -m pipeline stage=enn name=run budget=smoke seed=1 force=true runs_dir={tmp_path}"
    assert str(raised.value).startswith(f"stage force cannot read stage enn: {file} {words}; run `{command}`")


def test_a_file_that_the_stage_did_not_write_is_not_taken_for_its_own(tmp_path: Path) -> None:
    place = leave(tmp_path, "enn")
    (place / "type_1" / "episode.rrd").write_text("no stage reads this")
    assert read(tmp_path) == "enn"
    (place / "type_1" / "other.pt").write_text("a policy from elsewhere")
    with pytest.raises(StageError, match=r"other\.pt was not written by it; move that file away"):
        read(tmp_path)


def test_a_manifest_of_an_earlier_version_counts_as_not_run(tmp_path: Path, caplog) -> None:
    place = leave(tmp_path, "enn")
    text = (place / "manifest.json").read_text()
    (place / "manifest.json").write_text(text.replace('"version": 3', '"version": 2'))
    assert read_manifest(place) is None
    assert "of another version of the project: the stage counts as not run" in caplog.text
    with pytest.raises(StageError, match=r"holds none: run `python -m pipeline\.chain --inputs force -- "):
        read(tmp_path)


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
    coarse = ("stage.phantoms=[type_1]", "stage.picture=false", "stage.resolution_mm=2.5")
    done = pipeline_process.run_here("stage=phantoms", *coarse, *COMMON)
    assert done.returncode == 0, done.stderr
    for seeds, stage in (("0,1", EXPERT), ("1", VALIDATE)):  # seed 0 is what it would read anyway
        done = pipeline_process.run_here("-m", f"seed={seeds}", *stage)
        assert done.returncode == 0, done.stdout + done.stderr
    run = pipeline_process.runs / "sweep"
    (folder,) = run.glob("validate@*seed=1,*")
    (expert,) = run.glob("expert@*seed=1,*")
    found = read_manifest(folder)
    assert found is not None
    assert found.seed == 1
    assert list(found.identity.input_hashes) == ["phantoms", expert.name]
