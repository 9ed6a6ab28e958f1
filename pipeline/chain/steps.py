"""The steps of a chain: stages with their seeds, what each must wait for, and the overrides that concern it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

from pipeline.settings.quoting import unquoted
from pipeline.stages import available_stages, load_stage, settings_of


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


def waits_for(steps: Sequence[Step], place: int) -> list[int]:
    """Places of the earlier steps that must be done before a step may start: those of stages that it reads or uses."""
    stage = load_stage(steps[place].stage)
    return [
        k for k, earlier in enumerate(steps[:place]) if stage.gathers or earlier.stage in (*stage.reads, *stage.uses)
    ]


def steps_to_the_end(steps: Sequence[Step]) -> list[int]:
    """How many steps the longest chain has that begins with each: the step, one that waits for it, and so on."""
    count = [1] * len(steps)
    for place in reversed(range(len(steps))):
        for earlier in waits_for(steps, place):
            count[earlier] = max(count[earlier], count[place] + 1)
    return count


def chosen_value(overrides: Sequence[str], key: str, default: str) -> str:
    """The value of a setting among overrides: the last one counts."""
    found = (word.partition("=")[2] for word in reversed(overrides) if word.startswith(f"{key}="))
    return next(map(unquoted, found), default)


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
