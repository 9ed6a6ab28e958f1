"""Estimates of a chain of stages on several machines: hours, critical path, memory, from the times of its jobs.

Times of jobs come from the manifests of a finished run, each job's own processor time and memory, or, for stages that
did not run, from the table `jobs` of the budget (`conf/budget`), which says where its figures come from, or from its
`minutes` on two cores, as if more machines were no help. A schedule is made of them as by the chain: one stage after
the other, the jobs of a stage beside each other, the longest ones first.
"""

from __future__ import annotations

import heapq
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

from pipeline.config import CONFIG_DIRECTORY
from pipeline.jobs.costs import AFTER, OK, OWN_PROCESS
from pipeline.stages import load_stage
from pipeline.store.manifest import Manifest, read_manifest

MACHINES = (1, 8, 64)
CORES = 16  # of a machine
_S_AN_HOUR, _MIN_AN_HOUR, _MB_A_GB = 3600.0, 60.0, 1e3


@dataclass(frozen=True)
class TimedJob:
    """A job and what it takes on one core."""

    key: str
    hours: float
    memory_gb: float
    after: tuple[str, ...] = ()  # keys of jobs that must be done before


@dataclass(frozen=True)
class TimedStage:
    """A stage: its own process on the driver's machine, and its jobs."""

    name: str
    own_hours: float
    jobs: tuple[TimedJob, ...]
    origin: str  # of the times: a run, the budget's table, its minutes

    @property
    def hours(self) -> float:
        """Processor hours of all of it."""
        return self.own_hours + sum(job.hours for job in self.jobs)

    def makespan(self, cores: int) -> float:
        """Hours until the stage is done on so many cores: each takes the longest job that may start."""
        left = {job.key: set(job.after) for job in self.jobs}
        ready = sorted((job for job in self.jobs if not job.after), key=lambda job: -job.hours)
        running: list[tuple[float, str]] = []
        by_key = {job.key: job for job in self.jobs}
        now = 0.0
        while ready or running:
            while ready and len(running) < cores:
                job = ready.pop(0)
                heapq.heappush(running, (now + job.hours, job.key))
            now, done = heapq.heappop(running)
            for key, waits_for in left.items():
                if done in waits_for:
                    waits_for.discard(done)
                    if not waits_for:
                        ready.append(by_key[key])
            ready.sort(key=lambda job: -job.hours)
        return self.own_hours + now

    def memory_gb(self, cores: int) -> float:
        """The most that the jobs of one machine may need at the same time."""
        return sum(sorted((job.memory_gb for job in self.jobs), reverse=True)[:cores])


def timed_stages(names: Sequence[str], budget: str, run: Path | None = None) -> tuple[list[TimedStage], list[str]]:
    """What is known of some stages.

    Args:
        run: a finished run's folder.

    Returns:
        The stages whose times are known, in order, and the names of the others.
    """
    table, minutes = _entry(budget, "jobs"), _entry(budget, "minutes")
    found, unknown = [], []
    for name in names:
        manifest = None if run is None else read_manifest(run / name)
        if manifest is not None and manifest.budget == budget and not _is_check(manifest):
            found.append(_of_run(manifest))
        elif name in table:
            found.append(_of_table(name, table[name]))
        elif name in minutes:
            found.append(TimedStage(name, float(minutes[name]) / _MIN_AN_HOUR, (), "minutes"))
        else:
            unknown.append(name)
    return found, unknown


def _of_run(manifest: Manifest) -> TimedStage:
    jobs = []
    own = 0.0
    for key, cost in manifest.jobs.items():
        hours = float(cost["cpu_s"]) / _S_AN_HOUR
        if key == OWN_PROCESS:
            own = hours
        elif cost["outcome"] == OK:
            jobs.append(TimedJob(key, hours, float(cost["memory_mb"]) / _MB_A_GB, tuple(cost.get(AFTER, ()))))
    keys = {job.key for job in jobs}
    known = [replace(job, after=tuple(key for key in job.after if key in keys)) for job in jobs]
    return TimedStage(manifest.stage, own, tuple(known), f"run {manifest.run}")


