"""Tables of results in documents: made between two marks from the files of results.

A mark names claims: `<!-- results: random_roadmap -->`, and `<!-- end of results -->` ends its table. One claim gets
all its figures, several get a row each. `<!-- navigation: ... -->` gives each claim of navigation a row with its
targets, `<!-- variations: ... -->` each variation of them.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from pipeline.protocol.claims import read_protocol
from pipeline.store.atomic_files import read_json, write_text
from pipeline.store.errors import ConfigurationError
from pipeline.store.provenance import PROJECT_ROOT

_MARKED = re.compile(r"(<!-- (results|navigation|variations): ([\w ]+) -->\n).*?(<!-- end of results -->)", re.DOTALL)
_WORDS = {
    "success_pct": "success, %",
    "straight_pct": "tip within 8 mm in a straight line, %",
    "before_pct_mean": "copies reached before, %",
    "after_pct_mean": "copies reached after, %",
    "cpu_s_mean": "processor time of the training, s",
    "depth_mm_mean": "tip behind the ostium, mm",
    "force_p95_n_mean": "force, 95th percentile of an episode, N",
    "steps_mean": "steps",
    "mean_mm_mean": "mean distance at equal arc length, mm",
    "max_mm_mean": "largest distance, mm",
    "tip_mm_mean": "distance of the tips, mm",
    "place_mm_mean": "place of the largest contact, mm off",
    "dice_mean": "Dice of the curve, drawn 6 px wide",
    "within_4px_pct_mean": "annotation within 4 px of the curve, %",
    "curve_mean_px_mean": "annotation from the curve, px",
    "tip_px_mean": "distance of the tips, px",
    "leave_out_px_mean": "distortion at holes left out, px",
    "mean_px_mean": "reprojection of beads, px",
    "steps_per_s_mean": "steps a second of processor time",
    "resultant_error_pct_median": "error of the resultant, median, %",
    "sum_error_pct_median": "error of the sum of normal forces, median, %",
}
_OF_KIND = {
    "real_xray": {"mean_mm_mean": "mean distance between both curves, mm"},
    "forces": {"success_pct": "90 % interval holds the resultant, %"},
    "rehearsal": {
        "success_pct": "arches with nine tenths of the copies reached, %",
        "force_p95_n_mean": "force, 95th percentile of all steps in all copies, N",
    },
}
# the figure of a claim that a table of several shows: the first that it has, with its unit
_HEADLINES = {
    "resultant_error_pct_median": "% median error",
    "mean_mm_mean": "mm",
    "steps_per_s_mean": "steps a second",
    "mean_px_mean": "px",
    "after_pct_mean": "% of copies",
    "success_pct": "%",
}


def documents(root: Path = PROJECT_ROOT) -> Iterator[Path]:
    """Documents with tables of results."""
    for path in [root / "README.md", *sorted((root / "docs").rglob("*.md"))]:
        if _MARKED.search(path.read_text(encoding="utf-8")):
            yield path


def rendered(text: str, results: Path) -> str:
    """A document's text with its tables made from the files of a folder.

    Raises:
        ConfigurationError: a claim that it names has no results.
    """

    def table(match: re.Match[str]) -> str:
        read = [_read(results / f"{name}.json") for name in match[3].split()]
        form = {"navigation": _targets, "variations": _variations}.get(match[2], _rows if len(read) > 1 else _figures)
        return f"{match[1]}\n{form(read)}\n\n{match[4]}"

    return _MARKED.sub(table, text)


def render(results: Path, root: Path = PROJECT_ROOT) -> list[Path]:
    """Renders all documents anew; the paths of those that changed."""
    changed = []
    for path in documents(root):
        old = path.read_text(encoding="utf-8")
        if (new := rendered(old, results)) != old:
            write_text(path, new)
            changed.append(path)
    return changed


def _read(path: Path) -> Any:
    if not path.is_file():
        raise ConfigurationError(f"{path} is missing: `endonav evaluate {path.stem}` makes it")
    try:
        result = read_json(path)
        name, _, _ = (result[key] for key in ("claim", "declared", "summary"))
    except (ValueError, KeyError, TypeError) as error:
        raise ConfigurationError(
            f"{path} is damaged: remove it, and `endonav evaluate {path.stem}` makes it again ({error})"
        ) from None
    if claim := read_protocol().claims.get(name):  # its words may be others since, its figures not
        result["declared"] |= {"title": claim.title, "limits": claim.limits}
    return result


def _figures(read: Sequence[dict[str, Any]]) -> str:
    """All figures of a claim, then how they were made and what limits them."""
    (result,) = read
    summary, claim = result["summary"], result["declared"]
    words = _WORDS | _OF_KIND.get(claim["kind"], {})
    only = claim.get("targets") or [claim.get("target")]
    again = f"success_{only[0]}_pct" if len(only) == 1 else None  # of a single target: that of the first line
    rows = [
        (
            words.get(key, f"success, {key[8:-4]}, %"),
            _short(value["mean"]),
            f"{_short(value['low'])} to {_short(value['high'])}",
        )
        for key, value in summary.items()
        if isinstance(value, dict) and key != again
    ]
    if "force_max_n" in summary:
        rows.append(("largest force, N", _short(summary["force_max_n"]), ""))
    return (
        f"{claim['title']}: {_number(summary)}.\n\n{_table(('', 'mean', '95 % interval'), rows)}\n\n"
        f"{_made(read)} {claim['limits']}"
    )


def _made(read: Sequence[dict[str, Any]]) -> str:
    """How figures were made: the commands, with commits and versions of the protocol."""
    of_origin: dict[tuple[str, str, int], list[dict[str, Any]]] = {}
    for result in read:
        origin = (_seeds(result), result["made_by"]["commit"], result["protocol"])
        of_origin.setdefault(origin, []).append(result)
    return " ".join(
        f"`endonav evaluate {' '.join(result['claim'] for result in own)}{seeds}`, commit `{commit}`, "
        f"version {version} of the protocol{_time(own)}."
        for (seeds, commit, version), own in of_origin.items()
    )


def _time(read: Sequence[dict[str, Any]]) -> str:
    minutes = [result["summary"].get("cpu_min") for result in read]
    if None in minutes or (total := round(sum(minutes))) == 0:
        return ""
    return f", {total} min of processor time"


def _targets(read: Sequence[dict[str, Any]]) -> str:
    """A row for each claim of navigation, with its targets, depth and forces, then what limits each."""
    rows = []
    for result in read:
        summary, declared = result["summary"], result["declared"]
        targets = ", ".join(
            f"{name} {summary[key]['mean']:g}"
            for name in declared["targets"]
            if (key := f"success_{name}_pct") in summary
        )
        keys = ("depth_mm_mean", "force_p95_n_mean")
        depth, force = (_of_those(result, key) if key in summary else "-" for key in keys)
        largest = _short(summary["force_max_n"]) if "force_max_n" in summary else "-"
        rows.append(
            (
                declared["title"],
                f"{summary['cases']}; {summary['anatomies']}",
                f"**{_percent(summary['success_pct'])}**",
                targets,
                _short(summary["straight_pct"]["mean"]),
                depth,
                f"{force}; {largest}",
            )
        )
    head = ("what", "cases; anatomies", "success, %", "by target, %", "8 mm straight, %", "depth, mm", "force, N")
    return f"{_table(head, rows)}\n\n{_made(read)}\n{_limits(read)}"


def _variations(read: Sequence[dict[str, Any]]) -> str:
    """A row for each variation, with each claim's share of successes."""
    rows = []
    for name in dict.fromkeys(name for result in read for name in result["declared"]["variations"]):
        key = f"success_{name}_pct"
        rows.append((name, *(_percent(one["summary"][key]) if key in one["summary"] else "" for one in read)))
    head = ("success, %", *(f"{result['declared']['title']}: {_number(result['summary'])}" for result in read))
    return f"{_table(head, rows)}\n\n{_made(read)}\n{_limits(read)}"


