"""What sources import, and where in them."""

import ast
import functools
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

CALLS = ("import_module", "__import__", "importorskip")


class Import(NamedTuple):
    """An import of a module, or of a name from it."""

    module: str
    name: str  # "" where the module itself is imported
    for_types: bool  # only for type checkers
    in_function: bool

    @property
    def at_load(self) -> bool:
        """Whether it happens when its own module is imported."""
        return not (self.for_types or self.in_function)


@functools.cache
def imports_of(file: Path) -> tuple[Import, ...]:
    """Every import of a file, also those inside functions and of import_module("...")."""
    text = file.read_text(encoding="utf-8")
    tree = ast.parse(text)
    called = _called(tree) if re.search("|".join(CALLS), text) else ()
    return (*_statements(tree, False, False), *called)


def _statements(node: ast.AST, for_types: bool, in_function: bool) -> Iterator[Import]:
    if isinstance(node, ast.Import):
        yield from (Import(alias.name, "", for_types, in_function) for alias in node.names)
    elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
        yield from (Import(node.module, alias.name, for_types, in_function) for alias in node.names)
    in_function = in_function or isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
    typed = node.body if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test) else ()
    for inner in ast.iter_child_nodes(node):
        if isinstance(inner, ast.stmt | ast.ExceptHandler | ast.match_case):
            yield from _statements(inner, for_types or inner in typed, in_function)


def _called(tree: ast.Module) -> Iterator[Import]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and node.args and isinstance(node.args[0], ast.Constant):
            function = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            if function in CALLS and isinstance(node.args[0].value, str):
                yield Import(node.args[0].value, "", False, True)
