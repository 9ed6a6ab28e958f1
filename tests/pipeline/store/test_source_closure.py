"""Sources behind a stage: imports of every kind are followed, and what a stage really loads is among them."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from pipeline.stages import available_stages, load_stage, stage_module
from pipeline.store import source_closure
from pipeline.store.source_closure import SourceClosure, installed_packages, is_without_effect
from pipeline.store.user_cache import user_cache

TREE = {
    "__init__.py": "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from tree import typed\n"
    "import tree.eager\n"
    "_HOME = {'Lazy': 'lazy', 'Full': 'tree.full', 'Other': 'other'}\n"
    "def __getattr__(name):\n    import importlib\n    return importlib.import_module(f'tree.{_HOME[name]}')\n",
    "main.py": "import os\nfrom tree import Lazy\nimport tree as t\nfrom . import sibling\n"
    "from tree.assigned import Deep\n"
    "from .sub.deep import thing\n"
    "from tree.table import run\njobs = [run]\nPRELOAD = ('tree.preloaded', 'no.module')\n"
    "def f():\n    from tree import inside\n    import tree.sub.late\n    return t.Full\n"
    "def g():\n    import importlib\n    return importlib.import_module('tree.named')\n"
    "if TYPE_CHECKING:\n    from tree import typed\nelse:\n    from tree import untyped\n",
    "assigned/__init__.py": "_HOME = {'Deep': 'deep', 'Unused': 'unused'}\n__getattr__ = lazy_names(__name__, _HOME)\n",
    "assigned/deep.py": "",
    "assigned/unused.py": "",
    "sub/__init__.py": "",
    "sub/deep.py": "from ..up import x\nfrom .beside import *\n",
    "sub/late.py": "'''tree.mentioned in a docstring is no import: see tree.typed'''\n",
    "sub/beside.py": "",
    "native.py": "from pathlib import Path\nHOME = Path(__file__).parent\nSOURCES = HOME / 'csource'\n",
    "full.py": "import tree.native\nfrom pathlib import Path\nPAGE = Path(__file__).with_name('page.html.j2')\n",
    "csource/kernel.c": "int x;",
    "csource/kernel.so": "built",
    "page.html.j2": "<p>",
    "notes.md": "named by nobody",
    **{f"{name}.py": "" for name in (
        "eager", "lazy", "other", "typed", "untyped", "sibling", "up", "table", "preloaded", "inside", "named",
        "unused",
    )},
}  # fmt: skip


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    for name, text in TREE.items():
        file = tmp_path / "tree" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    return tmp_path / "tree"


def test_every_kind_of_import_is_followed(tree: Path) -> None:
    closure = SourceClosure(roots={"tree": tree})
    reached = {name.removeprefix("tree").lstrip(".") for name in closure.modules("tree.main")}
    assert reached == {
        "", "main", "eager", "lazy", "full", "sibling", "sub", "sub.deep", "sub.late", "sub.beside", "up", "table",
        "preloaded", "inside", "named", "untyped", "native", "assigned", "assigned.deep",
    }  # fmt: skip
    files = set(closure.files("tree.main"))
    assert {name for name in files if not name.endswith(".py")} == {"tree/csource/kernel.c", "tree/page.html.j2"}
    with pytest.raises(ModuleNotFoundError, match=r"tree\.nothing"):
        closure.modules("tree.nothing")


@pytest.mark.parametrize("cached", [False, True])
def test_the_hash_follows_edits_of_what_is_reached_alone(tree: Path, cached: bool, tmp_path: Path) -> None:
    time.sleep(0.12)  # so that files are old enough to be remembered
    cache = tmp_path / "sources.json" if cached else None

    def now() -> str:
        return SourceClosure(cache, {"tree": tree}).hash("tree.main")

    first = now()
    assert now() == first
    for name in ("unused.py", "typed.py", "other.py", "notes.md", "csource/kernel.so"):
        (tree / name).write_text("x = 1")
        assert now() == first, name
    for name in ("main.py", "sub/late.py", "up.py", "table.py", "csource/kernel.c", "page.html.j2", "__init__.py"):
        (tree / name).write_text((tree / name).read_text() + "\n")
        assert now() != first, name
        first = now()
    (tree / "up.py").write_text("from tree.unused import x")
    first = now()
    (tree / "unused.py").write_text("y = 2")
    assert now() != first
    (tree / "csource" / "more.c").write_text("int y;")
    assert now() != first


@pytest.fixture(scope="module")
def copied(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The project's own packages, to be edited."""
    folder = tmp_path_factory.mktemp("copy")
    for name, root in installed_packages().items():
        shutil.copytree(root, folder / name, ignore=shutil.ignore_patterns("__pycache__", "*.so"))
    return {name: folder / name for name in installed_packages()}


