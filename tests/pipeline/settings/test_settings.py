"""Every setting of every stage, given what cannot be meant, is refused with one sentence before any work is done."""

import dataclasses
import re
import typing
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pydantic.dataclasses
import pytest
from annotated_types import Gt
from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from pipeline.config import CONFIG_DIRECTORY, RunConfig, anatomy_not_taken, run_config
from pipeline.launch import one_line
from pipeline.settings.kinds import sentence
from pipeline.stages import available_stages, load_stage
from pipeline.stages.expert import ExpertSettings
from pipeline.store.errors import ConfigurationError
from tests.pipeline.composed import unchecked

SETTINGS = {name: load_stage(name).settings for name in available_stages()}
NONSENSE = ("nan", "-1", "1e300", "text", "true")
# Settings in which 0 means something: none of them, a number that the recipe chooses, one process a core, no noise.
ZERO_IS_LEGAL = {
    "annotation_noise_px", "arches", "dagger_rounds", "demonstrations", "disturbed_episodes", "disturbed_images",
    "clutter", "drawn_episodes",
    "embed_limit_mb", "encoder_epochs", "epochs", "expert_episodes", "feature_matching", "field_mm",
    "film_episodes", "noise", "path_penalty", "perception_arches", "perception_epochs",
    "registration_noise_mm", "spell_chance", "split_seed", "start_jitter_mm",
    "start_rotation_deg", "test_arches", "test_images", "threads", "updates", "validation_noise_px", "wire_length_mm",
    "workers", "walls_mm", "shift_mm", "turn_deg", "stiffness_pct", "friction_pct", "breathing_mm", "phantom_seed",
    "force_penalty", "force_threshold_n", "further_trainings", "least_set_back_mm",
}  # fmt: skip
ZERO_IS_REFUSED_THERE = {("unseen", "epochs"), ("navigation", "epochs")}
# Texts that are no names: paths, which may lie anywhere, and what is filled in.
NOT_NAMES = {"mesh", "unit", "root", "image_root", "calibration", "pretrained", "root_sha256", "ct", "ct_sha256",
             "catheter", "file", "file_sha256", "pretrained_sha256", "policy", "policy_sha256",
             "navigator_sha256", "shipped_sha256", "entry", "own_entry"}  # fmt: skip
BAD_NAMES = ("../elsewhere", "/etc", "a/b", "..", "a b", "", "a" * 300, "a\\b")


@pytest.fixture(scope="module")
def composed() -> dict[str, DictConfig]:
    """Each stage's configuration as the command line composes it."""
    return {name: unchecked(f"stage={name}") for name in SETTINGS}


@pytest.fixture(scope="module")
def resolved(composed: dict[str, DictConfig]) -> dict[str, DictConfig]:
    """The same with what they take over from other settings filled in, for checks by the thousand."""
    filled_in = {name: config.copy() for name, config in composed.items()}
    for config in filled_in.values():
        OmegaConf.resolve(config)
    return filled_in


def given(config: DictConfig, override: str) -> RunConfig:
    """What a command line with one more override gives."""
    parsed = OverridesParser.create().parse_override(override)
    changed = config.copy()
    OmegaConf.update(changed, parsed.key_or_group, parsed.value(), merge=False)
    return run_config(changed)


def fields_of(owner: type, *kinds: Any) -> Iterator[tuple[str, bool]]:
    """Names of fields whose values are of one of the kinds, and whether they are lists."""
    hints = typing.get_type_hints(owner)
    for item in dataclasses.fields(owner):
        kind = hints[item.name]
        if dataclasses.is_dataclass(kind):
            yield from ((f"{item.name}.{name}", several) for name, several in fields_of(kind, *kinds))
        if kind in kinds or any(kind == (wanted | None) for wanted in kinds):
            yield item.name, False
        elif typing.get_origin(kind) is list and typing.get_args(kind)[0] in kinds:
            yield item.name, True


def own_fields(stage: str, *kinds: Any) -> list[tuple[str, bool]]:
    """Those of a stage; of its task, which is of one class everywhere, only for one stage."""
    fields = fields_of(SETTINGS[stage], *kinds)
    return [(name, several) for name, several in fields if stage == "navigation" or not name.startswith("task.")]


def key_of(name: str) -> str:
    """A setting as an error names it: a task is the run's, or a stage's own."""
    return f"task.{name.partition('.')[2]}" if "." in name else f"stage.{name}"


@pytest.mark.parametrize("stage", list(SETTINGS))
def test_every_number_that_cannot_be_meant_is_refused_with_one_sentence(
    stage: str, resolved: dict[str, DictConfig]
) -> None:
    config = resolved[stage]
    assert run_config(config).stage.name == stage
    numbers = {name for name, _ in fields_of(SETTINGS[stage], float)}
    for name, several in own_fields(stage, int, float):
        for value in (*NONSENSE, "0"):
            override = f"stage.{name}={f'[{value}]' if several else value}"
            if value == "0" and name.rpartition(".")[2] in ZERO_IS_LEGAL and (stage, name) not in ZERO_IS_REFUSED_THERE:
                given(config, override)
                continue
            if value == "true" and name in numbers:
                continue  # OmegaConf makes a float of it
            with pytest.raises((ConfigurationError, OmegaConfBaseException)) as refused:
                given(config, override)
            words = one_line(refused.value, [f"stage={stage}", override])
            assert "\n" not in words, words
            assert key_of(name) in words, words
            assert len(words) < 300, words


def test_a_seed_that_cannot_be_meant_is_refused(composed: dict[str, DictConfig]) -> None:
    for value in NONSENSE:
        with pytest.raises((ConfigurationError, OmegaConfBaseException)) as refused:
            given(composed["report"], f"seed={value}")
        assert one_line(refused.value, []).startswith("seed")


