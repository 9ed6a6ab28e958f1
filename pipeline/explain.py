"""Explanations: what Hydra, OmegaConf or the system complain about, as one sentence with the valid choices."""

from __future__ import annotations

import dataclasses
import difflib
import re

from hydra.errors import ConfigCompositionException, MissingConfigException, OverrideParseException
from omegaconf.errors import ValidationError as OmegaConfValidationError

from pipeline.atomic import is_no_room
from pipeline.config import BUDGETS, CONFIG_DIRECTORY, STAGE_SETTINGS, RunConfig
from pipeline.errors import PipelineError
from pipeline.stages import available_stages


def one_line(error: BaseException, overrides: list[str]) -> str:
    """Words an error for the user.

    Args:
        error: what was raised.
        overrides: the command line, to know which stage was meant.

    Returns:
        One line without a traceback: what came, what was expected.
    """
    if isinstance(error, PipelineError):
        return _flat(str(error))
    if isinstance(error, OSError) and is_no_room(error):
        place = f" while writing {error.filename}" if error.filename else ""
        return f"no room left{place}: free some space and run the same command again; finished items are kept"
    if isinstance(error, MissingConfigException) and error.missing_cfg_file:
        return _missing_choice(str(error.missing_cfg_file))
    if isinstance(error, OverrideParseException):
        return f"cannot read {error.override!r}: write key=value, and quote lists for the shell: 'key=[a,b]'"
    if isinstance(error, ConfigCompositionException) and "You must specify 'stage'" in str(error):
        return f"no stage given: add stage=…, one of {', '.join(available_stages())}"
    text = str(error).removeprefix("ConfigurationError raised while resolving interpolation: ")
    cause = error.__cause__
    key = re.search(r"Could not (?:override|append|delete from config:) '?([\w./@-]+)", text) or re.search(
        r"Key '([\w.]+)' (?:is )?not in", text
    )
    if key or "is not in struct" in f"{text} {cause}" or "not in '" in f"{text} {cause}":
        return _unknown_key(_full_key(cause) or _full_key(error) or (key[1] if key else "?"), overrides)
    for refused in (cause, error):
        if isinstance(refused, OmegaConfValidationError):
            return f"{_full_key(refused) or 'a setting'}: {_first_line(str(refused))}"
    return _first_line(text)


def _missing_choice(config: str) -> str:
    group, _, choice = config.rpartition("/")
    folder = CONFIG_DIRECTORY / group
    if group == "stage":
        valid = list(available_stages())
    elif group == "budget":
        valid = list(BUDGETS)
    else:
        valid = sorted(p.stem for p in folder.glob("*.yaml")) if folder.is_dir() else []
    name = group.rsplit("/", 1)[-1] or "configuration"
    if group == "hydra/launcher":
        if choice == "ray":
            return "Ray's launcher is not installed: run `make ray`, or choose basic, joblib or submitit_local"
        valid = ["basic", "joblib", "ray", "submitit_local", "submitit_slurm"]
    listing = f": choose one of {', '.join(valid)}" if valid else ""
    return f"unknown {name} {choice!r}{listing}"


def _unknown_key(key: str, overrides: list[str]) -> str:
    if key.startswith("stage."):
        stage = next((o.split("=", 1)[1] for o in overrides if o.startswith("stage=")), "")
        settings = STAGE_SETTINGS.get(stage)
        names = [f"stage.{f.name}" for f in dataclasses.fields(settings) if f.name != "name"] if settings else []
    else:
        names = [f.name for f in dataclasses.fields(RunConfig)] + ["experiment", "stage.KEY"]
    close = difflib.get_close_matches(key, names, n=1)
    hint = f" (did you mean {close[0]}?)" if close else ""
    listing = f": choose one of {', '.join(names)}" if names else ""
    return f"unknown setting {key!r}{hint}{listing}"


def _full_key(error: BaseException | None) -> str | None:
    found = re.search(r"full_key: ([\w.\[\]]+)", str(error))
    return found[1] if found else None


def _first_line(text: str) -> str:
    return next((line.strip() for line in text.splitlines() if line.strip()), "unknown error")


def _flat(text: str) -> str:
    return " ".join(text.split())
