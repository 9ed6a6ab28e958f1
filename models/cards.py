"""Index of the shipped models and facts in their cards: ``python models/cards.py`` writes them from the files.

A model is ``packages/<package>/src/<package>/weights/<name>.pt`` and its card ``<name>.md``. A card is written by hand
but for its table (file, size, SHA-256 and format) and the YAML at its head, which says the same and more to programs.
``models/README.md`` lists all; its table is written here, too.
"""

from __future__ import annotations

import hashlib
import re
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

PROJECT_ROOT = Path(__file__).resolve().parents[1]
LEARNING_PACKAGES = ("enn", "guide3d", "splineformer")
INDEX = "models/README.md"
LIMIT_BYTES = 30_000_000  # of all together: they lie in the repository for ever
SECTIONS = ("What it sees", "Trained on", "Command", "Figures", "Limits")  # of every card, bold, in this order
_FACTS = re.compile(r"^\| file \|.*?(?=^$)", re.DOTALL | re.MULTILINE)
_HEAD = re.compile(r"\A---\n.*?\n---\n\n", re.DOTALL)
_ROWS = re.compile(r"^\| name \|.*?(?=^$)", re.DOTALL | re.MULTILINE)


@dataclass(frozen=True)
class ShippedModel:
    """A file of weights with its card."""

    root: Path  # of the repository
    path: Path  # of the file

    @property
    def card(self) -> Path:
        """Path of the card."""
        return self.path.with_suffix(".md")

    @property
    def package(self) -> str:
        """Import name of the package that it belongs to."""
        return self.path.parents[1].name

    @property
    def sha256(self) -> str:
        """Of the file, hexadecimal."""
        return hashlib.sha256(self.path.read_bytes()).hexdigest()

    @property
    def size(self) -> str:
        """Of the file, in words."""
        return f"{self.path.stat().st_size / 1e6:.2f} MB"

    def content(self) -> dict[str, Any]:
        """What the file holds; a ValueError where it is damaged."""
        from guide3d.learning.model_file import read_content

        found: dict[str, Any] = read_content(self.path)
        return found

    def form(self) -> str:
        """The format that the file says that it has."""
        return str(self.content()["format"])

    def head(self) -> str:
        """YAML for programs: what a card says at its head."""
        content = self.content()
        numbers = sum(array.numel() for array in _arrays(content))
        sees = list(content.get("network", {}).get("keys", ())) or ["image"]
        facts: dict[str, Any] = {
            "license": "mit",
            "library_name": self.package,
            "model_name": self.path.stem,
            "observations": sees,
        }
        facts |= {"format": str(content["format"]), "numbers": numbers, "bytes": self.path.stat().st_size}
        return f"---\n{yaml.safe_dump(facts | {'sha256': self.sha256}, sort_keys=False)}---\n\n"

    def facts(self) -> str:
        """The table of the card, with its last line end."""
        cells = (f"`{self.path.name}`", self.size, f"`{self.sha256}`", f"`{self.form()}`")
        return f"| file | size | SHA-256 | format |\n|---|---|---|---|\n{_row(cells)}\n"

    def row(self) -> tuple[str, ...]:
        """Its cells in the index."""
        words = _HEAD.sub("", self.card.read_text(encoding="utf-8"), count=1)
        sentence = " ".join(words.split("\n\n")[1].split())
        link = f"[card](../{self.card.relative_to(self.root).as_posix()})"
        return f"`{self.package}` `{self.path.stem}`", sentence, self.size, f"`{self.sha256[:12]}`", link


def shipped_models(root: Path = PROJECT_ROOT) -> list[ShippedModel]:
    """Every shipped model, by package and name."""
    folders = [root / "packages" / name / "src" / name / "weights" for name in LEARNING_PACKAGES]
    return [ShippedModel(root, path) for folder in folders for path in sorted(folder.glob("*.pt"))]


def written(root: Path = PROJECT_ROOT) -> dict[Path, str]:
    """What cards and index ought to hold, by path; a ValueError where one lacks a part, or the files are too large."""
    models = shipped_models(root)
    total = sum(model.path.stat().st_size for model in models)
    if total > LIMIT_BYTES:
        raise ValueError(f"the models have {total / 1e6:.1f} MB, more than {LIMIT_BYTES / 1e6:.0f}: ship fewer")
    texts = {}
    for model in models:
        if not model.card.is_file():
            raise ValueError(f"{model.path} has no card: write {model.card}")
        text = _HEAD.sub("", model.card.read_text(encoding="utf-8"), count=1)
        places = [text.find(f"**{section}.**") for section in SECTIONS]
        if -1 in places or places != sorted(places) or not _FACTS.search(text):
            raise ValueError(f"{model.card}: expected a table of the file, then {', '.join(SECTIONS)}, each as **X.**")
        texts[model.card] = model.head() + _FACTS.sub(lambda _, model=model: model.facts(), text, count=1)  # type: ignore[misc]
    index = root / INDEX
    head = "| name | what it does | size | SHA-256 begins | |\n|---|---|---|---|---|\n"
    table = head + "".join(_row(model.row()) + "\n" for model in models)
    texts[index] = _ROWS.sub(lambda _: table, index.read_text(encoding="utf-8"), count=1)
    return texts


def main(arguments: Sequence[str] | None = None) -> int:
    """Writes the tables of cards and index, or says why not."""
    try:
        texts = written()
    except ValueError as error:
        print(error, file=sys.stderr)
        return 1
    for path, text in texts.items():
        path.write_text(text, encoding="utf-8")
    return 0


def _arrays(content: Any) -> Iterator[Any]:
    """Every array of numbers in it."""
    if hasattr(content, "numel"):
        yield content
    for part in content.values() if isinstance(content, dict) else ():
        yield from _arrays(part)


def _row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


if __name__ == "__main__":
    sys.exit(main())
