"""Logs whose content is wrong behind right checksums, as the stages read them: refused or left out, in words."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cathsim import NavigateEnv
from cathsim.console.recorder import write_answers
from pipeline.episodes import EpisodeInfo, EpisodeOutcome, EpisodeReader, EpisodeReadError, EpisodeWriter
from pipeline.evaluations.forces import read_forces
from pipeline.evaluations.logs import read_logs
from pipeline.recording.record import record_episode
from pipeline.recording.replay import ReplayError, replay
from pipeline.stages.user_study import UserStudySettings, figures, gather
from pipeline.store.errors import PipelineError

WRONG_CONFIGURATION: dict[str, dict[str, Any]] = {
    "no wire": {"wire": None},
    "wire a number": {"wire": 5},
    "wire of other fields": {"wire": {"colour": "red"}},
    "time stepping a number": {"numerics": 5},
    "time stepping of other fields": {"numerics": {"speed": 3}},
    "steps a text": {"max_steps": "many"},
    "radius negative": {"success_radius": -1.0},
    "expert a number": {"expert": 5},
    "test set a list": {"test_set": [1]},
    "policy a list": {"policy": [1], "row": {"a": 1}, "mode": 5, "stage": None},
}


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("true") / "0.mcap"
    environment = NavigateEnv("type_1", "bca", observation="tip", max_steps=3)
    steps = iter(np.full((4, 2), 0.5, np.float32))
    record_episode(environment, lambda seen, info: next(steps), path, seed=5, operator="human", pictures=False)
    return path


def rewritten(log: Path, path: Path, *, outcome: dict[str, Any] | None = None, action: Any = None, **info: Any) -> Path:
    """The log again, with other things in it."""
    with EpisodeReader(log) as reader:
        changed: EpisodeInfo = dataclasses.replace(reader.info, **info)
        ended: EpisodeOutcome = dataclasses.replace(reader.outcome, **(outcome or {}))
        with EpisodeWriter(path, changed, phantom_mesh=reader.phantom_mesh()) as writer:
            for record in reader:
                writer.step(record if action is None else dataclasses.replace(record, action=action))
            writer.finish(ended)
    return path


def with_configuration(log: Path, path: Path, changed: dict[str, Any]) -> Path:
    with EpisodeReader(log) as reader:
        configuration = {**reader.info.configuration, **changed}
    return rewritten(log, path, configuration=configuration)


@pytest.mark.parametrize("name", list(WRONG_CONFIGURATION))
def test_a_configuration_that_cannot_be_used_is_one_sentence(name: str, log: Path, tmp_path: Path) -> None:
    folder = tmp_path / "run" / "enn" / "type_1" / "bca" / "I" / "0" / "evaluation"
    folder.mkdir(parents=True)
    forged = with_configuration(log, folder / "0.mcap", WRONG_CONFIGURATION[name])
    uses = (
        lambda: replay(forged),
        lambda: read_logs([tmp_path / "run" / "enn"]),
        lambda: read_forces(tmp_path / "run"),
        lambda: gather([forged], UserStudySettings()),
    )
    for use in uses:
        said = ""
        try:
            use()
        except PipelineError as error:
            said = str(error)
        assert "\n" not in said
        assert len(said) < 600


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"phantom_hash": "0" * 64}, r"recorded in type_1 \(00000000\), the simulator has type_1"),
        ({"phantom": "../../etc"}, "says a phantom, entry or camera that cannot be used"),
        ({"entry": "nowhere"}, "says a phantom, entry or camera that cannot be used"),
        ({"action": np.full(2, np.nan)}, "takes finite ones"),
        ({"action": np.zeros(5)}, "takes finite ones"),
    ],
)
def test_what_no_simulator_repeats_is_refused(changed: dict[str, Any], words: str, log: Path, tmp_path: Path) -> None:
    with pytest.raises((EpisodeReadError, ReplayError), match=words):
        replay(rewritten(log, tmp_path / "forged.mcap", **changed))


def test_a_user_study_leaves_out_what_it_cannot_use(log: Path, tmp_path: Path, caplog) -> None:
    with EpisodeReader(log) as reader:
        kept = dict(reader.outcome.metrics)
    answered = rewritten(log, tmp_path / "answered.mcap")
    write_answers(answered, {"ease": "very"})
    metrics = ({**kept, "steps": "many"}, {**kept, "force_mean": [1], "steps": None}, {"unknown": 1}, {"target": "bca"})
    bad = [rewritten(log, tmp_path / f"{k}.mcap", outcome={"metrics": one}) for k, one in enumerate(metrics)]
    names = [(field, name) for field in ("target", "phantom") for name in ("a/b", "..", "", "a" * 300, "a\0b")]
    for number, (field, name) in enumerate(names):  # that no file can have
        bad.append(rewritten(log, tmp_path / f"name{number}.mcap", **{field: name}))
    study = gather([log, answered, *bad], UserStudySettings(max_steps=3))
    assert study.counted == [log]
    assert study.unreadable == 1 + len(bad)
    assert caplog.text.count("left out: ") == 1 + len(bad)
    assert caplog.text.count("cannot be a file's name") == len(names)


def test_a_user_study_draws_what_can_be_drawn(log: Path, tmp_path: Path, caplog) -> None:
    unknown = rewritten(log, tmp_path / "forged.mcap", target="nowhere")
    data = bytearray(log.read_bytes())
    with EpisodeReader(log) as reader:
        data[reader.summary.chunk_indexes[-1].chunk_start_offset + 100] ^= 1
    (tmp_path / "damaged.mcap").write_bytes(data)
    settings = UserStudySettings(max_steps=3)
    study = gather([log, unknown], settings)
    assert [figure.file for figure in figures(study, tmp_path, settings)] == ["type_1/bca.png"]
    assert "type_1/nowhere is not drawn: " in caplog.text
    study.logs["type_1/bca"] = [tmp_path / "damaged.mcap"]
    assert figures(study, tmp_path, settings) == []
    assert "type_1/bca is not drawn: " in caplog.text
