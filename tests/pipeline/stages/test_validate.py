"""The validate stage: tests find what is there, the verdict follows the figures, logs are read right."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from pipeline.episodes import EpisodeInfo, EpisodeOutcome, EpisodeWriter, StepRecord
from pipeline.report.force_statistics import (
    Comparison,
    EpisodeForces,
    compare,
    pooled,
    read_forces,
    table_rows,
    verdict,
)
from pipeline.report.plots.forces import KERNEL, draw_heat, wall_heat
from pipeline.report.results import read_figures, read_results
from pipeline.settings.stage_settings import ValidateSettings
from pipeline.stages import validate
from pipeline.stages.validate import check_validate, physics_from, run_validate
from pipeline.store.errors import ConfigurationError, StageError

REAL = {"real_mean_n": 0.40, "real_sd_n": 0.19}
STEPS = 40
PUSHED = np.array([0.02, 0.04])


def write_log(path: Path, forces: np.ndarray, *, phantom: str = "type_1", target: str = "bca") -> None:
    """A log whose step i > 0 has two contacts that share the force forces[i - 1], and none where that is zero."""
    info = EpisodeInfo(
        phantom=phantom, phantom_hash="5f" * 32, target=target, entry="descending", seed=0, operator="sampling_expert",
        control_dt=0.1, configuration={"expert": {"free_force": 0.15}}, versions={},
    )  # fmt: skip
    path.parent.mkdir(parents=True, exist_ok=True)
    with EpisodeWriter(path, info) as log:
        for step, force in enumerate([7.0, *forces]):  # what lies in the state after reset does not count
            count = 2 if force > 0 else 0
            log.step(
                StepRecord(
                    step=step,
                    action=np.zeros(2),
                    reward=0.0,
                    terminated=False,
                    truncated=False,
                    joint_positions=np.zeros(4),
                    joint_velocities=np.zeros(4),
                    wire_points=np.zeros((3, 3)),
                    tip=np.zeros(3),
                    contact_positions=np.tile([0.0, 0.01, 0.001 * step], (count, 1)),
                    contact_forces=np.tile([0.5 * force, 0.0, 0.0], (count, 1)),
                    resultant_force=np.array([0.0, force, 0.0]),
                    insertion=0.0,
                    rotation=0.0,
                )
            )
        log.finish(EpisodeOutcome(success=True, steps=len(forces), metrics={}))


@pytest.fixture
def drawn() -> np.ndarray:
    return np.random.default_rng(3).normal(0.40, 0.19, 400)


def comparison_of(forces: np.ndarray) -> Comparison:
    return compare(forces, **REAL, generator=np.random.default_rng(0))


def episode(forces: np.ndarray, phantom: str = "type_1") -> EpisodeForces:
    return EpisodeForces(phantom, "bca", "sampling_expert", 0.15, forces, np.zeros((0, 3)), np.zeros(0))


def test_forces_of_the_real_distribution_agree_with_it(drawn: np.ndarray) -> None:
    result = comparison_of(drawn)
    assert min(result.mann_whitney_p, result.levene_p, result.shapiro_p) > 0.05
    assert result.exceedance == pytest.approx(0.5, abs=0.05)
    assert result.u_statistic == pytest.approx(0.5 * 400**2, rel=0.1)
    agrees, differs = verdict(result, [episode(drawn)], PUSHED)
    assert differs == "Nothing."
    assert "no difference in location" in agrees
    assert "may be normal" in agrees


def test_each_test_finds_its_own_difference(drawn: np.ndarray) -> None:
    shifted, narrow = comparison_of(drawn + 0.1), comparison_of(0.40 + 0.5 * (drawn - drawn.mean()))
    skew = comparison_of(np.random.default_rng(1).exponential(0.4, 400))
    assert shifted.mann_whitney_p < 1e-6 < shifted.levene_p
    assert narrow.levene_p < 1e-6 < narrow.mann_whitney_p
    assert skew.shapiro_p < 1e-6 < shifted.shapiro_p
    assert shifted == comparison_of(drawn + 0.1)  # the draws are seeded


def test_verdict_names_size_and_side_of_the_difference_and_what_was_not_tested() -> None:
    small = np.abs(np.random.default_rng(2).normal(0.0, 0.05, 300))
    small[:90] = 0.0
    result = comparison_of(small)
    assert result.contact_share == pytest.approx(0.7)
    agrees, differs = verdict(result, [episode(small)], PUSHED)
    assert f"{result.mean_n:.3f} N, lies below the real 0.40 N by a factor of {0.40 / result.mean_n:.1f}" in differs
    assert "30 % of the steps have no contact force" in differs
    assert "sampling expert, which pays for forces above 0.15 N" in differs
    assert f"0.030 ± 0.010 N, {0.03 / result.mean_n:.1f} times as much: so much the steering can explain" in differs
    assert "was not tested" in differs
    assert "100 % of the simulated forces lie below 2 N" in agrees
    still = comparison_of(np.zeros(50))
    assert "never presses on the wall" in verdict(still, [episode(np.zeros(50))], PUSHED)[1]


def test_large_samples_and_bad_ones() -> None:
    result = comparison_of(np.random.default_rng(4).normal(0.4, 0.19, 12_000))
    assert result.shapiro_p > 1e-3  # thinned to what scipy vouches for, and no warning
    with pytest.raises(ValueError, match=r"at least 8 finite forces to compare, got shape \(3,\)"):
        comparison_of(np.ones(3))
    with pytest.raises(ValueError, match="finite"):
        comparison_of(np.full(20, np.nan))


def test_table_has_the_rows_of_the_thesis(drawn: np.ndarray) -> None:
    rows = table_rows(comparison_of(drawn), PUSHED, "a", "d")
    assert {"u_statistic", "p_value", "shapiro_p", "levene_p", "simulated_force_n", "real_force_n"} <= set(rows)
    assert rows["simulated_force_n"] == {"value": pytest.approx([drawn.mean(), drawn.std()]), "n": 400}
    assert rows["pushed_force_n"]["value"] == pytest.approx([0.03, 0.01])


def test_logs_give_step_forces_and_contacts_without_the_reset(tmp_path: Path) -> None:
    write_log(tmp_path / "type_1/bca/000.mcap", np.array([0.0, 0.2, 0.4]))
    write_log(tmp_path / "type_2/lcca/000.mcap", np.array([0.1]), phantom="type_2", target="lcca")
    first, second = read_forces(tmp_path)
    assert (first.phantom, first.target, first.operator, first.free_force_n) == (
        "type_1",
        "bca",
        "sampling_expert",
        0.15,
    )
    assert first.magnitudes == pytest.approx([0.0, 0.2, 0.4])
    assert first.forces == pytest.approx([0.1, 0.1, 0.2, 0.2])
    assert first.points[:, 2] == pytest.approx([0.002, 0.002, 0.003, 0.003])
    assert len(pooled([first, second])) == 4
    assert pooled([first, second], "type_2") == pytest.approx([0.1])
    assert pooled([]).shape == (0,)


def test_heat_lies_where_the_contacts_are(tmp_path: Path) -> None:
    wall = trimesh.creation.icosphere(subdivisions=4, radius=0.02)
    vertices = np.asarray(wall.vertices)
    points = np.array([[0.0, 0.0, 0.02], [0.0, 0.0, 0.02], [0.02, 0.0, 0.0]])
    largest, total = wall_heat(vertices, points, np.array([0.3, 0.1, 0.2]))
    top, side, back = (
        np.linalg.norm(vertices - place, axis=1).argmin() for place in (points[0], points[2], [0, 0.02, 0])
    )
    assert largest[[top, side, back]] == pytest.approx([0.3, 0.2, 0.0], rel=0.05)
    assert total[[top, side, back]] == pytest.approx([0.4, 0.2, 0.0], rel=0.05)
    away = np.linalg.norm(vertices - points[0], axis=1)
    beyond = (away > 3 * KERNEL) & (np.linalg.norm(vertices - points[2], axis=1) > 3 * KERNEL)
    assert largest[beyond].max() == 0.0
    one = dataclasses.replace(episode(np.ones(4)), points=points, forces=np.array([0.3, 0.1, 0.2]))
    draw_heat(vertices, [one], tmp_path / "heat.png", title="sphere")
    assert (tmp_path / "heat.png").read_bytes().startswith(b"\x89PNG")
    assert np.array_equal(wall_heat(vertices, np.zeros((0, 3)), np.zeros(0))[0], np.zeros(len(vertices)))


def test_stage_writes_tables_and_figures(tmp_path: Path, anatomy_cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CATHSIM_CACHE", str(anatomy_cache))
    expert, phantoms, folder = (tmp_path / name for name in ("expert", "phantoms", "validate"))
    generator = np.random.default_rng(0)
    for index, (phantom, target) in enumerate([("type_1", "bca"), ("type_1", "lcca"), ("type_2", "bca")]):
        forces = np.abs(generator.normal(0.0, 0.05, STEPS))
        write_log(expert / phantom / target / f"{index:03d}.mcap", forces, phantom=phantom, target=target)
    for name in ("type_1", "type_2"):
        (phantoms / name).mkdir(parents=True)
        trimesh.creation.icosphere(subdivisions=3, radius=0.03).export(phantoms / name / "lumen.stl")
    folder.mkdir()
    monkeypatch.setattr(validate, "physics_rows", lambda: {"elastica": {"worst_error_pct": 0.4}})
    settings = ValidateSettings(speed_steps=8, speed_rounds=1)
    context = SimpleNamespace(path=folder, inputs={"expert": expert, "phantoms": phantoms}, seed=0)
    run_validate(settings, context)  # type: ignore[arg-type]
    tables = read_results(folder)
    forces = tables["force_validation"]
    assert forces["samples"]["value"] == 2 * STEPS  # the phantom of the real experiments alone
    assert forces["p_value"]["value"] < 1e-6
    speed = {name: row["value"] for name, row in tables["training_speed_fps"].items()}
    assert speed["min"] == min(speed.values()) <= speed["internal"] <= speed["max"] == max(speed.values())
    assert speed["min"] > 1
    assert tables["simulators"]["cathsim"]["engine"].startswith("MuJoCo ")
    assert tables["wire_physics"] == {"elastica": {"worst_error_pct": 0.4}}
    assert [figure.file for figure in read_figures(folder)] == [
        "distribution.png", "boxes.png", "heat/type_1.png", "heat/type_2.png"
    ]  # fmt: skip
    assert "Differs: Location" in (folder / "verdict.txt").read_text()


def test_stage_without_enough_episodes_says_so(tmp_path: Path) -> None:
    context = SimpleNamespace(path=tmp_path, inputs={"expert": tmp_path, "phantoms": tmp_path}, seed=0)
    with pytest.raises(StageError, match=r"cannot be compared with real forces .*: record more of them"):
        run_validate(ValidateSettings(), context)  # type: ignore[arg-type]


def test_physics_comes_from_the_last_line() -> None:
    output = "a table\n" + json.dumps({"elastica_pct": 0.5, "helix_pct": 3.2, "wall_s": 11.0})
    assert physics_from(output) == {"elastica": {"worst_error_pct": 0.5}, "helix": {"worst_error_pct": 3.2}}


def test_a_failing_benchmark_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(validate, "_ROD", "benchmarks.nothing_of_that_name")
    with pytest.raises(StageError, match=r"failed \(.*nothing_of_that_name.*\): run `python -m"):
        validate.physics_rows()


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
