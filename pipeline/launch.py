"""Launching: from a command line through Hydra to one stage or a sweep, and every foreseeable failure as one sentence.

The task function lives here and not in ``__main__`` because sweep launchers pickle it by its import path.
"""

from __future__ import annotations

import contextlib
import difflib
import logging
import os
import re
import shutil
import sys
from pathlib import Path

from hydra import compose, initialize_config_dir
from hydra import main as hydra_main
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException, MissingConfigException, OverrideParseException
from hydra.types import RunMode
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException
from omegaconf.errors import ValidationError as OmegaConfValidationError
from pydantic import ValidationError

from pipeline.config import BUDGETS, CHOICES, CONFIG_DIRECTORY, choices, register_schemas, run_config, settings_beside
from pipeline.execution import execute
from pipeline.jobs.engines.settings import LOCAL
from pipeline.printing import installing, say, written
from pipeline.settings.kinds import sentence
from pipeline.settings.quoting import advice, with_quoted_paths
from pipeline.stages import available_stages, load_stage
from pipeline.store.errors import PipelineError, system_error, system_sentence
from pipeline.store.interruption import (
    EXIT_INTERRUPTED,
    INTERRUPTED,
    interrupted,
    let_ctrl_c_interrupt,
    let_sigterm_exit,
)
from pipeline.store.run_folder import LOCK
from pipeline.store.variants import variant_of
from pipeline.task import PARTS, TASK

_NUMBER = "Config group override must be"  # so begins the ValueError of a number as a choice, ``stage=5``
_KEY = re.compile(r"Could not (?:override|append|delete from config:) '?([\w./@-]+)|Key '([\w.]+)' (?:is )?not in")
_ALIKE = 0.75  # of a setting that is meant, by its last word
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
    full = [match[1] for one in (cause, error) if (match := re.search(r"full_key: ([\w.\[\]]+)", str(one)))]
    if full and "is not a subclass of" in f"{text} {cause}":  # a value instead of a group of settings
        names = settings_beside(f"{full[0]}.", {})
        return f"{full[0]} has several settings: give {', '.join(f'{name}=…' for name in names)} one by one"
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
    ends = {name.rpartition(".")[2]: name for name in reversed(names)}
    if close := difflib.get_close_matches(key.rpartition(".")[2], ends, n=1, cutoff=_ALIKE):
        return f"unknown setting {key!r}: did you mean {ends[close[0]]}? (--cfg job shows all)"
    return f"unknown setting {key!r}" + (f": choose one of {', '.join(names)}" if names else "")


def _first_line(text: str) -> str:
    line = next((line.strip() for line in text.splitlines() if line.strip()), "unknown error")
    return line if len(line) <= _LONGEST else f"{line[:_LONGEST]} …"


EXIT_FAILED = 1
EXIT_USAGE = 2

_LOGGER = logging.getLogger(__name__)

_USAGE = """\
{command} stage=STAGE [budget=BUDGET] [name=RUN] [seed=N] [force=true] [stage.KEY=VALUE ...]

Runs one stage; its results go to runs/RUN/STAGE/. A stage whose results are up to date ends at once.

stages
{stages}
budgets: {budgets} (default desk)
experiments: {experiments} (experiment=NAME sets several values at once)

options
  name=RUN          run folder below runs_dir; default: the budget's name
  seed=N            seed of every random draw; default 0; the results of others lie in runs/RUN/STAGE@seed=N/
  engine=local      where jobs run: local, ray (a Ray cluster) or slurm; results are the same
  force=true        run although the results are up to date
  stage.KEY=VALUE   a setting of the stage, e.g. 'stage.phantoms=[type_1,bovine]'; --cfg job shows all of them
  -m, --multirun    sweep: 'seed=0,1,2' runs three jobs, each in runs/RUN/STAGE@seed=N/;
                    hydra/launcher=joblib, submitit_local or ray runs them beside each other
  --cfg job         print the configuration and stop; with --resolve, its references resolved
  --hydra-help      Hydra's own options
"""


class _Stop(BaseException):
    """Carries an error past Hydra, which would print the overrides first; Hydra lets only non-Exceptions through."""

    def __init__(self, error: Exception) -> None:
        super().__init__(str(error))
        self.error = error


