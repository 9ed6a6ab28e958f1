"""The task: one definition for all stages, what logs and policies say of it, and results of another task refused."""

import re
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cathsim import load_catheter
from cathsim.devices.device_file import preset_path
from pipeline.recording.record import record_episode
from pipeline.stages import baselines, enn, force, imitation
from pipeline.stages.expert import check_expert
from pipeline.stages.learning.expert_episodes import require_demonstrations, require_expert, task_of_log
from pipeline.stages.learning.settings import BaselinesSettings, EnnSettings, ForceSettings, ImitationSettings
from pipeline.stages.learning.task import LearningTask
from pipeline.stages.navigation import stage as navigation
from pipeline.stages.navigation.settings import NavigationSettings
from pipeline.stages.unseen.stage import check_unseen
from pipeline.store.errors import ConfigurationError, StageError
from pipeline.task import (
    MOTION,
    Task,
    device_files,
    differences,
    joint_observations,
    number_of_actions,
    observed,
    require_same_task,
    task_from,
    task_in_random_arches,
)
from tests.pipeline.composed import Stages, composed
from tests.pipeline.stages.small_expert import TASK, context, write_expert


@pytest.mark.parametrize(
    "words", ["budget=smoke", "budget=thesis", "task.max_steps=200 task.success_radius_mm=4 task.wire=thesis"]
)
def test_every_stage_has_the_task_of_what_it_goes_on_from(words: str) -> None:
    stages = Stages(*words.split())
    for follower in ("imitation", "force", "navigation"):
        assert stages[follower].task == stages["enn"].task, follower
    assert stages["navigation"].arch_task == stages["unseen"].task
    steered = stages["expert"].task
    assert not differences(stages["enn"].task, steered, MOTION)
    assert not differences(replace(stages["baselines"].task, actions="feeder"), steered, MOTION)
    limits = stages["user_study"]
    assert (limits.max_steps, limits.success_radius_mm) == (stages["enn"].task.max_steps, steered.success_radius_mm)


def test_tasks_of_the_budgets() -> None:
    desk, thesis = Stages("budget=desk"), Stages("budget=thesis")
    for name in ("expert", "enn", "baselines", "imitation", "force", "navigation"):
        assert desk[name].task == Task()
    assert desk["unseen"].task == thesis["unseen"].task == task_in_random_arches()
    chapter = Task(wire="thesis", start_rotation_deg=0.0)
    assert thesis["enn"].task == thesis["expert"].task == chapter
    own = replace(chapter, actions="tip_motors", image_size_px=128, max_steps=2000)  # reinforcement learning's
    assert thesis["baselines"].task == own


def test_one_stage_may_have_a_task_of_its_own() -> None:
    stage = composed("stage=enn", "stage.task.max_steps=20", "task.image_size_px=96").stage
    assert (stage.task.max_steps, stage.task.image_size_px) == (20, 96)
    with pytest.raises(ConfigurationError, match=r"unknown setting 'stage\.task\.speed'"):
        composed("stage=enn", "+stage.task.speed=1")


def test_arguments_are_in_metres_and_radians() -> None:
    arguments = Task(wire_length_mm=312.0).arguments()
    assert arguments.pop("wire").length == pytest.approx(0.312)
    assert arguments == {
        "actions": "feeder", "pace": "usual", "image_size": 80, "max_steps": 300, "success_radius": 0.008,
        "success": "lumen", "start_jitter": 0.001, "start_rotation": pytest.approx(3.141592653589793, abs=0),
        "entry": "descending",
    }  # fmt: skip
    assert Task().arguments("type_1")["success"] == "straight"  # of the thesis's phantoms
    assert Task(success="lumen").arguments("type_1")["success"] == "lumen"
    assert Task(entry="0.01, -0.02, 0.03").rules()["entry"] == (0.01, -0.02, 0.03)


@pytest.mark.parametrize(
    "values", [{"wire_length_mm": -1}, {"max_steps": 2.5}, {"success_radius_mm": float("nan")}, {"image_size_px": 1}]
)
def test_impossible_values_are_refused(values: dict[str, Any]) -> None:
    with pytest.raises(ConfigurationError, match=f"task.{next(iter(values))} must"):
        Task(**values)


