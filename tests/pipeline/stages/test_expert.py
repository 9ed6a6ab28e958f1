"""The stages expert and validate: episodes that others learn from or are compared with, and their forces."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from cathsim.physics_checks import AIM_PCT
from pipeline.episodes import EpisodeReader
from pipeline.episodes.checking import check
from pipeline.evaluations.forces import episode_forces
from pipeline.evaluations.tables import tables_from_logs
from pipeline.recording.replay import replay
from pipeline.seeds import demonstration_seeds, held_out_seeds
from pipeline.stages.expert import ExpertSettings, run_expert
from pipeline.stages.validate import ValidateSettings, check_validate, physics_rows, run_validate, validate_forces
from pipeline.store.errors import ConfigurationError, StageError
from pipeline.store.run_folder import Identity, RunFolder
from pipeline.tables import read_figures, read_results
from pipeline.task import Task, number_of_actions
from tests.pipeline.evaluations.evaluation_logs import write_force_log
from tests.pipeline.stages.small_expert import context


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    settings = ExpertSettings(phantoms=["type_1"], targets=["bca"], episodes=1, evaluation_episodes=2, film=False,
                              task=Task(max_steps=4), threads=1)  # fmt: skip
    run_expert(settings, context(folder, "expert", reads=())).write(folder / "expert")
    return folder / "expert"


def test_evaluations_have_starts_and_seeds_of_the_policies_and_are_alone_in_the_tables(run: Path) -> None:
    tables = json.loads((run / "results.json").read_text())
    assert tables_from_logs(run.parent)["expert"]["type_1/bca"]["n"] == 2
    assert "evaluation_episodes" not in tables["task"]  # which is said of the policies
    assert tables["task"]["actions"]["value"] == 2
    assert number_of_actions(Task(actions="tip_motors", wire="thesis")) == 21
    demonstrations, evaluations = (sorted((run / "type_1/bca" / part).glob("*.mcap")) for part in (".", "evaluation"))
    assert (len(demonstrations), len(evaluations)) == (1, 2)
    told = []
    for log in (*demonstrations, *evaluations):
        with EpisodeReader(log) as reader:
            told.append((reader.info.seed, reader.info.configuration["start_rotation"]))
            first = float(reader.load_arrays(pictures=False)["rotation"][0])
        assert (abs(first) > 1e-3) == (log in evaluations)
    assert [seed for seed, _ in told] == [*demonstration_seeds(0, 1), *held_out_seeds(0, 2)]
    assert [rotation for _, rotation in told] == pytest.approx([0.0, 3.14159, 3.14159], abs=1e-4)


def test_a_catheter_alone_is_steered_and_stands_apart_in_the_tables(tmp_path: Path) -> None:
    settings = ExpertSettings(phantoms=["type_1"], targets=["bca"], episodes=1, evaluation_episodes=1, film=False,
                              task=Task(max_steps=2, wire="none", catheter="vertebral"), threads=1)  # fmt: skip
    run_expert(settings, context(tmp_path, "expert", reads=())).write(tmp_path / "expert")
    log = tmp_path / "expert/type_1/bca/evaluation/000.mcap"
    assert not check(log).problems
    with EpisodeReader(log) as reader:
        devices = reader.step(2).devices
        assert devices is not None
        assert len(devices.wire_points) == 0
        assert len(devices.catheter_points) > 10
        assert len(reader.step(1).action) == 2
    assert len(replay(log).actions) == 2
    assert list(tables_from_logs(tmp_path)["devices"]) == ["type_1/bca/expert/sampling_expert/vertebral alone"]


STEPS = 40


def test_stage_writes_tables_and_figures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    expert, phantoms, folder = (tmp_path / name for name in ("expert", "phantoms", "validate"))
    generator = np.random.default_rng(0)
    for index, (phantom, target) in enumerate([("type_1", "bca"), ("type_1", "lcca"), ("type_2", "bca")]):
        forces = np.abs(generator.normal(0.0, 0.05, STEPS))
        write_force_log(expert / phantom / target / f"{index:03d}.mcap", forces, phantom=phantom, target=target)
    for name in ("type_1", "type_2"):
        (phantoms / name).mkdir(parents=True)
        trimesh.creation.icosphere(subdivisions=3, radius=0.03).export(phantoms / name / "lumen.stl")
    folder.mkdir()
    settings = ValidateSettings(speed_steps=8, speed_rounds=1, physics=False)
    context = SimpleNamespace(path=folder, inputs={"expert": expert, "phantoms": phantoms}, seed=0)
    run_validate(settings, context).write(folder)  # type: ignore[arg-type]
    tables = read_results(folder)
    forces = tables["force_validation"]
    assert forces["samples"]["value"] == 2 * STEPS  # the phantom of the real experiments alone
    assert forces["p_value"]["value"] < 1e-6
    speed = {name: row["value"] for name, row in tables["training_speed_fps"].items()}
    assert speed["min"] == min(speed.values()) <= speed["internal"] <= speed["max"] == max(speed.values())
    assert speed["min"] > 1
    assert tables["simulators"]["cathsim"]["engine"].startswith("MuJoCo ")
    assert "wire_physics" not in tables
    files = [figure.file for figure in read_figures(folder)]
    assert files == ["distribution.png", "heat/type_1.png", "heat/type_2.png"]
    assert "Differs: Location" in (folder / "verdict.txt").read_text()


def test_verdict_of_a_catheter_alone_names_no_guidewire(tmp_path: Path) -> None:
    path = tmp_path / "000.mcap"
    write_force_log(path, np.abs(np.random.default_rng(0).normal(0.0, 0.05, STEPS)))
    episode = replace(episode_forces(path), device="vertebral alone")
    validate_forces([episode], ValidateSettings(speed_steps=8), tmp_path, seed=0)
    words = (tmp_path / "verdict.txt").read_text()
    assert "a catheter without a wire (vertebral)" in words
    assert "the steering can explain" not in words


def test_stage_without_enough_episodes_or_with_an_unknown_phantom_says_so(tmp_path: Path) -> None:
    context = SimpleNamespace(path=tmp_path, inputs={"expert": tmp_path, "phantoms": tmp_path}, seed=0)
    with pytest.raises(StageError, match=r"cannot be compared with real forces .*: record more of them"):
        run_validate(ValidateSettings(), context)  # type: ignore[arg-type]
    with pytest.raises(ConfigurationError, match="unknown phantom 'type_9'"):
        check_validate(ValidateSettings(phantom="type_9"))


def test_physics_is_checked_in_a_job_whose_failure_is_one_sentence(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path / "validate", Identity("c", {}, 1))
    with folder.locked():
        folder.prepare()
        with pytest.raises(StageError, match=r"1 of 1 physics checks failed: wire_physics \(KeyError: 'torsion'\)"):
            physics_rows(folder, ("torsion",))
        rows = physics_rows(folder, ("helix",))
    assert 0.0 < rows["helix"]["worst_error_pct"] < AIM_PCT["helix"]
