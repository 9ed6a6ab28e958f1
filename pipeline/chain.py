"""Stages one after the other: ``python -m pipeline.chain all -- budget=desk name=desk``.

Every stage is a process of its own, as if called by itself. Beside each stage's own progress it says how long the rest
will take, by what each stage took on two cores (``minutes`` in ``conf/budget``) and by how this machine compares.
"""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from types import FrameType
from typing import Any

from omegaconf import OmegaConf

from pipeline.config import BUDGETS, CONFIG_DIRECTORY
from pipeline.stages import available_stages, load_stage, settings_of

_USAGE = """\
python -m pipeline.chain [--estimate] [--seeds N] all|[--inputs] STAGE ... -- [OVERRIDE ...]

Runs all stages, or some, one after the other, and says how long the rest will take; --inputs: after the stages that
they read; --seeds: stages whose figures differ from seed to seed run with seeds 0 to N - 1, and the report shows their
mean and its interval; --estimate: only estimates time and memory on 1, 8 and 64 machines, from the times of jobs.
Overrides go to every stage, e.g. budget=desk name=desk engine=ray, stage.KEY=VALUE to those that have the setting, e.g.
stage.device=cuda, and stage@NAME.KEY=VALUE to one. It ends with the first stage that fails; the same command goes on
from there.
"""
_EXIT_USAGE = 2
_ALL, _INPUTS, _ESTIMATE, _SEEDS = "all", "--inputs", "--estimate", "--seeds"
_MOST_SEEDS = 20  # that pipeline.seeds has ranges for
_WORKED = 0.3  # of what a stage is known to take: less, and it was up to date or went on from an earlier run


def main(arguments: list[str]) -> int:
    """Runs the command line; gives 0, or the exit code of the stage that failed."""
    if "--help" in arguments or "-h" in arguments:
        _say(_USAGE)
        return 0
    cut = arguments.index("--") if "--" in arguments else len(arguments)
    stages, overrides = arguments[:cut], arguments[cut + 1 :]
    try:
        seeds = _taken_seeds(stages, overrides)
    except ValueError as error:
        _say(str(error), error=True)
        return _EXIT_USAGE
    with_inputs, only_estimate = _INPUTS in stages, _ESTIMATE in stages
    stages = [name for name in stages if name not in (_INPUTS, _ESTIMATE)]
    stages = list(available_stages()) if stages == [_ALL] else stages
    unknown = [name for name in stages if name not in available_stages()]
    if unknown or not stages:
        problem = f"unknown stage {unknown[0]!r}" if unknown else "no stage is named"
        _say(f"{problem}: choose from {_ALL}, {', '.join(available_stages())}", error=True)
        return _EXIT_USAGE
    if with_inputs:
        stages = after_inputs(stages)
    foreign = [word for word in overrides if not any(concerns(word, stage) for stage in stages)]
    if foreign:
        _say(f"no stage of the chain has the setting {foreign[0]!r}: name its stage, or leave it out", error=True)
        return _EXIT_USAGE
    steps = steps_of(stages, seeds)
    if only_estimate:
        return _estimate([step.stage for step in steps], overrides)
    return run(steps, overrides, known_minutes(overrides))


@dataclass(frozen=True)
class Step:
    """A stage of a chain, and the seed that it runs with; None: that of the overrides."""

    stage: str
    seed: int | None = None

    def __str__(self) -> str:
        return self.stage if self.seed is None else f"{self.stage} with seed {self.seed}"


def steps_of(stages: Sequence[str], seeds: int) -> list[Step]:
    """What a chain runs, in order: repeated stages once for each of so many seeds."""
    if seeds == 1:
        return [Step(stage) for stage in stages]
    return [Step(stage, seed or None) for stage in stages for seed in range(seeds if load_stage(stage).repeated else 1)]


def _taken_seeds(words: list[str], overrides: Sequence[str]) -> int:
    """Takes `--seeds N` out of the words before the overrides; 1 where it is not there."""
    if _SEEDS not in words:
        return 1
    place = words.index(_SEEDS)
    number = words[place + 1] if place + 1 < len(words) else ""
    del words[place : place + 2]
    if not number.isdecimal() or not 1 <= int(number) <= _MOST_SEEDS:
        raise ValueError(f"{_SEEDS} needs a whole number from 1 to {_MOST_SEEDS}, got {number or 'nothing'!r}")
    if any(word.startswith("seed=") for word in overrides):
        raise ValueError(f"{_SEEDS} counts from seed 0 on: leave seed=… out, or {_SEEDS}")
    return int(number)


def _estimate(stages: Sequence[str], overrides: Sequence[str]) -> int:
    """Prints the estimate of a chain; the exit code."""
    from pipeline.estimate import report

    budget = chosen_value(overrides, "budget", "desk")
    if budget not in BUDGETS:
        _say(f"unknown budget {budget!r}: choose one of {', '.join(BUDGETS)}", error=True)
        return _EXIT_USAGE
    run_path = Path(chosen_value(overrides, "runs_dir", "runs")) / chosen_value(overrides, "name", budget)
    _say(report(stages, budget, run_path))
    return 0


def chosen_value(overrides: Sequence[str], key: str, default: str) -> str:
    """The value of a setting among overrides: the last one counts."""
    return next((word.partition("=")[2] for word in reversed(overrides) if word.startswith(f"{key}=")), default)