def test_unknown_actions_and_wires_are_refused_by_name() -> None:
    with pytest.raises(ConfigurationError, match=r"task\.actions has no 'magnets'"):
        Task(actions="magnets")
    for check in (check_expert, check_unseen, enn.check_enn, imitation.check_imitation, force.check_force):
        name = check.__name__.removeprefix("check_")
        settings = composed(f"stage={name}").stage
        with pytest.raises(ConfigurationError, match="unknown wire 'rope': choose from default"):
            check(replace(settings, task=Task(wire="rope")))
    settings = composed("stage=unseen", "stage.task.actions=tip_motors").stage
    with pytest.raises(ConfigurationError, match="stage unseen steers the feeder, got"):
        check_unseen(settings)


@pytest.mark.parametrize("pictures", [True, False])
def test_a_log_says_what_its_task_was(tmp_path: Path, pictures: bool) -> None:
    task = Task(
        wire="thesis", wire_length_mm=300.0, actions="tip_motors", image_size_px=48, max_steps=2,
        success_radius_mm=3.3, start_jitter_mm=0.7, start_rotation_deg=33.0,
    )  # fmt: skip
    learnt = LearningTask("type_1", "lcca", task)
    environment = learnt.environment("tip")
    record_episode(
        environment, lambda *_: environment.action_space.sample() * 0, tmp_path / "one.mcap", seed=0, operator="test",
        pictures=pictures,
    )  # fmt: skip
    told = task_of_log(tmp_path / "one.mcap")
    assert (told.phantom, told.target) == ("type_1", "lcca")
    assert not differences(told.task, task)
    assert differences(told.task, replace(task, wire_length_mm=290.0)) == ["wire_length_mm"]
    assert not differences(Task(wire="thesis", wire_length_mm=313.0), Task(wire="thesis", wire_length_mm=315.0))


