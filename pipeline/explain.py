"""Explanations: what Hydra, OmegaConf or the system complain about, as one sentence with the valid choices."""

from __future__ import annotations

import dataclasses
import difflib
import errno
import re

from hydra.errors import ConfigCompositionException, HydraException, MissingConfigException, OverrideParseException
from omegaconf.errors import ValidationError as OmegaConfValidationError
from pydantic import ValidationError

from pipeline.config import BUDGETS, CONFIG_DIRECTORY, RunConfig
from pipeline.jobs.engines.settings import ENGINES, LOCAL, SETTINGS
from pipeline.printing import installing
from pipeline.settings.checks import sentence
from pipeline.settings.quoting import advice
from pipeline.stages import available_stages, settings_of
from pipeline.store.atomic_files import is_no_room
from pipeline.store.errors import PipelineError
from pipeline.task import PARTS, TASK

ARCH_TASK = "arch_task"
_CHOSEN = ("stage", "budget", "engine", "experiment")  # by name
_LONGEST_PATH = 200  # characters of a path that are shown
_PERMISSION = "change its permissions, or choose another folder by runs_dir=PATH"
_WRONG_KIND = "a file lies where a folder is needed, or a folder where a file is: move it away"
_ADVICE = {
    errno.EACCES: _PERMISSION,
    errno.EPERM: _PERMISSION,
    errno.EROFS: _PERMISSION,
    errno.ENOTDIR: _WRONG_KIND,
    errno.EISDIR: _WRONG_KIND,
    errno.EEXIST: _WRONG_KIND,
    errno.ENOENT: "it is missing: check the path, or run the stage that writes it again",
    errno.ENAMETOOLONG: "choose a shorter name or runs_dir",
    errno.ELOOP: "its symbolic links lead in a circle: mend them",
    errno.EMFILE: "raise the limit of open files (ulimit -n), or run fewer jobs beside each other",
    errno.ENFILE: "close other programs, or run fewer jobs beside each other",
}

LONGEST_QUOTE = 400  # characters of what a library says, which may quote a whole value


def one_line(error: BaseException, overrides: list[str]) -> str:
    """Words an error for the user.

    Args:
        overrides: the command line, to know which stage was meant.

    Returns:
        One line without a traceback: what came, what was expected.
    """
    if isinstance(error, PipelineError):
        return _flat(str(error))
    if isinstance(error, ValidationError):
        return _flat(sentence(error))
    if is_number_as_choice(error):
        return _number_chosen(overrides)
    from_system = system_error(error)
    if from_system is not None:
        return _flat(_system_sentence(from_system))
    if isinstance(error, MissingConfigException) and error.missing_cfg_file:
        return _missing_choice(str(error.missing_cfg_file))
    if isinstance(error, OverrideParseException):
        override, quoted = _first_line(repr(error.override)), _first_line(advice(error.override))
        text = f"; a text with such signs in quotes: {quoted}" if "=" in error.override else ""
        return f"cannot read {override}: write key=value, and quote lists for the shell: 'key=[a,b]'{text}"
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


def system_error(error: BaseException | None) -> OSError | None:
    """Finds what the operating system refused.

    Returns:
        The exception itself or the first of its causes that is an OSError; None when there is none.
    """
    while error is not None:
        if isinstance(error, OSError) and not isinstance(error, HydraException):  # Hydra's own for what it misses
            return error
        error = error.__cause__
    return None


def _system_sentence(error: OSError) -> str:
    place = str(error.filename or "")
    if len(place) > _LONGEST_PATH:
        place = f"{place[:_LONGEST_PATH]}…"
    place = f" {place}" if place else ""
    if is_no_room(error):
        where = f" while writing{place}" if place else ""
        return f"no room left{where}: free some space and run the same command again; finished items are kept"
    if error.errno is None:  # of a library, which says what was wrong
        return _first_line(str(error))
    advice = _ADVICE.get(error.errno, "mend that and run the same command again")
    return f"the system refused{place} ({(error.strerror or 'unknown reason').lower()}): {advice}"


def _missing_choice(config: str) -> str:
    group, _, choice = config.rpartition("/")
    folder = CONFIG_DIRECTORY / group
    if group == "stage":
        valid = list(available_stages())
    elif group == "budget":
        valid = list(BUDGETS)
    elif group == "engine":
        valid = list(ENGINES)
    else:
        valid = sorted(p.stem for p in folder.glob("*.yaml")) if folder.is_dir() else []
    name = group.rsplit("/", 1)[-1] or "configuration"
    if group == "hydra/launcher":
        if choice == "ray":
            how = installing("make ray")
            return f"Ray's launcher is not installed: run `{how}`, or choose basic, joblib or submitit_local"
        valid = ["basic", "joblib", "ray", "submitit_local", "submitit_slurm"]
    listing = f": choose one of {', '.join(valid)}" if valid else ""
    return f"unknown {name} {choice!r}{listing}"


def is_number_as_choice(error: BaseException) -> bool:
    """Whether Hydra was given a number where a name is to be chosen, ``stage=5``, of which it raises a ValueError."""
    return isinstance(error, ValueError) and str(error).startswith("Config group override must be")


def _number_chosen(overrides: list[str]) -> str:
    for override in overrides:
        group, _, choice = override.lstrip("+~").partition("=")
        if group in (*_CHOSEN, TASK) and not re.search(r"[A-Za-z_]{2}", choice):
            return _only_by_key() if group == TASK else _missing_choice(f"{group}/{choice}")
    return "a stage, a budget, an engine or an experiment is chosen by its name: see --help"


def _only_by_key() -> str:
    names = ", ".join(f"{TASK}.{name}=…" for name in PARTS)
    return f"{TASK} has several settings: give {names} one by one"


def _unknown_key(key: str, overrides: list[str]) -> str:
    stage = next((o.split("=", 1)[1] for o in overrides if o.startswith("stage=")), "")
    settings = settings_of(stage) if stage in available_stages() else None
    owner, _, last = key.rpartition(".")
    if key == TASK:
        return _only_by_key()
    if last and owner.rpartition(".")[2] in (TASK, ARCH_TASK):
        names = [f"{owner}.{name}" for name in PARTS]
    elif key.startswith("stage."):
        names = [f"stage.{f.name}" for f in dataclasses.fields(settings) if f.name != "name"] if settings else []
    elif key.startswith("engine."):
        engine = next((o.split("=", 1)[1] for o in overrides if o.startswith("engine=")), LOCAL)
        names = [f"engine.{f.name}" for f in dataclasses.fields(SETTINGS.get(engine, SETTINGS[LOCAL]))]
        if engine == LOCAL:
            return f"unknown setting {key!r}: engine={LOCAL} has none; engine=ray and engine=slurm have some"
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
    line = next((line.strip() for line in text.splitlines() if line.strip()), "unknown error")
    return line if len(line) <= LONGEST_QUOTE else f"{line[:LONGEST_QUOTE]} …"


def _flat(text: str) -> str:
    return " ".join(text.split())