@pytest.mark.parametrize("stage", list(SETTINGS))
def test_no_name_leads_out_of_the_run_folder(stage: str, resolved: dict[str, DictConfig]) -> None:
    for name, several in own_fields(stage, str):
        if name.rpartition(".")[2] in NOT_NAMES:
            continue
        for value in BAD_NAMES[::3]:
            override = f"stage.{name}={[value] if several else repr(value)}"
            with pytest.raises(ConfigurationError, match=f"^{re.escape(key_of(name))}") as refused:
                given(resolved[stage], override)
            assert len(str(refused.value)) < 500


@pytest.mark.parametrize("key", ["name", "target", "modality", "phantom.name"])
def test_no_name_of_the_run_leads_out_of_its_folder(key: str, composed: dict[str, DictConfig]) -> None:
    for value in BAD_NAMES if key == "name" else BAD_NAMES[::3]:
        with pytest.raises((ConfigurationError, OmegaConfBaseException), match=rf"^{key}|^stage\.{key}"):
            given(composed["enn"], f"{key}={value!r}")


def test_a_target_may_lie_at_a_depth_of_its_branch(resolved: dict[str, DictConfig]) -> None:
    for stage, key in (("rehearsal", "targets"), ("enn", "targets"), ("unseen", "own_targets")):
        assert getattr(given(resolved[stage], f"stage.{key}=[rcca@80]").stage, key) == ["rcca@80"]
        for value in ("rcca@../x", "rcca@", "@80", "a/b@80", "rcca@80@90"):
            with pytest.raises(ConfigurationError, match=f"^stage.{key}"):
                given(resolved[stage], f"stage.{key}=['{value}']")


def test_branch_names_are_a_mapping_or_a_list(composed: dict[str, DictConfig], tmp_path: Path) -> None:
    (tmp_path / "own.stl").write_bytes(b"solid")
    config = composed["phantoms"].copy()
    OmegaConf.update(config, "phantom.file", str(tmp_path / "own.stl"))
    for names in ("5", "[]", "[../x]", "{lcca: 5}", "{lcca: a/b}", "[[a]]"):
        with pytest.raises(ConfigurationError, match=r"^phantom\.names (must be a mapping|cannot be)"):
            given(config, f"phantom.names={names}")
    assert given(config, "phantom.names={lcca: lsa}").stage.names == {"lcca": "lsa"}


@pytest.mark.parametrize("override", ["name=../../evil", "stage.name=../../evil"])
def test_a_name_that_cannot_be_a_folder_makes_none(override: str, pipeline_process) -> None:
    done = pipeline_process.run_here("stage=report", override)
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1, done.stderr
    assert not list(pipeline_process.folder.iterdir())


def test_a_stage_is_not_renamed(composed: dict[str, DictConfig]) -> None:
    with pytest.raises(ConfigurationError, match=r"stage\.name cannot be 'expert'"):
        given(composed["report"], "stage.name=expert")


def test_misspelt_keys_are_refused_in_python_too(composed: dict[str, DictConfig]) -> None:
    for key in ("phantom.nmae", "guide3d.rot", "stage.episode"):
        config = composed["expert"].copy()
        OmegaConf.update(config, key, 3, force_add=True)
        with pytest.raises(ConfigurationError, match=f"unknown setting '{key}'"):
            run_config(config)
    with pytest.raises(ConfigurationError, match=r"unknown setting 'stage\.episode'"):
        ExpertSettings(phantoms=["type_1"], targets=["bca"], episode=2)  # type: ignore[call-arg]


def test_a_package_s_settings_are_refused_with_their_class_s_name() -> None:
    @pydantic.dataclasses.dataclass
    class Fit:
        epochs: typing.Annotated[int, Gt(0)] = 1

        def __post_init__(self) -> None:
            if self.epochs == 7:
                raise ValueError("epochs must not be 7")

    for epochs, expected in ((-1, "Fit.epochs must be greater than 0, got -1"), (7, "epochs must not be 7")):
        with pytest.raises(pydantic.ValidationError) as refused:
            Fit(epochs=epochs)
        assert sentence(refused.value) == expected


@pytest.mark.parametrize(
    ("stage", "unused"),
    [("force", ["phantom.name", "phantom.entry", "target"]), ("guide3d", ["phantom.name", "phantom.entry", "target"]),
     ("phantoms", ["phantom.name", "phantom.entry"]), ("expert", []), ("report", [])],
)  # fmt: skip
def test_an_anatomy_for_a_stage_that_takes_none(stage: str, unused: list[str]) -> None:
    config = run_config(unchecked(f"stage={stage}", "phantom.name=bovine", "phantom.entry=ascending", "target=lsa"))
    assert anatomy_not_taken(config) == unused


def read(path: str) -> dict[str, Any]:
    """A YAML file of the configuration, as it is written."""
    return OmegaConf.to_container(OmegaConf.load(CONFIG_DIRECTORY / path))  # type: ignore[return-value]


def test_sizes_belong_to_stages() -> None:
    for file in (CONFIG_DIRECTORY / "sizes").glob("*.yaml"):
        assert set(read(f"sizes/{file.name}")) <= {*available_stages(), "task"}, file.name


@pytest.mark.parametrize("words", [("stage=expert", "budget=smoke"), ("stage=baselines", "budget=thesis")])
def test_a_task_of_the_command_line_is_stronger_than_the_budgets(words: tuple[str, ...]) -> None:
    given = ((), ("task.max_steps=77", "task.entry=ascending"))
    usual, changed = (run_config(unchecked(*words, *more)).stage.task for more in given)
    assert usual.max_steps in (120, 2000)
    assert changed == dataclasses.replace(usual, max_steps=77, entry="ascending")
