"""Configurations as the command line composes them."""

import copy
import functools
from typing import Any

from hydra import compose, initialize_config_dir
from omegaconf import DictConfig

from pipeline.config import CONFIG_DIRECTORY, RunConfig, register_schemas, run_config

_registered = functools.cache(register_schemas)  # of all stages: as long as composing


def composed(*overrides: str) -> RunConfig:
    """The checked configuration of these words of a command line."""
    return copy.deepcopy(_checked(*overrides))


@functools.cache
def _checked(*overrides: str) -> RunConfig:
    return run_config(unchecked(*overrides))


class Stages(dict[str, Any]):
    """The settings of each stage with these words, composed when they are first asked for."""

    def __init__(self, *overrides: str) -> None:
        self._overrides = overrides

    def __missing__(self, name: str) -> Any:
        return composed(f"stage={name}", *self._overrides).stage


def unchecked(*overrides: str) -> DictConfig:
    """The configuration as Hydra hands it over."""
    _registered()
    with initialize_config_dir(str(CONFIG_DIRECTORY), version_base="1.3"):
        return compose("config", overrides=list(overrides))
