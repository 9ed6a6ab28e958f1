"""The command line of a chain: ``python -m pipeline.chain all -- budget=desk name=desk``."""

from __future__ import annotations

from pipeline.chain.running import run
from pipeline.chain.steps import after_inputs, concerns, steps_of
from pipeline.printing import say, written
from pipeline.stages import available_stages

_USAGE = """\
{command} [--seeds N] [--beside N] all|[--inputs] STAGE ... -- [OVERRIDE ...]

Runs all stages, or some, one after the other, and says how far it is.

  --inputs     the stages after those that they read
  --seeds N    stages whose figures depend on the seed run with seeds 0 to N - 1; the report shows means and intervals
  --beside N   up to N stages that do not need each other run at the same time and share cores, memory and GPUs

Overrides go to every stage, e.g. budget=desk name=desk engine=ray, stage.KEY=VALUE to those that have the setting, e.g.
stage.device=cuda, and stage@NAME.KEY=VALUE to one. It ends with the first stage that fails; the same command goes on
from there.
"""
_EXIT_USAGE = 2
_ALL, _INPUTS, _SEEDS, _BESIDE = "all", "--inputs", "--seeds", "--beside"
_MOST_SEEDS = 20  # that pipeline.seeds has ranges for
_MOST_BESIDE = 64


def main(arguments: list[str]) -> int:
    """Runs the command line; gives 0, or the exit code of the stage that failed."""
    if "--help" in arguments or "-h" in arguments:
        say(_USAGE.format(command=written("chain")))
        return 0
    cut = arguments.index("--") if "--" in arguments else len(arguments)
    stages, overrides = arguments[:cut], arguments[cut + 1 :]
    try:
        seeds, beside = _taken(stages, _SEEDS, _MOST_SEEDS), _taken(stages, _BESIDE, _MOST_BESIDE)
        if seeds > 1 and any(word.startswith("seed=") for word in overrides):
            raise ValueError(f"{_SEEDS} counts from seed 0 on: leave seed=… out, or {_SEEDS}")
    except ValueError as error:
        say(str(error), error=True)
        return _EXIT_USAGE
    with_inputs = _INPUTS in stages
    stages = [name for name in stages if name != _INPUTS]
    stages = list(available_stages()) if stages == [_ALL] else stages
    unknown = [name for name in stages if name not in available_stages()]
    if unknown or not stages:
        problem = f"unknown stage {unknown[0]!r}" if unknown else "no stage is named"
        if unknown and (setting := next((word for word in stages if "=" in word), None)):
            say(f"{setting} is no stage: settings stand behind --, after the stages", error=True)
            return _EXIT_USAGE
        say(f"{problem}: choose from {_ALL}, {', '.join(available_stages())}", error=True)
        return _EXIT_USAGE
    if with_inputs:
        stages = after_inputs(stages)
    foreign = [word for word in overrides if not any(concerns(word, stage) for stage in stages)]
    if foreign:
        say(f"no stage of the chain has the setting {foreign[0]!r}: name its stage, or leave it out", error=True)
        return _EXIT_USAGE
    return run(steps_of(stages, seeds), overrides, beside)


def _taken(words: list[str], option: str, largest: int) -> int:
    """Takes an option and its number out of the words before the overrides; 1 where it is not there."""
    if option not in words:
        return 1
    place = words.index(option)
    number = words[place + 1] if place + 1 < len(words) else ""
    del words[place : place + 2]
    if not number.isdecimal() or not 1 <= int(number) <= largest:
        raise ValueError(f"{option} needs a whole number from 1 to {largest}, got {number or 'nothing'!r}")
    return int(number)
