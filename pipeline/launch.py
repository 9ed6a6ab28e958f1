"""Launching: from a command line through Hydra to one stage or a sweep, and every foreseeable failure as one sentence.

The task function lives here and not in ``__main__`` because sweep launchers pickle it by its import path.
"""

from __future__ import annotations

import logging
import os
import re
import signal
import sys
from types import FrameType

from hydra import main as hydra_main
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig
from pydantic import ValidationError

from pipeline.config import BUDGETS, CONFIG_DIRECTORY, register_schemas, run_config
from pipeline.execution import execute
from pipeline.explain import is_foreseen, one_line
from pipeline.printing import say, written
from pipeline.settings.quoting import with_quoted_paths
from pipeline.stages import available_stages
from pipeline.store.errors import PipelineError
from pipeline.store.interruption import interrupted, let_ctrl_c_interrupt
from pipeline.store.system_errors import system_error
from pipeline.variants import variant_of

EXIT_FAILED = 1
EXIT_USAGE = 2
EXIT_INTERRUPTED = 130
EXIT_TERMINATED = 143

_INTERRUPTED = "interrupted: finished items are kept; the same command goes on from there"

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
    """Runs the stage of one composed configuration; Hydra and its launchers call it.

    Raises:
        PipelineError: in a sweep, so that the launcher counts the job as failed and goes on with the others.
    """
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
            raise _Stop(error) from error
        _LOGGER.error("%s failed: %s", variant_of(overrides) or composed.stage.name, one_line(error, overrides))
        raise


def main(arguments: list[str]) -> int:
    """Runs the command line.

    Returns:
        The exit code: 0 done or up to date, 1 failed, 2 wrong settings, 130 after Ctrl-C, 143 after SIGTERM.
    """
    if not arguments or "--help" in arguments or "-h" in arguments:
        say(usage())
        return 0 if arguments else EXIT_USAGE
    # Learning libraries start as many threads as there are cores; more than one made them slower beside other work.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    os.environ["HYDRA_FULL_ERROR"] = "1"  # Hydra then raises, and the sentence below is the only one
    logging.raiseExceptions = False  # a full disk must not add the log file's traceback to the one sentence
    signal.signal(signal.SIGTERM, _terminate)
    arguments = with_quoted_paths(arguments)
    sys.argv = [sys.argv[0], *arguments]
    if "-m" in arguments or "--multirun" in arguments:
        let_ctrl_c_interrupt()  # the jobs run elsewhere, so the launcher must get the chance to stop them
    try:
        register_schemas(_chosen_stages(arguments))
        hydra_main(version_base="1.3", config_path=str(CONFIG_DIRECTORY), config_name="config")(task)()
    except KeyboardInterrupt:
        return _say(_INTERRUPTED, EXIT_INTERRUPTED)
    except (_Stop, Exception) as stop:
        error = stop.error if isinstance(stop, _Stop) else stop
        if interrupted() and not isinstance(error, PipelineError):
            _LOGGER.debug("what came after Ctrl-C", exc_info=True)  # shown with hydra.verbose=true
            return _say(_INTERRUPTED, EXIT_INTERRUPTED)
        if not is_foreseen(error):
            raise
        is_usage = isinstance(error, PipelineError) or system_error(error) is None
        return _say(one_line(error, arguments), EXIT_USAGE if is_usage else EXIT_FAILED)
    return 0


def _chosen_stages(arguments: list[str]) -> list[str]:
    """The stages that the arguments name, or all where they may name them by a pattern."""
    chosen = " ".join(word for word in arguments if re.match(r"[+~]*stage\b[^.]*=", word))
    names = set(re.findall(r"\w+", chosen))
    return [name for name in available_stages() if name in names or "(" in chosen]


def usage() -> str:
    """Words the help, with the stages, budgets and experiments that exist."""
    stages = "\n".join(f"  {name:<12} {_summary(name)}" for name in available_stages())
    experiments = sorted(p.stem for p in (CONFIG_DIRECTORY / "experiment").glob("*.yaml"))
    return _USAGE.format(
        command=written("stages"),
        stages=stages,
        budgets=", ".join(BUDGETS),
        experiments=", ".join(experiments) or "none",
    )


def _summary(stage: str) -> str:
    """The comment that opens the stage's configuration: reading it imports nothing."""
    text = (CONFIG_DIRECTORY / "stage" / f"{stage}.yaml").read_text(encoding="utf-8")
    found = re.match(r"#\s*(.+)", text)
    return found[1] if found else ""


def _say(sentence: str, code: int) -> int:
    say(sentence, error=True)
    return code


def _terminate(signum: int, frame: FrameType | None) -> None:
    # SystemExit unwinds the stack, so that temporary files go; the kernel frees the lock.
    raise SystemExit(EXIT_TERMINATED)