def test_every_difference_is_named_in_one_sentence() -> None:
    found = Task(wire="thesis", max_steps=2000)
    told = "asked for wire=default, max_steps=300, but the expert policy .* with wire=thesis, max_steps=2000"
    with pytest.raises(StageError, match=f"^stage navigation was {told}"):
        require_same_task("navigation", Task(), found, "the expert policy of type_1/bca", "enn")
    require_same_task("navigation", Task(), replace(found, wire="default"), "the policy", "enn", MOTION)
    assert task_from(asdict(found)) == found
    assert task_from(None) is task_from({"wire": "thesis", "speed": 1}) is None


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run whose stage enn and whose sampling expert had a task of their own."""
    folder = tmp_path_factory.mktemp("run")
    write_expert(folder / "enn", episodes=1)
    write_expert(folder, episodes=1)
    (folder / "expert" / "type_1").mkdir(parents=True)
    (folder / TASK.name / "I+V+M" / "seed0" / "expert").rename(folder / "expert" / "type_1" / "bca")
    return folder


CONSUMERS = {
    "imitation": (imitation, ImitationSettings(phantoms=["type_1"], targets=["bca"], episodes=[1])),
    "force": (force, ForceSettings(targets=["bca"], samples=[10])),
    "navigation": (navigation, NavigationSettings(phantoms=["type_1"], targets=["bca"], episodes=[1], arches=0)),
}
OTHERS = {"wire": "thesis", "actions": "tip_motors", "image_size_px": 96, "max_steps": 7}
FURTHER = {"success_radius_mm": 4.0, "start_jitter_mm": 1.0, "start_rotation_deg": 0.0, "wire_length_mm": 400.0}


@pytest.mark.parametrize("stage", CONSUMERS)
def test_experts_of_another_task_are_refused(run: Path, stage: str) -> None:
    module, settings = CONSUMERS[stage]
    given = context(run, stage, reads=("expert", "enn", "unseen", "splineformer"))
    module.plan(replace(settings, task=TASK.task), given)
    for name, value in (OTHERS | FURTHER if stage == "imitation" else OTHERS).items():
        asked = replace(TASK.task, **{name: value})
        with pytest.raises(StageError, match=f"stage {stage} was asked for {name}=.*, but the expert policy of type_1"):
            module.plan(replace(settings, task=asked), given)


def test_episodes_of_another_task_are_refused_where_the_policy_says_nothing(run: Path, tmp_path: Path) -> None:
    from enn.policy import Policy

    folder = write_expert(tmp_path / "enn", episodes=1)
    policy = Policy.load(folder / "policy.pt")
    policy.metadata = {}
    policy.save(folder / "policy.pt")
    require_expert("force", TASK, folder)
    with pytest.raises(StageError, match="but the expert's first episode of type_1/bca was made by stage enn with m"):
        require_expert("force", replace(TASK, task=replace(TASK.task, max_steps=5)), folder)


def test_a_teacher_of_another_task_is_refused(run: Path) -> None:
    place = write_expert(run / "other", episodes=0, task=replace(TASK, task=Task(max_steps=5)))
    teacher = run / "unseen" / "roadmap" / "seed0" / "policy.pt"
    teacher.parent.mkdir(parents=True, exist_ok=True)
    (place / "policy.pt").replace(teacher)
    settings = replace(CONSUMERS["navigation"][1], task=TASK.task, arches=1)
    given = context(run, "navigation", reads=("expert", "enn", "unseen", "splineformer"))
    told = r"navigation was asked for wire_length_mm=400\.0, but the teacher in random arches .* wire_length_mm=0\.0:"
    with pytest.raises(StageError, match=told):
        navigation.plan(settings, given)
    assert navigation.plan(replace(settings, arch_task=Task(max_steps=6)), given)


def test_demonstrations_of_another_wire_are_refused(run: Path) -> None:
    logs = sorted((run / "expert").rglob("*.mcap"))
    anywhere = replace(TASK.task, max_steps=2000, start_rotation_deg=0.0, image_size_px=128)
    require_demonstrations("baselines", replace(TASK, task=anywhere), logs)
    settings = BaselinesSettings(phantoms=["type_1"], targets=["bca"], task=anywhere)
    given = context(run, "baselines", reads=("expert",))
    assert len(baselines.path_followers(settings, given)) == 1
    other = replace(settings, task=replace(anywhere, wire="thesis"))
    sentence = r"was asked for wire=thesis, but the episode .*000\.mcap was made by stage expert with wire=default"
    with pytest.raises(StageError, match=f"stage baselines {sentence}"):
        baselines.path_followers(other, given)
    with pytest.raises(StageError, match=f"stage baselines {sentence}"):
        baselines.run_baselines(replace(other, path_follower=False), given)
    trained = EnnSettings(phantoms=["type_1"], targets=["bca"], task=other.task)
    with pytest.raises(StageError, match=f"stage enn {sentence}"):
        enn.run_enn(trained, context(run, "enn_again", reads=("expert",)))


@pytest.mark.parametrize("name", ["expert", "enn", "force"])
def test_a_catheter_is_a_setting_of_the_stages_that_steer(name: str) -> None:
    bare = composed(f"stage={name}").stage
    assert bare.task.catheter is None
    short = composed(f"stage={name}", "stage.task.catheter=simmons2", "stage.task.torsion=rigid").stage
    assert short == composed(f"stage={name}", "task.catheter=simmons2", "task.torsion=rigid").stage
    assert short.task == replace(bare.task, catheter="simmons2", torsion="rigid")
    assert number_of_actions(short.task) == 4
    arguments = short.task.arguments()
    assert (arguments["catheter"], arguments["torsion"]) == (load_catheter("simmons2"), "rigid")
    assert "catheter" not in bare.task.arguments()


def test_catheters_that_cannot_be_are_refused_in_one_sentence(tmp_path: Path) -> None:
    for name, check in (("expert", check_expert), ("enn", enn.check_enn)):
        with pytest.raises(ConfigurationError, match="unknown catheter 'rope'"):
            check(composed(f"stage={name}", "task.catheter=rope").stage)
    with pytest.raises(ConfigurationError, match=r"torsion has no 'soft': choose from elastic, rigid"):
        composed("stage=enn", "task.torsion=soft")
    with pytest.raises(ConfigurationError, match=r"task\.actions=tip_motors bends the tip of a wire alone"):
        composed("stage=baselines", "budget=thesis", "task.catheter=simmons2")
    with pytest.raises(ConfigurationError, match=r"images and the true mask: give stage\.image=false"):
        composed("stage=unseen", "budget=smoke", "stage.task.catheter=jb2")
    with pytest.raises(ConfigurationError, match="stage navigation steers a wire without a catheter"):
        navigation.check_navigation(composed("stage=navigation", "task.catheter=jb2").stage)
    thick = tmp_path / "thick.yaml"
    text = preset_path("catheter", "straight").read_text()
    thick.write_text(re.sub(r"inner_diameter(\w*): [\d.e-]+", r"inner_diameter\1: 0.5", text))
    with pytest.raises(ConfigurationError, match=r"does not pass a catheter with a lumen of 0\.50 mm"):
        check_expert(composed("stage=expert", f"task.catheter={thick}").stage)


def test_a_log_says_which_catheter_its_task_had(tmp_path: Path) -> None:
    own = tmp_path / "own.yaml"
    own.write_text(re.sub(r"friction: \S+", "friction: 0.0731", preset_path("catheter", "straight").read_text()))
    for index, task in enumerate((Task(catheter="simmons2", torsion="rigid"), Task(catheter=str(own)))):
        log, learnt = tmp_path / f"{index}.mcap", LearningTask("type_1", "lcca", replace(task, max_steps=2))
        environment = learnt.environment("tip")
        record_episode(environment, lambda *_: np.zeros(4), log, seed=0, operator="test", pictures=False)
        assert not differences(task_of_log(log, learnt.task).task, learnt.task)
        assert differences(task_of_log(log, learnt.task).task, replace(learnt.task, catheter=None)) == ["catheter"]
    no_preset = r"a catheter that is no preset .*: give task\.catheter=… the file that it was recorded with"
    with pytest.raises(StageError, match=no_preset):
        task_of_log(tmp_path / "1.mcap")
    for asked in (None, "straight", "vertebral"):
        with pytest.raises(StageError, match=no_preset):
            require_demonstrations("enn", LearningTask("type_1", "lcca", Task(catheter=asked)), [tmp_path / "1.mcap"])
    require_demonstrations("enn", LearningTask("type_1", "lcca", Task(catheter=str(own))), [tmp_path / "1.mcap"])
    assert not differences(Task(catheter="simmons2"), Task(catheter="simmons2_5f"))
    assert differences(Task(catheter="simmons2"), Task(catheter="simmons2", torsion="rigid")) == ["torsion"]
    with pytest.raises(StageError, match=r"asked for catheter=None, but the episode .* with catheter=simmons2"):
        require_demonstrations("enn", LearningTask("type_1", "lcca", Task(torsion="rigid")), [tmp_path / "0.mcap"])


def test_a_catheter_alone_is_steered_with_two_actions(tmp_path: Path) -> None:
    task = composed("stage=enn", "task.catheter=simmons2", "task.wire=none").stage.task
    assert (task.wire, task.device_names, task.two_devices) == ("none", "simmons2 alone", False)
    check_expert(composed("stage=expert", "task.catheter=simmons2", "task.wire=none").stage)
    learnt = LearningTask("type_1", "lcca", replace(task, max_steps=2))
    environment = learnt.environment(("joints", "feeder"))
    assert environment.action_space.shape == (number_of_actions(task),) == (2,)
    assert environment.observation_space["joints"].shape == (joint_observations(task),)
    log = tmp_path / "alone.mcap"
    record_episode(environment, lambda *_: np.ones(2), log, seed=0, operator="test", pictures=False)
    assert not differences(task_of_log(log).task, learnt.task)
    assert differences(task_of_log(log).task, replace(learnt.task, wire="default")) == ["wire"]


def test_no_device_at_all_is_refused() -> None:
    with pytest.raises(ConfigurationError, match=r"task\.wire=none leaves no device: name a catheter or a wire"):
        composed("stage=expert", "task.wire=none")
    with pytest.raises(ConfigurationError, match=r"unseen steers a wire, got task\.wire=none: name a wire"):
        composed("stage=unseen", "stage.task.catheter=jb2", "stage.task.wire=none")
    with pytest.raises(ConfigurationError, match=r"unknown wire 'rope': choose from .*, none"):
        check_expert(composed("stage=expert", "task.wire=rope").stage)


def test_a_catheters_file_is_part_of_the_results(tmp_path: Path) -> None:
    file = tmp_path / "own.yaml"
    file.write_text(preset_path("catheter", "jb2").read_text())
    before = device_files(Task(catheter=str(file)))
    file.write_text(file.read_text() + "\n# another\n")
    assert set(before) == {"catheter"}
    assert device_files(Task(catheter=str(file))) != before
    assert device_files(Task(catheter="jb2")) == device_files(Task()) == {}


def test_who_sees_joints_of_two_devices_sees_their_feeders() -> None:
    pair = Task(catheter="vertebral")
    assert observed(pair, ("joints", "image")) == ("joints", "image", "feeder")
    assert observed(pair, ("image", "mask")) == ("image", "mask")
    assert observed(Task(), ("joints", "image")) == ("joints", "image")
    environment = LearningTask("type_1", "bca", pair).environment(("joints", "feeder"))
    assert environment.observation_space["joints"].shape == (joint_observations(pair),)
