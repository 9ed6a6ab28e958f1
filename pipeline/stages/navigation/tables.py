"""Summary of the navigation: the thesis's table, every set of trials, success by expert trials, and figures."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from cathsim.metrics.failure_modes import MODES as FAILURES
from pipeline.episodes import EpisodeReader
from pipeline.episodes.errors import EpisodeReadError
from pipeline.plots.imitation import draw_failures, draw_success
from pipeline.recording.human import FOLDER as HUMAN
from pipeline.recording.human import SUFFIX
from pipeline.recording.trials import MODES
from pipeline.stages import StageContext
from pipeline.stages.learning.evaluation import EVALUATION
from pipeline.stages.learning.expert_episodes import expert_folder
from pipeline.stages.navigation.film import FAILURE, FILMS, SUCCESS
from pipeline.stages.navigation.perception import PERCEPTION
from pipeline.stages.navigation.settings import NavigationSettings
from pipeline.tables import Figure

GROUP = "Autonomous navigation"
ROW, DAGGER, ARCHES, PIXELS = "splineformer", "splineformer_dagger", "splineformer_arches", "behaviour_cloning"
LABELS = {name: name.replace("_", " ") for name in ("success", *FAILURES)}


def tables(settings: NavigationSettings, context: StageContext, outcomes: dict[str, Any]) -> dict[str, Any]:
    """The thesis's table, every set of trials with failure modes, success by expert trials, and the perception.

    Args:
        context: where other stages' episodes lie.

    Returns:
        Table to row to column to cell.
    """
    from cathsim.metrics.episodes import wilson_interval

    rows = navigator_rows(outcomes)
    main: dict[str, dict[str, Any]] = {}
    for operator, row, logs in (
        ("human", "expert_teleoperation", (context.run_path / HUMAN).rglob(f"*{SUFFIX}")),
        ("sampling_expert", "sampling_expert", context.inputs["expert"].rglob("evaluation/*.mcap")),
        ("policy", "enn_expert", _expert_logs(settings, context)),
    ):
        cells = _of_logs(logs, settings, operator)
        if cells:
            setup = "manual" if operator == "human" else "autonomous, knows the state"
            main[row] = {"setup": setup, "explainable": "–", **cells}
    first = settings.phantoms[0]
    if settings.pixel_cloning:
        tried = (context.path / PIXELS / first).glob(f"*/{EVALUATION}/{MODES[0]}/*.mcap")
        main[PIXELS] = {"setup": "autonomous", "explainable": "no", **_of_logs(tried, settings, "policy")}
    for row in rows:
        of_first = [one for one in outcomes[row]["tests"] if one["test"] == first]
        main[row] = {"setup": "autonomous", "explainable": "yes"}
        for one in of_first:
            main[row][f"{one['target']}_success_pct"] = one["success_pct"]
            main[row][f"{one['target']}_time_s"] = one["time_s"]
            main[row]["n"] = one["n"]
    trials: dict[str, dict[str, Any]] = {}
    for row in rows:
        for one in outcomes[row]["tests"]:
            cells = trials.setdefault(f"{row}/{one['test']}", {})
            target, n = one["target"], one["n"]
            low, high = wilson_interval(round(one["success_pct"] / 100 * n), n)
            cells[f"{target}_success_pct"] = one["success_pct"]
            cells[f"{target}_interval_pct"] = f"{100 * low:.0f} to {100 * high:.0f}"
            cells[f"{target}_depth_mm"] = one["depth_mm"]
            cells[f"{target}_time_s"] = one["time_s"]
            cells[f"{target}_force_max_n"] = one["force_max_n"]
            cells |= {f"{target}_{mode}": one[mode] for mode in (*FAILURES, "out_of_view")}
            cells["n"] = n
    curve = {
        f"{count} trials": {
            f"{one['target']}_success_pct": one["success_pct"]
            for one in outcomes[row_of(settings, count)]["tests"]
            if one["test"] == first
        }
        | {"n": settings.trials}
        for count in settings.episodes
    }
    perception = {name: {"value": value} for name, value in outcomes[PERCEPTION].items()}
    return {
        "navigation": main,
        "navigation_trials": trials,
        "navigation_episodes": curve,
        "navigation_perception": perception,
    }


def navigator_rows(outcomes: dict[str, Any]) -> list[str]:
    """Names of the navigators among the jobs: the thesis's first, then with more trials, then with a teacher."""
    rows = [key for key in outcomes if key == ROW or key.startswith(f"{ROW}_")]
    return sorted(rows, key=lambda row: (row == ARCHES, row == DAGGER, row != ROW))


