"""The expert stage: demonstrations that others learn from, and evaluations from the starts of those compared with."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from pipeline.episodes import EpisodeReader
from pipeline.episodes.checking import check
from pipeline.evaluations.tables import tables_from_logs
from pipeline.recording.replay import replay
from pipeline.seeds import demonstration_seeds, held_out_seeds
from pipeline.stages.expert import ExpertSettings, run_expert
from pipeline.task import Task, number_of_actions
from tests.pipeline.stages.small_expert import context


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    settings = ExpertSettings(phantoms=["type_1"], targets=["bca"], episodes=1, evaluation_episodes=2, film=False,
                              task=Task(max_steps=4), threads=1)  # fmt: skip
    run_expert(settings, context(folder, "expert", reads=())).write(folder / "expert")
    return folder / "expert"


def test_evaluations_have_starts_and_seeds_of_the_policies(run: Path) -> None:
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


def test_tables_hold_evaluations_alone_and_the_number_of_actions(run: Path) -> None:
    tables = json.loads((run / "results.json").read_text())
    assert tables_from_logs(run.parent)["expert"]["type_1/bca"]["n"] == 2
    assert "evaluation_episodes" not in tables["task"]  # which is said of the policies
    assert tables["task"]["actions"]["value"] == 2
    assert number_of_actions(Task(actions="tip_motors", wire="thesis")) == 21


def test_a_catheter_alone_is_steered_and_stands_apart_in_the_tables(tmp_path: Path) -> None:
    settings = ExpertSettings(phantoms=["type_1"], targets=["bca"], episodes=1, evaluation_episodes=1, film=False,
                              task=Task(max_steps=2), wire="none", catheter="vertebral", threads=1)  # fmt: skip
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
