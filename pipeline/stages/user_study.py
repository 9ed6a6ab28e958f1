"""The user study: sums up what people recorded at the console, and what they answered; nothing where nobody did."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.evaluations.logs import COUNTED
from pipeline.printing import written
from pipeline.settings.kinds import Count, SuccessRadius, shown, validated
from pipeline.stages import Stage, StageContext
from pipeline.store.atomic_files import read_json, write_json
from pipeline.store.manifest import is_inside
from pipeline.store.provenance import hash_file
from pipeline.tables import Figure, Results
from pipeline.task import Task

if TYPE_CHECKING:
    from pipeline.episodes import EpisodeInfo

_MM = 1e3

_LOGGER = logging.getLogger(__name__)


@validated()
class UserStudySettings:
    """Settings of the sum of what people recorded at the console."""

    name: str = "user_study"
    max_steps: Count = Task.max_steps  # procedures with another limit, or that end at a force limit, are not counted
    success_radius_mm: SuccessRadius = Task.success_radius_mm  # nor those with another radius


@dataclass
class Study:
    """What was found in the recordings."""

    counted: list[Path] = field(default_factory=list)  # logs of finished procedures under the study's settings
    logs: dict[str, list[Path]] = field(default_factory=dict)  # task ("type_1/bca") to all its finished logs
    broken_off: int = 0  # procedures that were left before they ended
    other_settings: int = 0  # finished ones with another limit or radius, or that end at a force limit
    unreadable: int = 0  # logs that are damaged or not a human's
    answers: list[dict[str, Any]] = field(default_factory=list)  # the questionnaires, oldest first


def logs_of(run_path: Path) -> list[Path]:
    """The human's logs of a run."""
    from pipeline.recording.human import FOLDER, SUFFIX

    return sorted((run_path / FOLDER).rglob(f"*{SUFFIX}"))


def gather(logs: list[Path], settings: UserStudySettings) -> Study:
    """Reads the logs; those that are no human's or cannot be used are left out with a warning."""
    from pipeline.episodes import EpisodeReadError
    from pipeline.recording.human import ENDS_AT_FORCE_LIMIT

    study, answers = Study(), []
    for path in logs:
        try:
            info, finished, answered = _read(path)
            radius_mm = _MM * float(info.configuration.get("success_radius", 0.0))
        except (EpisodeReadError, KeyError, TypeError, ValueError, OverflowError) as error:
            reason = error if isinstance(error, EpisodeReadError) else f"{path} says what cannot be used ({error})"
            _LOGGER.warning("left out: %s", reason)
            study.unreadable += 1
            continue
        if answered is not None:
            answers.append((info.start_time_ns, answered))
        if not finished:
            study.broken_off += 1
            continue
        task = f"{info.phantom}/{info.target}"
        study.logs.setdefault(task, []).append(path)
        limit = info.configuration.get("max_steps")
        ends_early = info.configuration.get(ENDS_AT_FORCE_LIMIT, False)
        if not ends_early and limit == settings.max_steps and abs(radius_mm - settings.success_radius_mm) < 1e-6:
            study.counted.append(path)
        else:
            study.other_settings += 1
    study.answers = [answered for _, answered in sorted(answers, key=lambda entry: entry[0])]
    return study


def _read(path: Path) -> tuple[EpisodeInfo, bool, dict[str, Any] | None]:
    """What a log holds: its information, whether the procedure was finished, and the questionnaire."""
    from cathsim.console.questionnaire import check_answers
    from cathsim.console.recorder import OPERATOR, QUESTIONNAIRE_SUFFIX, TOTALS
    from cathsim.metrics import EpisodeMetrics
    from cathsim.metrics.episodes import ENDING
    from pipeline.episodes import EpisodeReader, EpisodeReadError

    with EpisodeReader(path) as log:
        info, outcome = log.info, log.outcome
    beside = path.with_name(path.stem + QUESTIONNAIRE_SUFFIX)
    answered = read_json(beside)["answers"] if beside.is_file() else None
    if info.operator != OPERATOR:
        raise EpisodeReadError(f"{path} is an episode of {info.operator}")
    for name, value in outcome.metrics.items():
        unknown = value is None and name in ENDING
        if name not in ("target", "branch") and not unknown and not isinstance(value, int | float):
            raise ValueError(f"the metric {shown(name)} is {shown(value)}")
    metrics = {name: value for name, value in outcome.metrics.items() if name not in TOTALS}
    if metrics:
        EpisodeMetrics(**metrics)  # a log with other metrics is not one of the console
    for name in (info.phantom, info.target):
        if not is_inside(name) or "/" in name:
            raise ValueError(f"{shown(name)} cannot be a file's name")
    finished = outcome.status == "finished" and bool(metrics)
    return info, finished, None if answered is None else check_answers(answered)


def tables(study: Study) -> dict[str, Any]:
    """The measured cells that no log of an episode gives; none for what nobody did."""
    from cathsim.console.questionnaire import mean_scores

    measured: dict[str, Any] = {}
    scores = mean_scores(study.answers)
    if scores:
        measured["user_study"] = scores
    left_out = {"broken_off": study.broken_off, "other_settings": study.other_settings, "unreadable": study.unreadable}
    if any(left_out.values()):
        measured["human_left_out"] = {name: {"episodes": count} for name, count in left_out.items()}
    return measured


def run_user_study(settings: UserStudySettings, context: StageContext) -> Results:
    logs = logs_of(context.run_path)
    if not logs:
        _LOGGER.info("no human episodes yet: `%s --name %s` records them", written("console"), context.run_path.name)
    study = gather(logs, settings)
    counted = [log.relative_to(context.run_path).as_posix() for log in study.counted]
    write_json(context.path / COUNTED, counted)
    return Results(tables(study), figures(study, context.path, settings))


def figures(study: Study, folder: Path, settings: UserStudySettings) -> list[Figure]:
    """Draws the tip's paths and the forces of every task."""
    from cathsim import PHANTOMS, load_phantom
    from pipeline.episodes import EpisodeReadError
    from pipeline.plots.episodes import draw_task

    drawn = []
    for task, logs in study.logs.items():
        name, target = task.split("/")
        if name not in PHANTOMS:
            continue  # one of the user's own: its vessel is not known here
        file = f"{name}/{target}.png"
        try:
            draw_task(load_phantom(name), target, logs, folder / file, radius_mm=settings.success_radius_mm)
        except (EpisodeReadError, ValueError) as error:
            _LOGGER.warning("%s is not drawn: %s", task, error)
            continue
        caption = f"{len(logs)} procedures at the console; the target's sphere of success is dashed."
        drawn.append(
            Figure(f"Human, {name}, {target.upper()}: path of the tip and contact force", caption, file, "Human")
        )
    return drawn


def recordings(run_path: Path) -> dict[str, str]:
    """Hashes of the human's logs of a run, and of what was answered."""
    from pipeline.recording.human import FOLDER

    files = sorted(path for path in (run_path / FOLDER).rglob("*") if path.suffix in (".mcap", ".json"))
    return {f"human/{path.relative_to(run_path).as_posix()}": hash_file(path) for path in files}


STAGE = Stage(settings=UserStudySettings, run=run_user_study, seeded=False, further_inputs=recordings)
