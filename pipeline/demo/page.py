"""The demo's page: one HTML file beside its film and log that opens with the film and needs no network connection."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jinja2

from pipeline.demo.film import LUMEN, TARGET, TRUE_WIRE, WAY, WIRE
from pipeline.demo.steering import Scene
from pipeline.store.atomic_files import write_text

PAGE = "index.html"
_TEMPLATE = Path(__file__).with_name("page.html.j2")
_WIDTH, _HEIGHT = 490, 120  # of a plot, px
_STEPS_A_SECOND = 10


def write_page(
    folder: Path,
    scene: Scene,
    metrics: Mapping[str, Any],
    curves: Mapping[str, Sequence[float]],
    files: Mapping[str, str],
) -> Path:
    """Writes the page.

    Args:
        folder: of the film and the log.
        metrics: of the episode, as `cathsim.metrics.EpisodeMetrics` names them.
        curves: a value a step: `distance_mm` and `force_n`.
        files: `mp4`, `gif` and `log`, names in the folder.

    Returns:
        Its path.
    """
    from enn import shipped

    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    template = environment.from_string(_TEMPLATE.read_text(encoding="utf-8"))
    page = folder / PAGE
    text = template.render(
        scene=scene,
        metrics=metrics,
        seconds=metrics["steps"] / _STEPS_A_SECOND,
        files=files,
        folder=folder.as_posix(),
        parts=sections(shipped.card(scene.model)),
        summary=shipped.models()[scene.model],
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


def sections(card: str) -> dict[str, str]:
    """The parts of a model's card that the page shows: title to plain text; tables are left to the card."""
    found = {}
    for part in card.split("\n**")[1:]:
        title, _, text = part.partition(".**")
        lines = [line for line in text.split("\n") if not line.startswith(("|", "```"))]
        found[title] = " ".join(" ".join(lines).replace("`", "").split())
    return {title: found[title] for title in ("What it sees", "Trained on", "Limits") if found.get(title)}


def plot(values: Sequence[float]) -> str:
    """The points of a polyline in a plot of the page's size, the largest value at its top."""
    top = max(max(values), 1e-9)
    step = _WIDTH / max(len(values) - 1, 1)
    return " ".join(f"{k * step:.1f},{_HEIGHT * (1 - value / top):.1f}" for k, value in enumerate(values))
