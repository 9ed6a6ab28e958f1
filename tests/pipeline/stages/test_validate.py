"""The validate stage: tables and figures from logs, the physics benchmark, settings that are refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from cathsim.physics_checks import AIM_PCT
from pipeline.evaluations.forces import episode_forces
from pipeline.stages.validate import ValidateSettings, check_validate, physics_rows, run_validate, validate_forces
from pipeline.store.errors import ConfigurationError, StageError
from pipeline.store.run_folder import Identity, RunFolder
from pipeline.tables import read_figures, read_results
from tests.pipeline.evaluations.evaluation_logs import write_force_log

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
    assert tables["simulators"]["cathsim"]["catheter"] == "discretised, over the wire in one rod"
    assert "wire_physics" not in tables
    assert [figure.file for figure in read_figures(folder)] == [
        "distribution.png", "boxes.png", "heat/type_1.png", "heat/type_2.png"
    ]  # fmt: skip
    assert "Differs: Location" in (folder / "verdict.txt").read_text()


def test_verdict_of_a_catheter_alone_names_no_guidewire(tmp_path: Path) -> None:
    path = tmp_path / "000.mcap"
    write_force_log(path, np.abs(np.random.default_rng(0).normal(0.0, 0.05, STEPS)))
    episode = replace(episode_forces(path), device="vertebral alone")
    validate_forces([episode], ValidateSettings(speed_steps=8), tmp_path, seed=0)
    words = (tmp_path / "verdict.txt").read_text()
    assert "these are the contacts of a catheter without a wire (vertebral) with a rigid wall" in words
    assert "the steering can explain" not in words


def test_stage_without_enough_episodes_says_so(tmp_path: Path) -> None:
    context = SimpleNamespace(path=tmp_path, inputs={"expert": tmp_path, "phantoms": tmp_path}, seed=0)
    with pytest.raises(StageError, match=r"cannot be compared with real forces .*: record more of them"):
        run_validate(ValidateSettings(), context)  # type: ignore[arg-type]


def test_physics_is_checked_in_a_job_whose_failure_is_one_sentence(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path / "validate", Identity("c", {}, 1))
    with folder.locked():
        folder.prepare()
        with pytest.raises(StageError, match=r"1 of 1 physics checks failed: wire_physics \(KeyError: 'torsion'\)"):
            physics_rows(folder, ("torsion",))
        rows = physics_rows(folder, ("helix",))
    assert 0.0 < rows["helix"]["worst_error_pct"] < AIM_PCT["helix"]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"real_sd_n": 0.0}, "stage.real_sd_n must be greater than 0"),
        ({"speed_steps": 0}, "stage.speed_steps must be 1 or more"),
    ],
)
def test_settings_are_checked(settings: dict, message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        ValidateSettings(**settings)
    with pytest.raises(ConfigurationError, match="unknown phantom 'type_9'"):
        check_validate(ValidateSettings(phantom="type_9"))
