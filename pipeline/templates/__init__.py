"""`endonav new KIND NAME`: writes a stage, a policy or a phantom that runs, with its test, for you to change."""

from __future__ import annotations

import importlib.util
import keyword
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from pipeline.printing import Parser, say
from pipeline.store.atomic_files import write_text
from pipeline.store.provenance import PROJECT_ROOT

_REGISTRY = Path("pipeline", "stages", "__init__.py")
_REPORT = '    "report": ('  # the line of the registry before which further stages come


@dataclass(frozen=True)
class _Kind:
    """What is written of a kind: template to file, and what to do next; NAME and TITLE are replaced."""

    files: dict[str, str]
    run: str
    test: str


_KINDS = {
    "stage": _Kind(
        {"stage.yaml": "conf/stage/NAME.yaml", "stage.py": "pipeline/stages/NAME.py",
         "test_stage.py": "tests/pipeline/stages/test_NAME.py"},
        "python -m pipeline stage=NAME budget=smoke", "python -m pytest tests/pipeline/stages/test_NAME.py",
    ),
    "policy": _Kind({"policy.py": "NAME.py", "test_policy.py": "test_NAME.py"}, "python NAME.py",
                    "python -m pytest test_NAME.py"),
    "phantom": _Kind({"phantom.py": "NAME.py", "test_phantom.py": "test_NAME.py"}, "python NAME.py",
                     "python -m pytest test_NAME.py"),
}  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """Writes the files; nothing that is there is overwritten."""
    parser = Parser(prog="endonav new", description=__doc__)
    parser.add_argument(
        "kind",
        choices=_KINDS,
        metavar="|".join(_KINDS),
        help="a stage goes into the clone, others into the present folder",
    )
    parser.add_argument("name", metavar="NAME", help="a Python name in small letters")
    options = parser.parse_args(arguments)
    name, kind = options.name, _KINDS[options.kind]
    if not name.isidentifier() or name != name.lower() or keyword.iskeyword(name):
        parser.error(f"{name!r} is no Python name in small letters, such as my_{options.kind}")
    folder = PROJECT_ROOT if options.kind == "stage" else Path.cwd()
    prefix = Path() if folder == Path.cwd() else folder  # paths are of the present folder, or absolute
    registry = folder / _REGISTRY
    if options.kind == "stage" and not (folder / "tests").is_dir():
        parser.error("a stage is a part of the project: call this in a clone that is installed with pip install -e")
    files = {template: folder / target.replace("NAME", name) for template, target in kind.files.items()}
    text = registry.read_text(encoding="utf-8") if options.kind == "stage" else ""
    package = folder / "pipeline/stages" / name  # would hide the stage's module
    taken = [path for path in (*files.values(), package) if path.exists()]
    if taken or f'    "{name}": (' in text:
        parser.error(f"{taken[0] if taken else f'a stage {name!r}'} is there already: choose another name")
    if options.kind != "stage" and importlib.util.find_spec(name) is not None:
        parser.error(f"{name!r} is an installed module, which {name}.py would hide: choose another name")
    title = "".join(part.capitalize() for part in name.split("_"))
    for template, path in files.items():
        content = Path(__file__).with_name(f"{template}.txt").read_text(encoding="utf-8")
        write_text(path, content.replace("TITLE", title).replace("NAME", name))
        say(str(prefix / path.relative_to(folder)))
    if options.kind == "stage":
        line = f'    "{name}": ("{name}", "{name}:{title}Settings"),\n'
        write_text(registry, text.replace(_REPORT, line + _REPORT))
        say(f"{prefix / _REGISTRY}: the stage is registered before the report")
    place = f"cd {shlex.quote(str(folder))} && " if prefix == folder else ""
    say(f"run it: {place}{kind.run.replace('NAME', name)}\ntest it: {place}{kind.test.replace('NAME', name)}")
    if options.kind == "stage":
        say("before make check: give it a row in the table of docs/pipeline/stages.md")
    return 0
