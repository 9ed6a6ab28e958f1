"""Explanations: what Hydra and OmegaConf complain about, as one sentence with the valid choices."""

from __future__ import annotations

import difflib
import re

from hydra.errors import HydraException, MissingConfigException, OverrideParseException
from omegaconf.errors import OmegaConfBaseException
from omegaconf.errors import ValidationError as OmegaConfValidationError
from pydantic import ValidationError

from pipeline.config import CHOICES, choices, settings_beside
from pipeline.jobs.engines.settings import LOCAL
from pipeline.printing import installing
from pipeline.settings.checks import sentence
from pipeline.settings.quoting import advice
from pipeline.stages import available_stages
from pipeline.store.errors import PipelineError
from pipeline.store.system_errors import system_error, system_sentence
from pipeline.task import PARTS, TASK

_NUMBER = "Config group override must be"  # so begins the ValueError of a number as a choice, ``stage=5``
_KEY = re.compile(r"Could not (?:override|append|delete from config:) '?([\w./@-]+)|Key '([\w.]+)' (?:is )?not in")
_LONGEST = 400  # characters of what a library says, which may quote a whole value


def is_foreseen(error: BaseException) -> bool:
    """Whether `one_line` says what the user can do; anything else is a mistake of the program."""
    kinds = (PipelineError, ValidationError, HydraException, OmegaConfBaseException)
    return isinstance(error, kinds) or system_error(error) is not None or str(error).startswith(_NUMBER)


def one_line(error: BaseException, overrides: list[str]) -> str:
    """Words an error for the user in one line: what came, what was expected; `overrides` name the stage."""
    refused, cause = system_error(error), error.__cause__
    text = str(error).removeprefix("ConfigurationError raised while resolving interpolation: ")
    if isinstance(error, PipelineError | ValidationError):
        return " ".join((sentence(error) if isinstance(error, ValidationError) else str(error)).split())
    if refused is not None:
        return " ".join(system_sentence(refused).split())
    if isinstance(error, MissingConfigException) and error.missing_cfg_file:
        return _unknown_choice(str(error.missing_cfg_file))
    if text.startswith(_NUMBER):
        words = (word.lstrip("+~").partition("=")[::2] for word in overrides)
        numbers = (f"{group}/{value}" for group, value in words
                   if group in (*CHOICES, "experiment", TASK) and not re.search(r"[A-Za-z_]{2}", value))  # fmt: skip
        return next(map(_unknown_choice, numbers), "a stage or a budget is chosen by its name: see --help")
    if isinstance(error, OverrideParseException):
        override, quoted = _first_line(repr(error.override)), _first_line(advice(error.override))
        further = f"; a text with such signs in quotes: {quoted}" if "=" in error.override else ""
        return f"cannot read {override}: write key=value, and quote lists for the shell: 'key=[a,b]'{further}"
    if "You must specify 'stage'" in text:
        return f"no stage given: add stage=…, one of {', '.join(available_stages())}"
    full = [found[1] for one in (cause, error) if (found := re.search(r"full_key: ([\w.\[\]]+)", str(one)))]
    key = _KEY.search(text)
    if key or "is not in struct" in f"{text} {cause}" or "not in '" in f"{text} {cause}":
        return _unknown_key((full or [(key and (key[1] or key[2])) or "?"])[0], overrides)
    wrong = [one for one in (cause, error) if isinstance(one, OmegaConfValidationError)]
    return f"{(full or ['a setting'])[0]}: {_first_line(str(wrong[0]))}" if wrong else _first_line(text)


def _unknown_choice(config: str) -> str:
    group, _, choice = config.rpartition("/")
    if group == TASK:
        return f"{TASK} has several settings: give {', '.join(f'{TASK}.{name}=…' for name in PARTS)} one by one"
    if config == "hydra/launcher/ray":
        how = installing("make ray")
        return f"Ray's launcher is not installed: run `{how}`, or choose basic, joblib or submitit_local"
    valid = ", ".join(choices(group))
    return f"unknown {group.rpartition('/')[2] or 'configuration'} {choice!r}" + (valid and f": choose one of {valid}")


def _unknown_key(key: str, overrides: list[str]) -> str:
    if key == TASK:
        return _unknown_choice(f"{TASK}/")
    names = settings_beside(key, dict(word.split("=", 1) for word in reversed(overrides) if "=" in word))
    if key.startswith("engine.") and not names:
        return f"unknown setting {key!r}: engine={LOCAL} has none; engine=ray and engine=slurm have some"
    close = "".join(f" (did you mean {name}?)" for name in difflib.get_close_matches(key, names, n=1))
    return f"unknown setting {key!r}{close}" + (f": choose one of {', '.join(names)}" if names else "")


def _first_line(text: str) -> str:
    line = next((line.strip() for line in text.splitlines() if line.strip()), "unknown error")
    return line if len(line) <= _LONGEST else f"{line[:_LONGEST]} …"
