"""A default is written once: YAML holds only what differs from it."""

from __future__ import annotations

from typing import Any

import pytest
from omegaconf import OmegaConf

from pipeline.config import CONFIG_DIRECTORY, RunConfig
from pipeline.stages import available_stages, settings_of
from pipeline.task import Task


def read(path: str) -> dict[str, Any]:
    """A YAML file of the configuration, as it is written."""
    return OmegaConf.to_container(OmegaConf.load(CONFIG_DIRECTORY / path))  # type: ignore[return-value]


def repeated(values: dict[str, Any], default: dict[str, Any]) -> list[str]:
    """Settings that are given the value that they have anyway."""
    return [
        key
        for key, value in values.items()
        if (repeated(value, default[key]) if isinstance(value, dict) else value == default[key])
    ]


@pytest.mark.parametrize("stage", [*available_stages(), "task"])
def test_sizes_hold_only_what_differs_from_the_defaults(stage: str) -> None:
    smoke, thesis, check = (read(f"sizes/{name}.yaml") for name in ("smoke", "thesis", "thesis-check"))
    default: Any = OmegaConf.structured(Task if stage == "task" else settings_of(stage))
    assert repeated(smoke.get(stage, {}), default) == []
    usual = OmegaConf.merge(default, {"task": thesis["task"]} if "task" in default else {})
    assert repeated(thesis.get(stage, {}), usual) == []  # type: ignore[arg-type]
    assert repeated(check.get(stage, {}), OmegaConf.merge(usual, thesis.get(stage, {}))) == []  # type: ignore[arg-type]


def test_files_of_the_run_and_of_its_stages_repeat_no_default() -> None:
    files = {stage: read(f"stage/{stage}.yaml") for stage in available_stages()}
    for stage, values in files.items():
        del values["defaults"]
        assert repeated(values, OmegaConf.structured(settings_of(stage))) == [], stage  # type: ignore[arg-type]
    run = {key: value for key, value in read("config.yaml").items() if key not in ("defaults", "hydra")}
    assert repeated(run, OmegaConf.structured(RunConfig)) == []  # type: ignore[arg-type]


def test_sizes_belong_to_stages() -> None:
    for file in (CONFIG_DIRECTORY / "sizes").glob("*.yaml"):
        assert set(read(f"sizes/{file.name}")) <= {*available_stages(), "task"}, file.name
