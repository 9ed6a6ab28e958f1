"""What a module's source refers to: imports of every kind, names of modules and of files, read without running it."""

from __future__ import annotations

import ast
import itertools
import re
from collections.abc import Iterable, Iterator
from typing import Any

_DOTTED = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)+")
_FILE_NAME = re.compile(r"[\w-][\w.-]*(/[\w-][\w.-]*)*")


def references(text: str, module: str, *, is_package: bool) -> dict[str, Any]:
    """Lists what a module refers to.

    Imports inside functions count; those for type checkers alone do not.

    Returns:
        JSON values:

        - ``imports``: pairs of a module and the name wanted of it; "" for none, "*" for all.
        - ``strings``: constants that could be a module's dotted name, as ``importlib.import_module`` takes them.
        - ``lazy``: name to module of what a module-level ``__getattr__`` imports at first use.
        - ``files``: constants that could name a file, where the module looks beside its own (``__file__``).
    """
    tree = ast.parse(text)
    package = module if is_package else module.rpartition(".")[0]
    nodes = list(_running(tree))
    imports: dict[tuple[str, str], None] = {}
    known: dict[str, str] = {}  # name in this module -> module
    for node in nodes:
        if isinstance(node, ast.Import):
            for alias in node.names:
                imports[alias.name, ""] = None
                known[alias.asname or alias.name.partition(".")[0]] = (
                    alias.name if alias.asname else alias.name.partition(".")[0]
                )
        elif isinstance(node, ast.ImportFrom):
            source = _absolute(node, package)
            for alias in node.names:
                imports[source, alias.name] = None
                known[alias.asname or alias.name] = f"{source}.{alias.name}"  # if that is a module
    for node in nodes:  # `import cathsim` and then cathsim.load_phantom
        if isinstance(node, ast.Attribute) and (dotted := _dotted(node)) is not None:
            first, *rest = dotted
            if first in known:
                for index, name in enumerate(rest):
                    imports[".".join([known[first], *rest[:index]]), name] = None
    strings = {
        node.value for node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value
    }
    looks_beside = any(isinstance(node, ast.Name) and node.id == "__file__" for node in nodes)
    return {
        "imports": [list(pair) for pair in imports],
        "strings": sorted(filter(_DOTTED.fullmatch, strings)),
        "lazy": _lazy(tree.body),
        "files": sorted(filter(_FILE_NAME.fullmatch, strings)) if looks_beside else [],
    }


def _running(tree: ast.AST) -> Iterator[ast.AST]:
    """All nodes but those inside `if TYPE_CHECKING`."""
    todo = [tree]
    while todo:
        node = todo.pop()
        yield node
        if isinstance(node, ast.If) and _is_type_checking(node.test):
            todo += node.orelse
        else:
            todo += ast.iter_child_nodes(node)


def _is_type_checking(test: ast.expr) -> bool:
    return getattr(test, "id", getattr(test, "attr", "")) == "TYPE_CHECKING"


def _absolute(node: ast.ImportFrom, package: str) -> str:
    if not node.level:
        return node.module or ""
    base = package.split(".")[: len(package.split(".")) - node.level + 1]
    return ".".join([*base, *([node.module] if node.module else [])])


def _dotted(node: ast.Attribute) -> list[str] | None:
    names = [node.attr]
    value = node.value
    while isinstance(value, ast.Attribute):
        names.append(value.attr)
        value = value.value
    return [value.id, *reversed(names)] if isinstance(value, ast.Name) else None


def _lazy(body: Iterable[ast.stmt]) -> dict[str, str]:
    """The module-level tables of a module with a ``__getattr__``, defined or assigned: name to module."""
    body = list(body)
    if "__getattr__" not in itertools.chain.from_iterable(map(_bound, body)):
        return {}
    tables = [s.value for s in body if isinstance(s, ast.Assign | ast.AnnAssign) and isinstance(s.value, ast.Dict)]
    return {
        key.value: value.value
        for table in tables
        for key, value in zip(table.keys, table.values, strict=True)
        if isinstance(key, ast.Constant) and isinstance(value, ast.Constant)
        if isinstance(key.value, str) and isinstance(value.value, str)
    }


def _bound(statement: ast.stmt) -> list[str]:
    """The names that a definition or a plain assignment binds."""
    if isinstance(statement, ast.Assign):
        return [target.id for target in statement.targets if isinstance(target, ast.Name)]
    return [statement.name] if isinstance(statement, ast.FunctionDef) else []