def _percent(figure: dict[str, float]) -> str:
    return f"{_short(figure['mean'])} ({_short(figure['low'])} to {_short(figure['high'])})"


def _short(number: float) -> str:
    """Three digits, or all before the point."""
    return f"{number:.3g}" if abs(number) < 1000 else f"{number:.0f}"


def _limits(read: Sequence[dict[str, Any]]) -> str:
    """A line for each limit, with the claims that have it."""
    claims: dict[str, list[str]] = {}
    for result in read:
        claims.setdefault(result["declared"]["limits"], []).append(result["declared"]["title"])
    return "".join(f"\n- {'; '.join(titles)}: {limits}" for limits, titles in claims.items())


def _rows(read: Sequence[dict[str, Any]]) -> str:
    """A row for each claim."""
    rows = []
    for result in read:
        key = next(key for key in _HEADLINES if key in result["summary"])
        figure = result["summary"][key]
        interval = f"({_short(figure['low'])} to {_short(figure['high'])})"
        value = f"{_short(figure['mean'])} {_HEADLINES[key]} {interval}, {_count(result, key)} cases"
        rows.append((result["declared"]["title"], value, result["declared"]["limits"]))
    return _table(("what", "95 % interval", "limit"), rows)


def _of_those(result: dict[str, Any], key: str) -> str:
    """A mean, with the number of cases that have what it is of where some have not: a refused file has no depth."""
    number, mean = _count(result, key), _short(result["summary"][key]["mean"])
    return mean if number == result["summary"]["cases"] else f"{mean} (of {number})"


def _count(result: dict[str, Any], key: str) -> int:
    """How many cases have what a figure is of."""
    return sum(key.rsplit("_", 1)[0] in case for case in result["cases"])


def _number(summary: dict[str, Any]) -> str:
    return f"{summary['cases']} cases in {summary['anatomies']} anatomies or scenes"


def _seeds(result: dict[str, Any]) -> str:
    return "" if result["seeds"] == 1 else f" --seeds {result['seeds']}"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [f"| {' | '.join(line)} |" for line in (head, *rows)]
    return "\n".join([lines[0], "|---" * len(head) + "|", *lines[1:]])