def _is_check(manifest: Manifest) -> bool:
    """Whether an experiment changed the budget's sizes."""
    return any(word.startswith("experiment=") for word in manifest.overrides)


def _entry(budget: str, key: str) -> dict[str, Any]:
    sizes: Any = OmegaConf.load(CONFIG_DIRECTORY / "budget" / f"{budget}.yaml")
    entry: Any = OmegaConf.to_container(sizes.get(key) or OmegaConf.create({}))
    return dict(entry)


def _of_table(name: str, entry: Mapping[str, Any]) -> TimedStage:
    """A stage from its entry.

    Args:
        entry: `own` hours, and for each kind of job [count, hours, GB], with the kinds that it waits for behind.
    """
    jobs: list[TimedJob] = []
    keys: dict[str, list[str]] = {}
    for kind, values in entry.items():
        if kind == "own":
            continue
        count, hours, memory_gb, *before = values
        keys[kind] = [f"{kind}/{number}" for number in range(int(count))]
        after = tuple(key for other in before for key in keys[str(other)])
        jobs += [TimedJob(key, float(hours), float(memory_gb), after) for key in keys[kind]]
    return TimedStage(name, float(entry.get("own", 0.0)), tuple(jobs), "table")


def critical_path(stages: Sequence[TimedStage]) -> tuple[float, list[str]]:
    """The longest chain of stages that wait for each other, were every stage to start when its inputs are there.

    Returns:
        Hours with as many cores as there are jobs, and the names of its stages.
    """
    unlimited = {stage.name: stage.makespan(max(len(stage.jobs), 1)) for stage in stages}
    best: dict[str, tuple[float, list[str]]] = {}
    for stage in stages:
        before = [best[name] for name in load_stage(stage.name).reads if name in best]
        hours, path = max(before, default=(0.0, []), key=lambda found: found[0])
        best[stage.name] = hours + unlimited[stage.name], [*path, stage.name]
    return max(best.values(), default=(0.0, []), key=lambda found: found[0])


def report(names: Sequence[str], budget: str, run: Path, cores: int = CORES) -> str:
    """Words the estimate as a table.

    Args:
        names: of the stages.
        run: folder of a run whose finished stages give their times.
        cores: of a machine.

    Returns:
        Markdown: a row a stage, then all of it and the critical path.
    """
    stages, unknown = timed_stages(names, budget, run)
    if not stages:
        return f"nothing is known of the jobs of budget={budget}: run it once, and give its name=…"
    header = ["stage", "from", "jobs", "CPU time", "longest job", *(f"{count} machines" for count in MACHINES)]
    header[5] = "1 machine"
    rows = [header, ["---"] * len(header)]
    for stage in stages:
        longest = max((job.hours for job in stage.jobs), default=0.0)
        spans = [_hours(stage.makespan(count * cores)) for count in MACHINES]
        rows.append([stage.name, stage.origin, str(len(stage.jobs)), _hours(stage.hours), _hours(longest), *spans])
    spans = [_hours(sum(stage.makespan(count * cores) for stage in stages)) for count in MACHINES]
    rows.append(["all", "", str(sum(len(stage.jobs) for stage in stages)),
                 _hours(sum(stage.hours for stage in stages)), "", *spans])  # fmt: skip
    memory, largest = max((stage.memory_gb(cores), stage.name) for stage in stages)
    path_hours, path = critical_path(stages)
    text = "\n".join(f"| {' | '.join(row)} |" for row in rows)
    text += (
        f"\n\n{cores} cores a machine, one job a core, no GPU. Critical path {_hours(path_hours)} ({', '.join(path)}): "
        f"more machines are no faster. Memory of a machine: up to {memory:.1f} GB ({largest})."
    )
    return text + (f" Not known, so left out: {', '.join(unknown)}." if unknown else "")


def _hours(hours: float) -> str:
    if hours < 1:
        return f"{60 * hours:.1f} min"
    return f"{hours:.1f} h" if hours < 10 else f"{hours:,.0f} h"