def row_of(settings: NavigationSettings, count: int) -> str:
    """The row of the navigator that was cloned from so many expert trials a target."""
    return ROW if count == settings.episodes[0] else f"{ROW}_{count}"


def _expert_logs(settings: NavigationSettings, context: StageContext) -> list[Path]:
    """The expert's evaluation: nothing was learnt from these episodes, and their starts are those of the trials."""
    first = settings.phantoms[0]
    tasks = [f"{first}/{target}" for target in settings.targets]
    folders = [expert_folder(context.inputs["enn"], task, settings.expert) for task in tasks]
    return [log for folder in folders for log in sorted((folder / EVALUATION / MODES[0]).glob("*.mcap"))]


def _of_logs(logs: Iterable[Path], settings: NavigationSettings, operator: str) -> dict[str, Any]:
    """Success and mean time of an operator's finished episodes in the first phantom, by target."""
    steps: dict[str, list[tuple[bool, int, float]]] = {}
    for log in sorted(logs):
        try:
            with EpisodeReader(log) as episode:
                info, outcome = episode.info, episode.outcome
        except EpisodeReadError:
            continue
        if info.operator != operator or info.phantom != settings.phantoms[0] or outcome.success is None:
            continue
        steps.setdefault(info.target, []).append((bool(outcome.success), outcome.steps, info.control_dt))
    cells: dict[str, Any] = {}
    for target in settings.targets:
        if target in steps:
            times = [count * dt for success, count, dt in steps[target] if success]
            cells[f"{target}_success_pct"] = 100.0 * len(times) / len(steps[target])
            cells[f"{target}_time_s"] = sum(times) / len(times) if times else None
    return cells


def figures(settings: NavigationSettings, folder: Path, outcomes: dict[str, Any]) -> list[Figure]:
    """Draws the curve and the failure modes, and lists the films."""
    first = settings.phantoms[0]
    curves: dict[str, list[tuple[int, float, int]]] = {}
    for count in settings.episodes:
        for one in outcomes[row_of(settings, count)]["tests"]:
            if one["test"] == first:
                curves.setdefault(f"{first}/{one['target']}", []).append((count, one["success_pct"], one["n"]))
    beside: dict[str, list[tuple[str, float]]] = {}
    taught = [row for row in (DAGGER, ARCHES) if row in outcomes]
    for row in taught:
        for one in outcomes[row]["tests"]:
            if one["test"] == first:
                beside.setdefault(f"{first}/{one['target']}", []).append((row, one["success_pct"]))
    draw_success(curves, beside, folder / "curve.png")
    bars = {
        f"{row}, {one['test']}, {one['target']}": {
            "success": round(one["success_pct"] / 100 * one["n"]),
            **{mode: one[mode] for mode in FAILURES},
        }
        for row in navigator_rows(outcomes)
        for one in outcomes[row]["tests"]
    }
    draw_failures(bars, LABELS, FAILURES, folder / "failures.png")
    shown = [
        Figure(
            "Navigation by number of expert trials",
            f"Navigators cloned from expert trials of {first}, with 95 % intervals, and those taught further.",
            "curve.png",
            GROUP,
        ),
        Figure(
            "How trials ended",
            "Failed trials by where the tip was for most of their last third: in a branch off the way, past the "
            "take-off towards the heart, or anywhere else.",
            "failures.png",
            GROUP,
        ),
    ]
    for kind in (SUCCESS, FAILURE):
        trial = outcomes.get(FILMS, {}).get(kind)
        if trial is not None:
            words = f"{trial['navigator']}, {trial['test']}, {trial['target'].upper()}, trial {trial['trial']}"
            shown.append(
                Figure(
                    f"A {kind}",
                    f"{words}. Left the cameras' images; right attention (orange), predicted spline (red), its tip "
                    "(green) and the target's mark (blue).",
                    f"{FILMS}/{kind}.gif",
                    GROUP,
                )
            )
    return shown
