"""The report stage: gathers what every stage of the run left and writes the page, the tables and the metrics."""

from __future__ import annotations

import logging
from collections.abc import Collection, Mapping
from dataclasses import fields
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

from annotated_types import Ge, Le

from pipeline.evaluations.tables import OWN_TABLES
from pipeline.report.figures import ShownFigure, gather_figures
from pipeline.report.intervals import over_seeds
from pipeline.report.learning import LearningSection, learning_section
from pipeline.report.page import PAGE, render_page
from pipeline.report.tables import as_csv, as_latex, join_sweep, metrics, report_tables
from pipeline.settings.kinds import validated
from pipeline.stages import Stage, StageContext, available_stages, settings_of
from pipeline.store.atomic_files import write_json, write_text
from pipeline.store.manifest import Manifest, read_manifest
from pipeline.store.provenance import machine, present_commit, software_versions
from pipeline.tables import Table, read_notes, read_results

METRICS = "metrics.json"
TABLES_FOLDER = "tables"
LEARNING_FOLDER = "learning"
EMBEDDED_BYTES = 12_000_000  # of embedded figures: the page stays below 15 MB

_LOGGER = logging.getLogger(__name__)


@validated()
class ReportSettings:
    """Settings of the report."""

    name: str = "report"
    embed_limit_mb: Annotated[float, Ge(0), Le(1_000)] = 4.0  # larger pictures and films lie beside the page


def finished_stages(run_path: Path) -> dict[str, Manifest]:
    """Finished stage folders of a run, such as ``expert@seed=1``, but the report's, in order, to their manifests."""
    folders = sorted(p for p in run_path.iterdir() if p.is_dir()) if run_path.is_dir() else []
    manifests = {folder.name: read_manifest(folder) for folder in folders}
    order = available_stages()
    finished = {name: m for name, m in manifests.items() if m is not None and m.stage != "report"}
    return dict(
        sorted(finished.items(), key=lambda kv: (order.index(kv[1].stage) if kv[1].stage in order else 99, kv[0]))
    )


def run_report(settings: ReportSettings, context: StageContext) -> None:
    finished = finished_stages(context.run_path)
    learning = learning_section(context.run_path, finished, context.path / LEARNING_FOLDER)
    measured = join_sweep([*learning.results, {"environment": _environment()}], learning.variants)
    tables = report_tables(measured, over_seeds(learning.by_seed))
    for table in tables:
        write_text(context.path / TABLES_FOLDER / f"{table.key}.csv", as_csv(table))
        write_text(context.path / TABLES_FOLDER / f"{table.key}.tex", as_latex(table))
    write_json(context.path / METRICS, metrics(tables))
    figures = _figures(finished, learning, settings, context)
    have_run = {manifest.stage for manifest in finished.values()}
    made = notes_of(context.run_path, finished)
    for name, text in mixed_seeds(finished).items():
        _LOGGER.warning("%s", text)
        for key in {*read_results(context.run_path / name), OWN_TABLES.get(finished[name].stage, "")}:
            made.setdefault(key, []).append(text)
    not_run = [name for name in available_stages() if name not in {*have_run, "report"}]
    page = render_page(
        run=context.run_path.name,
        budget="+".join(dict.fromkeys(m.budget for m in finished.values())) or context.budget,
        seeds=sorted({m.seed for m in finished.values()}) or [context.seed],
        written=datetime.now(UTC).isoformat(timespec="minutes"),
        records={**finished, **dict.fromkeys(not_run)}, tables=tables, figures=figures, remarks=learning.remarks,
        commit=present_commit(), made=made, versions=software_versions(), machine=machine(),
    )  # fmt: skip
    write_text(context.path / PAGE, page)
    _LOGGER.info("report: %s", context.path / PAGE)


def notes_of(run_path: Path, finished: Collection[str]) -> dict[str, list[str]]:
    """Gathers how the measured rows were made: table to the different notes of the finished stage folders."""
    notes: dict[str, list[str]] = {}
    for name in finished:
        for table, text in read_notes(run_path / name).items():
            if text not in notes.setdefault(table, []):
                notes[table].append(text)
    return notes


def mixed_seeds(finished: Mapping[str, Manifest]) -> dict[str, str]:
    """Words which folders of a further seed had other settings than the stage's first: folder to a sentence."""
    first: dict[str, tuple[str, dict[str, Any]]] = {}
    sentences = {}
    for name, manifest in finished.items():
        if any(not word.startswith("seed=") for word in manifest.variant) or manifest.stage not in available_stages():
            continue  # what a sweep changed names its rows
        owned = fields(settings_of(manifest.stage))
        matter = {one.name: manifest.config.get(one.name) for one in owned if one.metadata.get("affects_results", True)}
        folder, settings = first.setdefault(manifest.stage, (name, matter))
        if differing := sorted(key for key in matter if matter[key] != settings[key]):
            sentences[name] = (
                f"{name} had other settings than {folder} ({', '.join(differing)}): figures over both mix them; "
                "run the stage again with the same ones."
            )
    return sentences


def _figures(
    finished: dict[str, Manifest], learning: LearningSection, settings: ReportSettings, context: StageContext
) -> list[ShownFigure]:
    """The figures of every stage, then those of learning, as many inside the page as fit there."""
    folders = {name: context.run_path / name for name in finished}
    if learning.folder is not None:
        folders = {LEARNING_FOLDER: learning.folder, **folders}  # first, so that films take the bytes that remain
    free_bytes, figures = EMBEDDED_BYTES, {}
    for name, folder in folders.items():
        figures[name] = gather_figures(
            name, folder, context.path, embed_limit=int(settings.embed_limit_mb * 1e6), free_bytes=free_bytes
        )
        free_bytes -= sum(figure.embedded_bytes for figure in figures[name])
    ordered = [*(name for name in figures if name != LEARNING_FOLDER), LEARNING_FOLDER]
    return [figure for name in ordered for figure in figures.get(name, [])]


def _environment() -> Table:
    versions = software_versions()
    libraries = {"PyTorch": "torch", "Stable-Baselines3": "stable-baselines3"}
    learning = [f"{label} {versions[name]}" for label, name in libraries.items() if name in versions]
    software = [(name, versions[name]) for name in ("python", "mujoco", "gymnasium") if name in versions]
    values = [*machine().items(), *software, ("learning", ", ".join(learning) or None)]
    return {name: {"value": value} for name, value in values}


def _inputs(run_path: Path) -> dict[str, str]:
    states = {"commit": present_commit()}
    for name, manifest in finished_stages(run_path).items():
        changed = manifest.changed_output(run_path / name)
        if changed is not None:
            _LOGGER.warning("%s: run stage=%s again; the report shows what is there", changed, manifest.stage)
        states[name] = manifest.identity.fingerprint + manifest.finished + (changed or "")
    return states


STAGE = Stage(settings=ReportSettings, run=run_report, seeded=False, gathers=True, further_inputs=_inputs)
