"""Configurations as the command line composes them."""

from __future__ import annotations

import functools

from hydra import compose, initialize_config_dir
from omegaconf import DictConfig

from pipeline.config import CONFIG_DIRECTORY, RunConfig, register_schemas, run_config

_registered = functools.cache(register_schemas)  # of all stages: as long as composing


def composed(*overrides: str) -> RunConfig:
    """The checked configuration of these words of a command line."""
    return run_config(unchecked(*overrides))


def unchecked(*overrides: str) -> DictConfig:
    """The configuration as Hydra hands it over."""
    _registered()
    with initialize_config_dir(str(CONFIG_DIRECTORY), version_base="1.3"):
        return compose("config", overrides=list(overrides))
