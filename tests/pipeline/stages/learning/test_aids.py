"""Notes of how the measured rows were made: worded from what the jobs really have."""

from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

from enn.imitation.behaviour_cloning import cloning_settings
from enn.imitation.dagger import DaggerSettings
from enn.reinforcement.training.settings import DESK_SAC, THESIS_SAC
from pipeline.recording.trials import Origin
from pipeline.stages.imitation import ImitationJob, of_imitation
from pipeline.stages.learning.aids import note as note_of_jobs
from pipeline.stages.learning.aids import note_of, of_training
from pipeline.stages.learning.task import LearningTask
from pipeline.stages.learning.training import PolicyTrainingJob
from pipeline.stages.report import mixed_seeds, notes_of
from pipeline.stages.unseen.settings import UnseenSettings
from pipeline.store.manifest import Identity, Manifest
from pipeline.tables import Results
from pipeline.task import Task

DESK = PolicyTrainingJob(
    folder=Path("desk"),
    task=LearningTask("type_1", "bca", path_penalty=40.0),
    settings=replace(DESK_SAC, demonstrations_in_replay=0.25),
    keys=("image", "mask", "joints"),
    evaluation_episodes=30,
    drawn_episodes=5,
    run=Path("run"),
    origin=Origin("enn", "I+V+M", 0, "desk"),
    encoder=Path("encoder.pt"),
    demonstrations=(Path("000.mcap"), Path("001.mcap"), Path("002.mcap")),
)
THESIS = replace(
    DESK,
    task=LearningTask("type_1", "bca", Task(wire="thesis", start_rotation_deg=0.0), reward="distance"),
    settings=THESIS_SAC,
    encoder=None,
    demonstrations=(),
)


def test_tasks_of_a_row_that_differ_are_told_apart() -> None:
    without = replace(DESK, task=replace(DESK.task, phantom="type_2"), demonstrations=())
    for jobs in ([DESK, without], [without, DESK]):
        note = note_of_jobs(jobs, of_training)
        for words in ("I+V+M in type_1/bca: ", "I+V+M in type_2/bca: ", "states of demonstrations", "states of own"):
            assert words in note


def test_a_desk_training_names_every_aid() -> None:
    note = note_of_jobs([DESK], of_training)
    for aid in (
        "geodesic, less 40 a metre",
        f"{100 * DESK_SAC.start_state_buffer_share:.0f} % of the resets along the path, to states of demonstrations",
        "25 % of each batch",
        "an encoder fitted beforehand",
        f"actions held for {DESK_SAC.action_repeat} steps",
        "2 actions",
        "images of 80 px",
        "turned by up to 180 degrees",
        f"{DESK_SAC.decisions:,} decisions",
    ):
        assert aid in note, aid
    assert "physics" not in note
    other = note_of_jobs([replace(DESK, task=replace(DESK.task, accuracy="fast"))], of_training)
    assert "fast physics, chosen and tested in accurate" in other


def test_what_a_training_does_not_have_is_not_named() -> None:
    assert of_training(THESIS) == ["2 actions", "images of 80 px", f"{THESIS_SAC.decisions:,} decisions"]
    alone = note_of_jobs([replace(DESK, demonstrations=(), keys=("joints",))], of_training)
    for words in ("planner", "demonstrations", "px"):
        assert words not in alone


def test_rows_that_were_made_alike_are_named_together() -> None:
    other = replace(DESK, origin=Origin("enn", "V", 0, "desk"))
    other_observation = replace(DESK, origin=Origin("enn", "I", 0, "desk"), keys=("joints",))
    note = note_of_jobs([DESK, other, other_observation], of_training)
    assert note.count("shaped reward") == 1
    assert note.endswith("I+V+M, V: images of 80 px.")
    assert note_of({"a": ["one"], "b": ["two"]}).endswith(" a: one. b: two.")


def test_imitation_says_whose_weight_matches_features() -> None:
    cloning = cloning_settings("thesis", ("image",), feature_matching=0.1)
    job = ImitationJob(Path("s"), Origin("imitation", "dagger", 0, "thesis"), cloning, LearningTask("type_1", "bca"),
                       Path("e"), 10, 30, 5, rounds=DaggerSettings(rounds=3))  # fmt: skip
    note = note_of_jobs([job], of_imitation)
    for words in ("from 10 episodes", "features matched with weight 0.1", "3 rounds of 10 own episodes"):
        assert words in note
    assert "features" not in note_of_jobs([replace(job, settings=replace(cloning, feature_matching=0.0))], of_imitation)


def test_the_report_gathers_notes_of_a_sweep_once(tmp_path: Path) -> None:
    for name, text in (("enn", "one"), ("enn@seed=1", "one"), ("enn@stage.decisions=9", "two")):
        (tmp_path / name).mkdir()
        Results({}, notes={"ablation": text}).write(tmp_path / name)
    (tmp_path / "phantoms").mkdir()
    found = notes_of(tmp_path, ["enn", "enn@seed=1", "enn@stage.decisions=9", "phantoms"])
    assert found == {"ablation": ["one", "two"]}


def test_the_report_says_where_seeds_had_other_settings(tmp_path: Path) -> None:
    written = {"identity": Identity("", {}, 1), "outputs": {}, "wall_time_s": 1.0, "finished": ""}
    of_seed = partial(Manifest, "unseen", "desk", "desk", **written)
    own, other = asdict(UnseenSettings()), asdict(UnseenSettings(shipped=True, device="cuda"))
    finished = {
        "unseen": of_seed(0, own),
        "unseen@seed=1": of_seed(1, other, variant=["seed=1"]),
        "unseen@seed=1,stage.decisions=5": of_seed(1, own, variant=["seed=1", "stage.decisions=5"]),
    }
    (text,) = mixed_seeds(finished).values()
    assert text.startswith("unseen@seed=1 had other settings than unseen (anatomies, decisions, field_mm, navigator_")
    assert "device" not in text
    assert mixed_seeds({**finished, "unseen@seed=1": of_seed(1, {**own, "device": "cuda"}, variant=["seed=1"])}) == {}
