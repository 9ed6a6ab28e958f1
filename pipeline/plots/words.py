"""Names of rows, columns, groups and figures in words: keys of a run such as ``fpn_200`` never reach a reader."""

from __future__ import annotations

import re
from collections.abc import Mapping

_UNITS = {"pct": "%", "n": "N", "n2": "N²", "mm": "mm", "cm": "cm", "px": "px", "s": "s", "h": "h", "ms": "ms",
          "min": "min"}  # fmt: skip
_ROWS = (
    (r"fpn_(\d+)k", r"FPN, \1k samples"),
    (r"fpn_(\d+)", r"FPN, \1 samples"),
    (r"image_w_enn_(\d+)", r"Image with ENN, \1 episodes"),
    (r"splineformer_(\d+)", r"SplineFormer, \1 trials"),
    (r"I\+V\+M safe ([\d.]+)", r"I+V+M, safe, cost of a newton \1"),
)
_OPERATORS = {
    "baselines": "Baselines", "enn": "ENN", "imitation": "Imitation", "unseen": "Policies for unseen anatomies",
    "expert": "Sampling expert", "sampling_expert": "Sampling expert", "human": "People", "wire": "Wire alone",
}  # fmt: skip
_NAMES = {
    **_OPERATORS, "type_1": "Type I", "type_2": "Type II", "type_3": "Type III",
    "type_1_aneurysm": "Type I with aneurysm",
    "low_tortuosity": "Low tortuosity", "bovine": "Bovine arch", "bca": "BCA", "lcca": "LCCA", "lsa": "LSA",
    "rcca": "RCCA", "rsa": "RSA", "image_w_enn": "Image with ENN", "image_wo_enn": "Image without ENN",
    "dagger": "DAgger", "image_w_enn_disturbed": "Image with ENN, disturbed too",
    "splineformer_dagger": "SplineFormer, taught on", "splineformer_arches": "SplineFormer, random arches",
    "V_plain": "V, force alone",
}  # fmt: skip
_CHAPTERS = {"guide3d": "chapter 5"}
_KINDS = {"tab": "table", "fig": "figure"}


def row_words(key: str, labels: Mapping[str, str]) -> str:
    """Words a row's key: its label in the table, or its beginning's and the rest behind a comma, or the key."""
    if key in labels:
        return labels[key]
    for pattern, words in _ROWS:
        match = re.match(pattern + r"(?![\w.])", key)
        if match:
            return _continued(match.expand(words), key[match.end() :])
    known = [label for label in {**_OPERATORS, **labels} if re.match(re.escape(label) + r"[ _(]", key)]
    if known:
        start = max(known, key=len)
        return _continued({**_OPERATORS, **labels}[start], key[len(start) :])
    return _OPERATORS.get(key) or plain(key)


def group_words(group: str, groups: Mapping[str, str], labels: Mapping[str, str]) -> str:
    """Words a group of rows, parts joined by slashes, by names of phantoms and targets, and the table's labels."""
    return ", ".join(groups[part] if part in groups else row_words(part, labels) for part in group.split("/") if part)


def column_words(key: str) -> tuple[str, str]:
    """Words a column that no table names: label and unit, the latter from the key's ending."""
    start, _, end = key.rpartition("_")
    return (plain(start), _UNITS[end]) if start and end in _UNITS else (plain(key), "")


def place_in_thesis(label: str) -> str:
    """Words where the thesis has a table, from its label there: ``ch3tab:results`` is a table of chapter 3."""
    match = re.match(r"(?:ch(\d+)|app(\d+)|(\w+?))-?(tab|fig):", label)
    if not match:
        return label if label.startswith("not ") else f"thesis, {label}"
    chapter, appendix, name, kind = match.groups()
    place = f"chapter {chapter}" if chapter else f"appendix {appendix}" if appendix else _CHAPTERS.get(name, name)
    return f"thesis, {place}, {_KINDS[kind]}"


def in_words(text: str) -> str:
    """Replaces keys within a sentence or title by words: ``type_1/bca`` becomes "Type I, BCA"."""

    def words(match: re.Match[str]) -> str:
        token = match.group()
        parts = token.split("/")
        if all(part in _NAMES for part in parts):
            return ", ".join(_NAMES[part] for part in parts)
        if "_" not in token:
            return token
        return ", ".join(_NAMES.get(part) or row_words(part, {}) for part in parts)

    return re.sub(r"[\w.]*_\w*(?:/\w+)*|\w+/\w+", words, text)


def plain(key: str) -> str:
    """A key with spaces for underscores and a capital at its beginning."""
    text = key.replace("_", " ").strip()
    return text[:1].upper() + text[1:]


def _continued(start: str, rest: str) -> str:
    rest = rest.replace("_", " ").strip()
    return f"{start} {rest}" if rest.startswith("(") else f"{start}, {rest}" if rest else start
