"""The demo's page: one HTML file beside its film and log that opens with the film and needs no network connection."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jinja2

from pipeline.demo.film import LUMEN, TARGET, TRUE_WIRE, WAY, WIRE
from pipeline.demo.steering import Scene
from pipeline.printing import CALLED, written
from pipeline.store.atomic_files import write_text

PAGE = "index.html"
_TEMPLATE = Path(__file__).with_name("page.html.j2")
_WIDTH, _HEIGHT = 490, 120  # of a plot, px
_STEPS_A_SECOND = 10
_ARTERIES = {"bca": "brachiocephalic", "lcca": "left common carotid", "lsa": "left subclavian",
             "rcca": "right common carotid", "rsa": "right subclavian"}  # fmt: skip


def write_page(
    folder: Path,
    scene: Scene,
    metrics: Mapping[str, Any],
    curves: Mapping[str, Sequence[float]],
    files: Mapping[str, str],
) -> Path:
    """Writes an episode's page beside its files (`mp4`, `gif`, `log`), gives its path; `curves`: a value a step."""
    from enn import shipped

    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    template = environment.from_string(_TEMPLATE.read_text(encoding="utf-8"))
    page = folder / PAGE
    text = template.render(
        scene=scene,
        metrics=metrics,
        seconds=metrics["steps"] / _STEPS_A_SECOND,
        files=files,
        commands=_further(folder, files["log"]),
        parts=sections(shipped.card(scene.model)),
        summary=shipped.models()[scene.model],
        card=f"{_in_environment()}endonav models {scene.model}",
        artery=_ARTERIES.get(scene.target),
        plots=[
            ("distance of the tip from the target, mm", plot(curves["distance_mm"]), max(curves["distance_mm"])),
            ("contact force, N", plot(curves["force_n"]), max(curves["force_n"])),
        ],
        width=_WIDTH,
        height=_HEIGHT,
        last_s=(len(curves["distance_mm"]) - 1) / _STEPS_A_SECOND,
        colours={
            name: f"rgb{colour}"
            for name, colour in {"wire": WIRE, "way": WAY, "lumen": LUMEN, "target": TARGET, "true": TRUE_WIRE}.items()
        },
    )
    write_text(page, text)
    return page


def _further(folder: Path, log: str) -> list[tuple[str, str]]:
    """Commands to go on with, each with what it does."""
    arguments = {
        "an aorta of your own: a surface or a label volume": "--anatomy arch.stl",
        "another arch and branch": "--seed 7 --target lcca",
        "by a roadmap of the scan in place of images": "--model generalist",
    }
    if CALLED in os.environ:
        demos = [(f"{written('demo')} {words}", what) for what, words in arguments.items()]
    else:
        own, *others = arguments.items()
        demos = [("make demo DEMO=arch.stl", own[0]), *((f'make demo ARGS="{words}"', what) for what, words in others)]
    return [*demos, (f"{_in_environment()}{written('episodes')} info {folder.as_posix()}/{log}", "what the log holds")]


def _in_environment() -> str:
    """What a command of the environment begins with where the reader need not have activated it."""
    return "" if CALLED in os.environ else ".venv/bin/"


def sections(card: str) -> dict[str, str]:
    """The parts of a model's card that the page shows: title to plain text; tables are left to the card."""
    texts = {}
    for part in card.split("\n**")[1:]:
        title, _, text = part.partition(".**")
        lines = [line for line in text.split("\n") if not line.startswith(("|", "```"))]
        texts[title] = " ".join(" ".join(lines).replace("`", "").split())
    return {title: texts[title] for title in ("What it sees", "Trained on", "Limits") if texts.get(title)}


def plot(values: Sequence[float]) -> str:
    """The points of a polyline in a plot of the page's size, the largest value at its top."""
    top = max(max(values), 1e-9)
    step = _WIDTH / max(len(values) - 1, 1)
    return " ".join(f"{k * step:.1f},{_HEIGHT * (1 - value / top):.1f}" for k, value in enumerate(values))