def after_inputs(stages: Sequence[str]) -> list[str]:
    """The stages and all that they read, directly or not, in order."""
    wanted, todo = set[str](), list(stages)
    while todo:
        name = todo.pop()
        wanted.add(name)
        todo += load_stage(name).reads
    return [name for name in available_stages() if name in wanted]


def concerns(override: str, stage: str) -> bool:
    """Whether an override is for a stage: `stage.KEY` is for those that have the setting, `stage@NAME.KEY` for one."""
    group, _, key = override.lstrip("+~").partition("=")[0].partition(".")
    group, _, only = group.partition("@")
    if group != "stage" or not key:
        return True
    names = {item.name for item in fields(settings_of(stage))}
    return only in ("", stage) and key.partition(".")[0] in names


def known_minutes(overrides: Sequence[str]) -> dict[str, float]:
    """Wall minutes of each stage on two cores at the chosen budget, as far as they are known."""
    budget = chosen_value(overrides, "budget", "desk")
    if budget not in BUDGETS:  # the first stage says so
        return {}
    sizes: Any = OmegaConf.load(CONFIG_DIRECTORY / "budget" / f"{budget}.yaml")
    minutes = sizes.get("minutes") or {}
    return {str(name): float(value) for name, value in minutes.items()}


def run(steps: Sequence[Step], overrides: Sequence[str], known: Mapping[str, float]) -> int:
    """Runs the steps; the exit code."""
    spent: list[tuple[str, float]] = []
    with _Signals() as signals:
        for number, step in enumerate(steps):
            left = minutes_left([later.stage for later in steps[number:]], spent, known)
            rest = "" if left is None else f"; about {worded(left)} left in all"
            _say(f"== stage {number + 1} of {len(steps)}: {step}{rest}")
            began, stage = time.monotonic(), step.stage
            own = [word.replace(f"stage@{stage}.", "stage.", 1) for word in overrides if concerns(word, stage)]
            own += [] if step.seed is None else [f"seed={step.seed}"]
            code = signals.wait_for([sys.executable, "-m", "pipeline", f"stage={stage}", *own])
            if code:
                return code
            spent.append((stage, (time.monotonic() - began) / 60))
    each = {name: sum(minutes for other, minutes in spent if other == name) for name, _ in spent}
    longest = sorted(each, key=lambda name: -each[name])[:3]
    parts = ", ".join(f"{name} {worded(each[name])}" for name in longest)
    _say(f"== all {len(steps)} stages in {worded(sum(each.values()))}: most of it {parts}")
    return 0


def minutes_left(stages: Sequence[str], spent: Sequence[tuple[str, float]], known: Mapping[str, float]) -> float | None:
    """Estimates the wall time of stages that are still to run.

    Args:
        spent: stages that ran, and their minutes.
        known: minutes of stages on the machine they were measured on.

    Returns:
        Minutes; None where one of the stages is not known.
    """
    if any(name not in known for name in stages):
        return None
    worked = [(name, minutes) for name, minutes in spent if name in known and minutes > _WORKED * known[name]]
    expected = sum(known[name] for name, _ in worked)
    # short stages tell little of a machine: they count as much as they last, beside one that is as fast as known
    prior = 0.02 * sum(known.values())
    pace = (prior + sum(minutes for _, minutes in worked)) / (prior + expected)
    return pace * sum(known[name] for name in stages)


def worded(minutes: float) -> str:
    """For example ``40 s``, ``12 min`` or ``2 h 05 min``."""
    if minutes < 1:
        return f"{60 * minutes:.0f} s"
    hours, rest = divmod(round(minutes), 60)
    return f"{hours} h {rest:02d} min" if hours else f"{rest} min"


class _Signals:
    """Leaves Ctrl-C and SIGTERM to the stage that runs, and starts no other afterwards."""

    def __init__(self) -> None:
        self._received: list[int] = []
        self._stage: subprocess.Popen[bytes] | None = None
        self._former: dict[int, Any] = {}

    def __enter__(self) -> _Signals:
        for number in (signal.SIGINT, signal.SIGTERM):
            former = signal.getsignal(number)
            if former is not signal.SIG_IGN:  # as nohup and background jobs ask for; a stage inherits that, no handler
                self._former[number] = former
                signal.signal(number, self._receive)
        return self

    def __exit__(self, *unused: object) -> None:
        for number, former in self._former.items():
            signal.signal(number, former)

    def wait_for(self, command: list[str]) -> int:
        """Runs a stage; its exit code, 128 + N where signal N ended it."""
        if not self._received:
            with subprocess.Popen(command) as self._stage:
                if signal.SIGTERM in self._received:
                    self._stage.terminate()
                code = self._stage.wait()
            self._stage = None
            if code:
                return code if code > 0 else 128 - code
        return 128 + self._received[0] if self._received else 0

    def _receive(self, number: int, frame: FrameType | None) -> None:
        self._received.append(number)  # a terminal's Ctrl-C reaches the stage, too
        if number == signal.SIGTERM and self._stage is not None:
            self._stage.terminate()


def _say(text: str, *, error: bool = False) -> None:
    print(text.rstrip(), file=sys.stderr if error else sys.stdout, flush=True)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