# file -> stages that its edit puts out of date, of those that are looked at
EDITS = {
    "guide3d/native/matching.c": {"guide3d", "navigation"},
    "guide3d/native_library.py": {"guide3d", "navigation"},
    "cathsim/native/step.c": {"phantoms", "expert", "enn", "force", "guide3d", "navigation"},
    "cathsim/devices/presets/guidewires/default.yaml": {"expert", "enn", "force", "guide3d", "navigation"},
    "cathsim/environment.py": {"expert", "enn", "force", "navigation"},
    "enn/networks/network.py": {"enn", "force", "navigation"},
    "enn/imitation/behaviour_cloning.py": {"force", "navigation"},
    "pipeline/recording/record.py": {"expert", "enn", "force", "navigation"},
    "pipeline/episodes/encoding/step_codec.py": {"expert", "enn", "force", "navigation", "report"},
    "cathsim/viewing/film.py": {"expert", "navigation"},
    "pipeline/stages/learning/task.py": {"enn", "force", "navigation"},
    "splineformer/tokens.py": {"navigation"},
    "pipeline/report/page/page.html.j2": {"report"},
    "pipeline/report/page/page.css": {"report"},
    "pipeline/report/headlines.yaml": {"report"},
    "pipeline/report/thesis.yaml": {"report"},
    "pipeline/store/atomic_files.py": {"phantoms", "expert", "enn", "force", "guide3d", "navigation", "report"},
    "pipeline/store/progress.py": set(),
}
LOOKED_AT = ("phantoms", "expert", "enn", "force", "guide3d", "navigation", "report")


@pytest.mark.parametrize("edited", list(EDITS))
def test_an_edit_puts_stages_out_of_date(edited: str, copied: dict[str, Path]) -> None:
    def hashes() -> dict[str, str]:
        closure = SourceClosure(copied["cathsim"].parent / "sources.json", copied)
        return {stage: closure.hash(stage_module(stage)) for stage in LOOKED_AT}

    before = hashes()
    file = copied[edited.partition("/")[0]].parent / edited
    text = file.read_text()
    file.write_text(text + "\n")
    after = hashes()
    file.write_text(text)
    changed = {stage for stage in LOOKED_AT if after[stage] != before[stage]}
    assert changed >= EDITS[edited]
    if edited.startswith(("pipeline/report/", "pipeline/progress", "splineformer", "guide3d/native")):
        assert changed == EDITS[edited]


TINY = {
    "phantoms": "phantoms=['type_1'], resolution_mm=2.5",
    "report": "",
    "guide3d": "images=8, pairs=1, targets=['bca'], image_size_px=256, distorted=True",
    "force": "targets=['bca'], samples=[12], test_samples=12, epochs=1, inputs=['V'], noise=0.5, task=TASK.task",
}


@pytest.mark.parametrize("stage", list(TINY))
def test_what_a_stage_really_loads_is_among_its_sources(
    stage: str, tmp_path: Path, run_python: Callable[[str], str]
) -> None:
    told = run_python(f"""
import json, sys
from pathlib import Path
from pipeline.stages import load_stage
from tests.pipeline.stages.small_expert import TASK, context, in_this_process, write_expert
run = Path({str(tmp_path)!r})
if {stage!r} == "force":
    write_expert(run / "enn", episodes=1)
prepared = set(sys.modules)
stage = load_stage({stage!r})
module = sys.modules[{stage_module(stage)!r}]
if hasattr(module, "run_jobs"):
    module.run_jobs = in_this_process
stage.run(stage.settings({TINY[stage]}), context(run, {stage!r}, stage.reads))
print(json.dumps([n for n in sorted(sys.modules) if n.split(".")[0] in
                  ("pipeline", "cathsim", "enn", "guide3d", "splineformer") and n not in prepared]))
""")
    loaded = set(json.loads(told.splitlines()[-1]))
    assert stage_module(stage) in loaded
    known = source_closure.source_closure().modules(stage_module(stage))
    assert sorted(name for name in loaded - known if not is_without_effect(name)) == []
    assert load_stage(stage).settings.__module__ in known


def test_every_stage_has_sources_and_a_second_look_reads_none_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cache = tmp_path / "sources.json"
    first = {stage: SourceClosure(cache).hash(stage_module(stage)) for stage in available_stages()}
    assert len(set(first.values())) == len(available_stages())

    def parsed(text: str, name: str, *, is_package: bool) -> dict[str, Any]:
        raise AssertionError(f"{name} was read again")

    monkeypatch.setattr(source_closure, "references", parsed)
    assert {stage: SourceClosure(cache).hash(stage_module(stage)) for stage in available_stages()} == first


@pytest.mark.parametrize("place", ["a folder", "a file in its place", "below a file"])
def test_all_runs_share_the_users_cache_and_do_without_one(
    place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cache = tmp_path / "cache"
    if place != "a folder":
        cache.write_text("no folder")
    monkeypatch.setenv("ENDONAV_CACHE", str(cache / "below" if place == "below a file" else cache))
    assert source_closure.source_closure().hash("pipeline.seeds") == SourceClosure().hash("pipeline.seeds")
    if place == "a folder":
        monkeypatch.setattr(source_closure, "references", None)  # none is read again
        assert source_closure.source_closure().hash("pipeline.seeds")
    else:
        assert cache.read_text() == "no folder"


def test_the_users_cache_is_where_caches_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert user_cache().parent != tmp_path
    monkeypatch.delenv("ENDONAV_CACHE")
    assert user_cache() == tmp_path / "endonav"