def task(composed: DictConfig) -> None:
    """Runs the stage of one composed configuration; Hydra and its launchers call it."""
    hydra = HydraConfig.get()
    in_sweep = hydra.mode == RunMode.MULTIRUN
    overrides = list(hydra.overrides.task)
    if not in_sweep:
        let_ctrl_c_interrupt()
    try:
        execute(run_config(composed), overrides=overrides, in_sweep=in_sweep)
    except (PipelineError, OSError, ValidationError) as error:
        _LOGGER.debug("where it failed", exc_info=True)  # shown with hydra.verbose=true
        if not in_sweep:
            _remove_record(Path(hydra.runtime.output_dir))
            raise _Stop(error) from error
        _LOGGER.error("%s failed: %s", variant_of(overrides) or composed.stage.name, one_line(error, overrides))
        raise


def _remove_record(folder: Path) -> None:
    """Removes what Hydra wrote, ``RUN/.hydra/STAGE``, where the run was refused and no stage folder has a lock."""
    record, run = folder.parents[:2]
    places = (*run.glob(folder.name), *run.glob(f"{folder.name}@*"))
    if not any((place / LOCK).is_file() for place in places):
        shutil.rmtree(folder, ignore_errors=True)
        with contextlib.suppress(OSError):  # not empty
            record.rmdir()
            run.rmdir()


def main(arguments: list[str]) -> int:
    """Runs the command line: 0 done or up to date, 1 failed, 2 wrong settings, 130 after Ctrl-C, 143 after SIGTERM."""
    if not arguments or "--help" in arguments or "-h" in arguments:
        say(usage())
        return 0 if arguments else EXIT_USAGE
    # Learning libraries start as many threads as there are cores; more than one made them slower beside other work.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    os.environ["HYDRA_FULL_ERROR"] = "1"  # Hydra then raises, and the sentence below is the only one
    logging.raiseExceptions = False  # a full disk must not add the log file's traceback to the one sentence
    let_sigterm_exit()
    arguments = with_quoted_paths(arguments)
    sys.argv = [sys.argv[0], *arguments]
    if "-m" in arguments or "--multirun" in arguments:
        let_ctrl_c_interrupt()  # the jobs run elsewhere, so the launcher must get the chance to stop them
    try:
        register_schemas(_chosen_stages(arguments))
        hydra_main(version_base="1.3", config_path=str(CONFIG_DIRECTORY), config_name="config")(task)()
    except KeyboardInterrupt:
        return _say(INTERRUPTED, EXIT_INTERRUPTED)
    except (_Stop, Exception) as stop:
        error = stop.error if isinstance(stop, _Stop) else stop
        if (code := interrupted()) and not isinstance(error, PipelineError):
            _LOGGER.debug("what came after the signal", exc_info=True)  # shown with hydra.verbose=true
            return _say(INTERRUPTED, code)
        if not is_foreseen(error):
            raise
        is_usage = isinstance(error, PipelineError) or system_error(error) is None
        return _say(one_line(error, arguments), EXIT_USAGE if is_usage else EXIT_FAILED)
    return 0


def refusal(arguments: list[str]) -> str:
    """Why a run with this command line would be refused; "" where its settings are right."""
    arguments = with_quoted_paths(arguments)
    register_schemas(_chosen_stages(arguments))
    try:
        with initialize_config_dir(str(CONFIG_DIRECTORY), version_base="1.3"):
            config = run_config(compose("config", overrides=arguments))
        if config.phantom.file is None:  # else only reading it shows what its anatomy has
            load_stage(config.stage.name).check(config.stage)
    except Exception as error:
        if not is_foreseen(error):
            raise
        return one_line(error, arguments)
    return ""


def _chosen_stages(arguments: list[str]) -> list[str]:
    """The stages that the arguments name, or all where they may name them by a pattern."""
    chosen = " ".join(word for word in arguments if re.match(r"[+~]*stage\b[^.]*=", word))
    names = set(re.findall(r"\w+", chosen))
    return [name for name in available_stages() if name in names or "(" in chosen]


def usage() -> str:
    """Words the help, with the stages, budgets and experiments that exist."""
    stages = "\n".join(f"  {name:<12} {_summary(name)}" for name in available_stages())
    experiments = ", ".join(choices("experiment")) or "none"
    return _USAGE.format(
        command=written("stages"), stages=stages, budgets=", ".join(BUDGETS), experiments=experiments
    )  # fmt: skip


def _summary(stage: str) -> str:
    """The comment that opens the stage's configuration: reading it imports nothing."""
    text = (CONFIG_DIRECTORY / "stage" / f"{stage}.yaml").read_text(encoding="utf-8")
    match = re.match(r"#\s*(.+)", text)
    return match[1] if match else ""


def _say(sentence: str, code: int) -> int:
    say(sentence, error=True)
    return code
