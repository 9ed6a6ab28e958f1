"""Benchmarks are too slow for a test; that what they import is still there is not."""

from __future__ import annotations

import ast
import importlib
import importlib.util
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "benchmarks"
OURS = ("cathsim", "enn", "guide3d", "splineformer", "pipeline")


@pytest.mark.parametrize("file", sorted(FOLDER.rglob("*.py")), ids=lambda file: str(file.relative_to(FOLDER)))
def test_what_a_benchmark_imports_is_there(file: Path) -> None:
    missing = []
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] in OURS:
            assert node.module is not None
            module = importlib.import_module(node.module)
            for name in node.names:
                part = f"{node.module}.{name.name}"
                a_module = hasattr(module, "__path__") and importlib.util.find_spec(part) is not None
                if not a_module and not hasattr(module, name.name):
                    missing.append(part)
    assert not missing
