"""The documentation runs: the notebook from top to bottom, kept with its outputs, and the pages' blocks of Python."""

import ast
import dataclasses
import importlib.util
import json
import os
import re
import tomllib
from pathlib import Path
from typing import Any
from urllib.parse import urlparse

import numpy as np
import pytest

from enn.fitting import EpisodeFitSettings
from pipeline.evaluations.tables import tables_from_logs
from tests.guide3d.learning.drawn_data import draw
from tests.pipeline.stages.small_expert import write_expert

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
NOTEBOOK = DOCS / "tutorial.ipynb"
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.DOTALL | re.MULTILINE)
# The first records a log, which the report reads; training leaves a policy, which imitation reads on the same page.
PAGES = (
    "pipeline/logs.md", "guide3d/dataset.md", "guide3d/reading.md",
    "guide3d/networks.md", "splineformer/network.md", "splineformer/navigation.md", "enn/policies.md",
    "enn/training.md", "getting_started.md",
)  # fmt: skip
# Each is run by itself.
ALONE = (DOCS / "conventions.md", ROOT / "packages/cathsim/README.md", *sorted((DOCS / "cathsim").glob("*.md")))


@pytest.fixture(scope="module")
def notebook() -> dict[str, Any]:
    return json.loads(NOTEBOOK.read_text(encoding="utf-8"))


def code_cells(notebook: dict[str, Any]) -> list[dict[str, Any]]:
    """All but the first, which installs the project where it is missing."""
    install, *cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert install["id"] == "install"
    return cells


def test_in_colab_it_installs_this_repository_s_packages(notebook: dict[str, Any]) -> None:
    address = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["urls"]["Repository"]
    text = "".join(notebook["cells"][0]["source"])
    assert f"(https://colab.research.google.com/github{urlparse(address).path}/blob/main/docs/tutorial.ipynb)" in text
    install = "".join(notebook["cells"][1]["source"])
    assert f"git clone --quiet --depth 1 {address}\n" in install
    named = re.findall(r'"(\w+)(?:\[\w+\])?"', install.partition("folders = ")[2].partition("]\n")[0])
    assert set(named) == {path.name for path in (ROOT / "packages").iterdir() if (path / "pyproject.toml").is_file()}


def test_the_script_that_runs_it_keeps_what_a_kernel_shows(tmp_path: Path) -> None:
    specification = importlib.util.spec_from_file_location("run_notebook", DOCS / "run_notebook.py")
    script = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(script)
    source = "import matplotlib.pyplot as plt\nplt.plot([1, 2])\nprint('two', 3)\n[1, 2]"
    printed, figure, value = script.run_cell(source, {})
    assert printed["text"] == ["two 3\n"]
    assert figure["data"]["image/png"].startswith("iVBORw0KGgo")
    assert value["data"]["text/plain"] == ["[1, 2]"]
    assert script.run_cell("x = 1", {}) == []


def test_every_cell_runs(
    notebook: dict[str, Any], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    monkeypatch.setattr(plt, "show", lambda: None)
    plt.close("all")
    names: dict[str, Any] = {"__name__": "notebook"}
    for cell in code_cells(notebook):
        source = "".join(cell["source"])
        # as a kernel does: the last expression's value is shown
        exec(compile(ast.parse(source), f"{NOTEBOOK.name}:{cell['id']}", "exec"), names)
    pictures = len(plt.get_fignums())
    plt.close("all")

    assert pictures == 2
    assert names["metrics"].success
    assert len(names["arrays"]["tip"]) == names["metrics"].steps + 1
    assert set(names["ends"]) == {"rcca_end", "rsa_end", "lcca_end", "lsa_end"}
    printed = capsys.readouterr().out
    assert "reached after" in printed
    assert "too short for rcca_end" in printed
    # the tip's projection falls on the wire's shadow: darker than the mean of the picture
    u, v = (round(float(names[axis][0])) for axis in "uv")
    assert names["image"][v, u] < names["image"].mean()
    names["folder"].cleanup()
    assert not os.path.exists(names["path"])


def test_every_page_s_blocks_are_run() -> None:
    pages = {page.relative_to(DOCS).as_posix() for page in DOCS.rglob("*.md") if BLOCK.search(page.read_text())}
    assert pages - {page.relative_to(DOCS).as_posix() for page in ALONE if DOCS in page.parents} == {*PAGES}


@pytest.mark.parametrize("page", ALONE, ids=lambda page: page.stem)
def test_a_page_that_stands_alone_holds(page: Path) -> None:
    if page.stem == "mujoco":
        pytest.importorskip("dm_control")
    text = page.read_text(encoding="utf-8")
    names: dict[str, Any] = {"__name__": page.stem}
    for block in BLOCK.finditer(text):
        # the empty lines make a traceback point at the line of the document
        exec(compile("\n" * text[: block.start(1)].count("\n") + block[1], str(page), "exec"), names)
    if page.stem == "conventions":
        assert len(re.findall(r"^\s*assert ", "".join(BLOCK.findall(text)), re.MULTILINE)) > 40


# What takes minutes on a page, and seconds here.
SMALLER = {
    "30_000": "400",
    "decisions=4000": "decisions=64, evaluation_episodes=1",
    "decisions=3000": "decisions=64, evaluation_episodes=1",
    "held_out_seeds(0, 30)": "held_out_seeds(0, 1)",
    "range(100)": "range(2)",
    "DESK_CLONING, make": "dataclasses.replace(DESK_CLONING, fit=EpisodeFitSettings(epochs=1)), make",
    'seed=0, folder="cloning")': 'seed=0, folder="cloning", disturbed_seeds=range(2))',
}


def quick(block: str, used: set[str]) -> str:
    for large, small in SMALLER.items():
        if large in block:
            used.add(large)
            block = block.replace(large, small)
    return block


def test_the_blocks_of_the_pages_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    results: dict[str, dict[str, Any]] = {}
    used: set[str] = set()
    write_expert(Path("runs/desk/enn"), episodes=0)
    draw(Path("runs/desk/guide3d/dataset"))
    frames = {f"frame{k}": np.full((1024, 1024), 150, np.uint8) for k in range(3)}
    for page in (*PAGES, "../README.md", "../packages/enn/README.md"):
        blocks = BLOCK.findall((DOCS / page).read_text(encoding="utf-8"))
        assert blocks, page
        results[page] = {
            "__name__": page,
            "EpisodeFitSettings": EpisodeFitSettings,
            "dataclasses": dataclasses,
            **frames,
        }
        for block in blocks:
            exec(compile(quick(block, used), page, "exec"), results[page])
    logged = results["pipeline/logs.md"]
    assert logged["force"].shape == (41,)
    assert logged["P"].shape == (3, 4)
    assert logged["mask"].shape == logged["image"].shape
    assert used == set(SMALLER)
    assert results["getting_started.md"]["policy"].keys == ("roadmap", "history")
    assert results["enn/policies.md"]["own"].keys == ("offset", "shape", "feeder")
    assert results["enn/training.md"]["policy"].keys == ("image",)
    assert list(tables_from_logs(Path("runs/desk"))["baselines"]) == ["type_1/bca/mine"]
    assert results["guide3d/networks.md"]["mask"].shape == (1024, 1024)
    assert len(results["guide3d/dataset.md"]["data"].frames) == 24
