"""The documents of the repository, and what is read in them."""

import ast
import importlib
import importlib.util
import re
from pathlib import Path

import pytest

PROJECT_ROOT = Path(__file__).resolve().parents[3]
DOCS = PROJECT_ROOT / "docs"
PACKAGES = ("cathsim", "enn", "guide3d", "splineformer")
READMES = [PROJECT_ROOT / "models" / "README.md"]
READMES += [PROJECT_ROOT / "packages" / package / "README.md" for package in PACKAGES]
PAGES = sorted(DOCS.rglob("*.md"))
STAGES = {path.stem for path in (PROJECT_ROOT / "conf" / "stage").glob("*.yaml")}
TOP = [PROJECT_ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")]
DOCUMENTS = [*TOP, *READMES, *PAGES]
DOTTED = re.compile(rf"(?:{'|'.join((*PACKAGES, 'pipeline'))})(?:\.\w+)+")


def relative(document: Path) -> str:
    return document.relative_to(PROJECT_ROOT).as_posix()


def without_blocks(text: str) -> str:
    return re.sub(r"^```.*?^```$", "", text, flags=re.DOTALL | re.MULTILINE)


def quoted(text: str) -> list[str]:
    """What stands between single backticks outside blocks of code."""
    return re.findall(r"`([^`\n]+)`", without_blocks(text))


def code_blocks(text: str, language: str = r"\w*") -> list[str]:
    return re.findall(rf"^```{language}(?: [\w-]+)?\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)


def resolves(name: str) -> bool:
    """Whether a dotted name is a module, or an attribute of one, or a field of a class in one."""
    parts = name.split(".")
    for length in range(len(parts), 0, -1):
        try:
            found = importlib.import_module(".".join(parts[:length]))
        except ModuleNotFoundError as error:
            if error.name is None or not name.startswith(error.name):  # an optional dependency is missing
                return True
            continue
        for part in parts[length:]:
            if not hasattr(found, part):
                return part in getattr(found, "__dataclass_fields__", {})
            found = getattr(found, part)
        return True
    return False


def require_imports(source: str) -> None:
    """Fails where Python imports what the project does not have."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom) and node.module and DOTTED.match(f"{node.module}.x"):
            assert all(resolves(f"{node.module}.{alias.name}") for alias in node.names), ast.unparse(node)
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names if DOTTED.match(f"{alias.name}.x")]
            assert all(resolves(name) for name in names), ast.unparse(node)


def read(document: Path) -> str:
    return document.read_text(encoding="utf-8")


documents = pytest.mark.parametrize("document", DOCUMENTS, ids=relative)
