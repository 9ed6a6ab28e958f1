"""The report: complete against the thesis, honest about what has not run, readable by people and programs."""

import csv
import io
import json
import re
import time
from html.parser import HTMLParser
from pathlib import Path

import pytest
import yaml

from pipeline.store.provenance import PROJECT_ROOT
from pipeline.store.run_folder import Identity, RunFolder
from pipeline.tables import Figure, write_figures, write_results
from tests.pipeline.report.full_run import add_full_run

THESIS = yaml.safe_load((PROJECT_ROOT / "pipeline" / "report" / "thesis.yaml").read_text())["tables"]
PNG = bytes.fromhex("89504e470d0a1a0a0000000d49484452000000010000000108060000001f15c4890000000d49444154789c6360606060"
                    "00000005000157a5c4a40000000049454e44ae426082")  # fmt: skip
EXPERT = {
    "force_n": [0.12, 0.04], "path_length_cm": [16.2, 0.8], "episode_length_steps": [92.3, 12.1],
    "safety_pct": [88, 3], "success_pct": [100, 0], "spl_pct": 93.1, "n": 20,
}  # fmt: skip


class Page(HTMLParser):
    """Collects what the tests ask about a page: ids, cells of each table section, addresses it would load."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.sections: dict[str, list[str]] = {}
        self.addresses: list[str] = []
        self._section, self._in_cell = "", False
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        named = dict(attrs)
        if tag == "section":
            self._section = named.get("id") or ""
            self.sections[self._section] = []
        if tag in ("td", "th") and self._section:
            self.sections[self._section].append("")
            self._in_cell = True
        self.addresses += [v for k, v in attrs if k in ("src", "href") and v]

    def handle_endtag(self, tag: str) -> None:
        self._in_cell = self._in_cell and tag not in ("td", "th")
        if tag == "section":
            self._section = ""

    def handle_data(self, data: str) -> None:
        if self._in_cell:
            self.sections[self._section][-1] += data.strip()


def add_expert(run: Path, *, figure_bytes: bytes = PNG) -> None:
    """Leaves in a run what a finished expert stage leaves."""
    folder = RunFolder(run / "expert", Identity("c", {}, 1))
    with folder.locked():
        folder.prepare()
        (folder.path / "force.png").write_bytes(figure_bytes)
        tables = {"ablation": {"bca/sampling_expert": EXPERT}, "own_table": {"row": {"value_mm": 1.5}}}
        write_results(folder.path, tables)
        write_figures(folder.path, [Figure("Contact force", "Over one episode.", "force.png")])
        folder.finish(stage="expert", run=run.name, budget="smoke", seed=7, config={}, started=time.monotonic() - 63)


@pytest.fixture(scope="module")
def empty_report(tmp_path_factory):
    return run_report(tmp_path_factory.mktemp("runs"), "empty")


@pytest.fixture(scope="module")
def expert_report(tmp_path_factory):
    runs = tmp_path_factory.mktemp("runs")
    add_expert(runs / "tried")
    return run_report(runs, "tried", budget="smoke")


def run_report(runs: Path, name: str, budget: str = "desk", **settings: float) -> Path:
    """Runs the report stage in this process.

    Returns:
        The report's folder.
    """
    from pipeline.config import RunConfig
    from pipeline.execution import execute
    from pipeline.stages.report import ReportSettings

    stage = ReportSettings(**settings)
    execute(RunConfig(stage=stage, budget={"name": budget}, name=name, runs_dir=str(runs)))
    return runs / name / "report"


def test_every_thesis_table_and_row_is_on_the_page(empty_report: Path) -> None:
    page = Page((empty_report / "index.html").read_text())
    expected = {key for key, table in THESIS.items() if table.get("kind") != "own"}
    assert expected <= set(page.sections)
    for key in expected:
        numbers = [cell for cells in THESIS[key]["rows"].values() for cell in cells if isinstance(cell, list)]
        for mean, _ in numbers:
            assert any(re.match(rf"-?{abs(mean):g}", cell) for cell in page.sections[key]), (key, mean)
        assert len(page.sections[key]) >= len(THESIS[key]["rows"]) * len(THESIS[key]["columns"])
    assert "0.011 ± 0.021" in page.sections["cathsim_results"]
    assert "162.55 ± 106.85" in page.sections["ablation"]
    assert "6.88 ± 5.23" in page.sections["shape_prediction_mm"]
    assert "0.5047" in page.sections["force_prediction_mse"]
    assert "8746" in page.sections["guide3d_composition"]


def test_what_has_not_run_is_shown_so(empty_report: Path) -> None:
    text = (empty_report / "index.html").read_text()
    assert text.count("not run") > len(Page(text).sections) / 2
    assert "<b>" not in "".join(re.findall(r'<section class="table" id="ablation">.*?</section>', text, re.DOTALL))
    for stage in ("Phantoms", "Sampling expert", "Baselines", "Autonomous navigation"):
        assert re.search(rf'class="blank"><th scope="row">{stage}</th><td colspan="7">not run', text)
    measured = json.loads((empty_report / "metrics.json").read_text())
    assert measured["ablation"]["bca/I+V+M"] == dict.fromkeys(THESIS["ablation"]["columns"])


def test_measured_values_stand_beside_the_thesis(expert_report: Path) -> None:
    page = Page((expert_report / "index.html").read_text())
    cells = page.sections["ablation"]
    row = cells[cells.index("Sampling expert") :][: 1 + 8 + 1]
    measured = ["0.12 ± 0.04", "16.20 ± 0.80", "92.30 ± 12.10", "88 ± 3", "100 ± 0", "93"]
    assert row == ["Sampling expert", *measured, "", "", "20"]  # logs before said nothing of the lumen
    assert "162.55 ± 106.85" in cells
    assert cells.index("Sampling expert") < cells.index("LCCA")  # within its group
    assert "own_table" in page.sections
    measured = json.loads((expert_report / "metrics.json").read_text())
    assert measured["ablation"]["bca/sampling_expert"] == {**EXPERT, "success_lumen_pct": None, "depth_mm": None}
    assert measured["own_table"]["row"] == {"value_mm": 1.5}
    assert measured["environment"]["python"]["value"]


def test_no_key_and_no_paragraph_is_on_the_page(tmp_path: Path) -> None:
    add_full_run(tmp_path / "full")
    text = (run_report(tmp_path, "full") / "index.html").read_text()
    # a stranger is told what it is, and where to go, before any table
    parts = ["<h1>EndoNav", "<nav", '<div class="page" id="headlines"', '<div class="page" id="film"', "<main"]
    assert sorted(parts, key=text.index) == parts
    page = Page(text)
    words = re.sub(r"<(style|script).*?</\1>|<[^>]*>", " ", text, flags=re.DOTALL)
    assert set(re.findall(r"\w*[a-z]_\w+|\bch\dtab:\S+", words)) <= {"dm_control"}  # a package
    assert max(len(cell) for cells in page.sections.values() for cell in cells) <= 60 + len("162.55 ± 106.85")
    lead = r"17 headline results this run measured 15\.\s+2 of them measure the same thing as the thesis:"
    assert re.search(lead, words)
    assert text.count('class="verdict unlike"') == 13


def test_page_needs_no_network_and_its_links_exist(expert_report: Path) -> None:
    page = Page((expert_report / "index.html").read_text())
    assert any(address.startswith("data:image/png;base64,") for address in page.addresses)
    for address in page.addresses:
        assert not re.match(r"(https?:)?//", address)
        if not address.startswith(("data:", "#")):
            assert (expert_report / address).is_file(), address
    assert "@import" not in (expert_report / "index.html").read_text()


def test_provenance_names_budget_seed_and_time_and_smoke_runs_warn(expert_report: Path, empty_report: Path) -> None:
    text = (expert_report / "index.html").read_text()
    assert "Its numbers mean nothing" in text
    assert "Its numbers mean nothing" not in (empty_report / "index.html").read_text()
    row = r'<th scope="row">Sampling expert</th><td[^>]*>smoke</td><td[^>]*>7</td><td[^>]*>1 min 3 s</td>'
    assert re.search(row, text)
    assert "hydra-core" in text


def test_tables_are_written_as_csv_and_latex(expert_report: Path) -> None:
    for key in json.loads((expert_report / "metrics.json").read_text()):
        rows = list(csv.reader(io.StringIO((expert_report / "tables" / f"{key}.csv").read_text())))
        assert len({len(row) for row in rows}) == 1
        latex = (expert_report / "tables" / f"{key}.tex").read_text()
        assert latex.count(r"\begin{") == latex.count(r"\end{") == 2
        assert not re.search(r"(?<!\\)[%#_]", re.sub(r"\\label\{[^}]*\}", "", latex))


def test_report_is_up_to_date_until_a_large_figure_comes(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    for _ in range(2):
        run_report(tmp_path, "tried", embed_limit_mb=0.001)
    assert caplog.text.count("report: up to date") == 1
    add_expert(tmp_path / "tried", figure_bytes=PNG + bytes(3000))
    report = run_report(tmp_path, "tried", embed_limit_mb=0.001)
    assert "sampling_expert" in (report / "metrics.json").read_text()
    assert (report / "figures" / "expert" / "force.png").read_bytes() == PNG + bytes(3000)
    assert "figures/expert/force.png" in Page((report / "index.html").read_text()).addresses
