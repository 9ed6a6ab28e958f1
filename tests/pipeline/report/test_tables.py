"""Tables, headlines and figures of the report: cells, sweeps, seeds, layout, the thesis beside them; runs compared."""

import math
import re
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image

from benchmarks.pipeline.compare_tables import compare as compare_runs
from benchmarks.pipeline.compare_tables import direction
from pipeline.plots.words import column_words, group_words, in_words, place_in_thesis, row_words
from pipeline.report.comparison import NOT_MEASURED, PAGE, comparisons, rendered
from pipeline.report.figures import ShownFigure, gather_figures
from pipeline.report.headlines import BETTER, EQUAL, OPEN, UNLIKE, WORSE, compare, headline_specs, headlines
from pipeline.report.intervals import OverSeeds, difference_of_shares, mean_interval, over_seeds, share_interval
from pipeline.report.page import BEYOND, arrange, choose_film, render_page
from pipeline.report.tables import as_csv, as_latex, format_over_seeds, join_sweep, metrics, report_tables
from pipeline.store.provenance import PROJECT_ROOT
from pipeline.tables import (
    Cell,
    Figure,
    Table,
    check_cell,
    format_cell,
    pool,
    read_figures,
    write_figures,
    write_results,
)

THESIS = yaml.safe_load((PROJECT_ROOT / "pipeline" / "report" / "thesis.yaml").read_text())["tables"]


def test_tables_match_the_transcribed_figures() -> None:
    """Spot checks against the thesis's own tables, a cell or two a table."""
    rows = {key: table["rows"] for key, table in THESIS.items()}
    assert rows["ablation"]["lcca/I+V+M"] == [[2.26, 0.33], [14.85, 0.79], [33.77, 5.33], [45, 5], [100, 0], 100]
    assert rows["cathsim_results"]["type_2/sac_sequential"][-2:] == [3, 0]
    assert rows["imitation"]["bca/image_w_enn"][2] == [43.40, 1.50]
    assert rows["training_time_h"]["enn"] == [[4.61, 0.22], [4.83, 0.41]]
    assert rows["segmentation"]["transunet"] == [95.06, 41.20, 91.10]
    assert rows["navigation"]["splineformer"][2:4] == [50.0, 150.0]
    composition = rows["guide3d_composition"]
    both = zip(composition["radifocus_angled"], composition["nitrex_straight"], strict=True)
    assert [sum(pair) for pair in both] == composition["total"]


def test_sweep_jobs_are_joined_cell_by_cell_but_not_those_with_other_settings() -> None:
    joined = join_sweep([{"t": {"r": {"x": 1.0}}}, {"t": {"r": {"y": 2.0}, "s": {"x": 3.0}}}])
    assert joined == {"t": {"r": {"x": 1.0, "y": 2.0}, "s": {"x": 3.0}}}
    parts = [{"t": {"r": {"x": share, "n": 3}}} for share in (100.0, 20.0)]
    joined = join_sweep([{}, *parts], ["", "target=bca", "phantom.file=a/b.stl"])
    assert joined == {"t": {"r (target=bca)": {"x": 100.0, "n": 3}, "r (phantom.file=a·b.stl)": {"x": 20.0, "n": 3}}}
    assert join_sweep(parts, ["", ""])["t"]["r"] == {"x": [60.0, 40.0], "n": 6}  # two seeds of three trials
    shared = [{"task": {"limit": {"value": 300}}}] * 2
    assert join_sweep(shared, ["target=bca", "target=lcca"]) == shared[0]
    parts = [{"t": {"r": {"max_ed": [1.0, 0.5], "epochs": 30, "n": 40}}}] * 2
    assert join_sweep(parts)["t"]["r"]["n"] == 80  # of the samples


@pytest.mark.parametrize(
    ("cell", "decimals", "expected"),
    [(None, None, ""), ("text", 2, "text"), ([0.1234, 0.05], None, "0.123 ± 0.050"), ([-70, 28], 0, "-70 ± 28"),
     (590080, None, "590,080"), (0.0003, None, "0.0003"), (93.14, 0, "93"), (7.0, None, "7")],
)  # fmt: skip
def test_cells_are_worded(cell: object, decimals: int | None, expected: str) -> None:
    assert format_cell(cell, decimals) == expected  # type: ignore[arg-type]


def test_csv_and_latex_hold_both_sides_and_figures_over_seeds_follow() -> None:
    table = next(t for t in report_tables({"ablation": {"bca/H": {"force_n": [0.5, 0.1]}}}) if t.key == "ablation")
    assert as_csv(table).splitlines()[1].startswith("bca/H,1.02 ± 0.22,0.50 ± 0.10,28.82 ± 11.80,,")
    assert r"H & 1.02 $\pm$ 0.22 & 0.50 $\pm$ 0.10 & 28.82 $\pm$ 11.80 & --" in as_latex(table)
    assert metrics([table])["ablation"]["bca/H"]["force_n"] == [0.5, 0.1]
    force = OverSeeds([0.5, 0.0816], 3)
    measured = {"ablation": {"bca/H": {"force_n": [0.5, 0.1]}, "bca/V": {"force_n": [0.4, 0.1]}}}
    tables = report_tables(measured, {("ablation", "bca/H", "force_n"): force})
    table = next(t for t in tables if t.key == "ablation")
    head, first, second = as_csv(table).splitlines()[:3]
    assert head.endswith(",samples,force_n_seeds_mean,force_n_seeds_low,force_n_seeds_high")
    assert first.endswith(",0.50,0.25,0.75")
    assert second.endswith(",,,")
    assert format_over_seeds(force, 2) == "3 seeds: 0.50 (0.25 to 0.75)"
    written = metrics([table])["ablation"]["bca/H"]["over_seeds"]["force_n"]
    assert (written["mean"], written["seeds"]) == (0.5, 3)
    assert "over_seeds" not in metrics([table])["ablation"]["bca/V"]


def test_every_seed_counts_alike_and_settings_do_not() -> None:
    """Means 80, 90 and 100: 4.303 (t of 2 degrees) times 10 / sqrt(3) either way."""
    parts = {
        seed: {"t": {"r": {"success_pct": [mean, 40.0], "n": 30 * (seed + 1), "epochs": 20, "kind": "a"}}}
        for seed, mean in enumerate((80.0, 90.0, 100.0))
    }
    parts[2]["t"]["other"] = {"success_pct": 5.0}  # of one seed alone
    found = over_seeds(parts)
    assert set(found) == {("t", "r", "success_pct")}
    one = found["t", "r", "success_pct"]
    assert (one.cell[0], one.seeds) == (90.0, 3)
    assert one.interval == (pytest.approx(90 - 24.84, abs=0.01), 100.0)  # a share is cut off
    assert OverSeeds(one.cell, 3).interval[1] == pytest.approx(90 + 24.84, abs=0.01)
    of_a_target = {seed: {"t": {"r": {"bca_success_pct": mean}}} for seed, mean in enumerate((80.0, 90.0, 100.0))}
    assert over_seeds(of_a_target)["t", "r", "bca_success_pct"].interval[1] == 100.0
    assert over_seeds({0: {"t": {"r": {"c": 1.0}}}}) == over_seeds({}) == {}
    with pytest.raises(ValueError, match="needs two of them, got 1"):
        _ = OverSeeds([1.0, 0.0], 1).interval


def run(**cells: Cell) -> dict[str, Table]:
    return {"trials": {"bca": {"n": 50, **cells}}}


@pytest.mark.parametrize(
    ("columns", "expected"),
    [
        (("success_pct", "bca_success_pct"), 1),
        (("force_n", "tip_px", "mse_n2"), -1),
        (("interval_pct", "image_px", "minutes", "success_low_pct"), 0),
    ],
)
def test_what_is_better(columns: tuple[str, ...], expected: int) -> None:
    assert {direction(column) for column in columns} == {expected}


def test_cells_beyond_their_interval_in_every_earlier_run_are_told() -> None:
    earlier = run(success_pct=98.0, force_n=[0.05, 0.02], mse_n2=1.0, minutes=3.0, word="default")
    found = compare_runs([earlier, run(success_pct=70.0, force_n=[0.03, 0.02], mse_n2=1.2, minutes=9.0)], 1.1)
    assert found.worse == ["trials | bca | success_pct: 98, now 70"]
    assert found.better == ["trials | bca | force_n: 0.0500 ± 0.0200, now 0.0300 ± 0.0200"]
    assert found.alone_worse == ["trials | bca | mse_n2: 1, now 1.2"]
    assert (found.compared, found.alone, found.missing) == (2, 1, [])
    within = compare_runs([earlier, run(success_pct=90.0, force_n=[0.055, 0.02], mse_n2=1.05)], 1.1)
    assert not within.worse + within.better + within.alone_worse
    good, bad, new = (run(success_pct=share) for share in (98.0, 60.0, 70.0))
    assert compare_runs([good, new], 1.1).worse
    assert not compare_runs([good, bad, new], 1.1).worse
    assert compare_runs([bad, good, run(success_pct=20.0)], 1.1).worse
    assert compare_runs([run(success_pct=98.0), {}], 1.1).missing == ["trials | bca | success_pct"]


MEASURED = {
    "ablation": {"bca/I+V+M": {"success_pct": [90.0, 30.0], "n": 30}},
    "enn": {"type_1/bca/I+V+M": {"success_pct": 90.0, "n": 30}},
    "expert": {"type_1/bca": {"success_pct": [100.0, 0.0], "n": 3}},
    "generalisation": {"roadmap/bca/unseen": {"success_pct": 70.0, "n": 30}},
}


def figure(title: str, stage: str, *, film: bool = False, width: int = 1400) -> ShownFigure:
    return ShownFigure(title, "", "", "data:,", "image/png", stage=stage, size=(width, 800), is_film=film)


def test_every_table_stands_in_one_place() -> None:
    tables = report_tables(MEASURED)
    chapters = arrange(tables, [])
    placed = [table.key for chapter in chapters for table in (*chapter.settings, *chapter.not_run)]
    blocks = [block for chapter in chapters for block in chapter.blocks]
    placed += [table.key for block in blocks for table in (*block.tables, *block.detail)]
    assert sorted(placed) == sorted(table.key for table in tables)
    by_title = {chapter.title: chapter for chapter in chapters}
    enn = next(block for block in by_title["ENN"].blocks if block.stage == "enn")
    assert [table.key for table in enn.tables] == ["ablation"]
    assert [table.key for table in enn.detail] == ["enn"]
    assert "imitation" in [table.key for table in by_title["ENN"].not_run]
    unseen, expert = (next(b for b in by_title[BEYOND].blocks if b.stage == name) for name in ("unseen", "expert"))
    assert [table.key for table in unseen.tables] == ["generalisation"]
    assert expert.is_folded
    assert not expert.tables


def test_the_expert_is_open_where_it_is_alone_and_more_than_two_figures_are_folded() -> None:
    tables = report_tables({"expert": MEASURED["expert"]})
    (block,) = (b for chapter in arrange(tables, [figure("paths", "expert")]) for b in chapter.blocks)
    assert [table.key for table in block.tables] == ["expert"]
    assert [one.title for one in block.beside] == ["paths"]
    shown = [figure("wide", "enn", width=3000), *(figure(name, "enn") for name in "abc")]
    shown.append(figure("film", "enn", film=True))
    blocks = [b for chapter in arrange(report_tables(MEASURED), shown) for b in chapter.blocks if b.stage == "enn"]
    assert [one.title for one in blocks[0].beside] == ["a", "b"]
    assert [one.title for one in blocks[0].further] == ["wide", "c", "film"]
    films = [figure("expert", "expert", film=True), figure("navigation", "navigation", film=True)]
    assert choose_film(films) is films[1]
    assert choose_film([figure("picture", "expert")]) is None


def test_figures_beyond_the_page_s_bytes_lie_beside_it(tmp_path: Path) -> None:
    stage, report = tmp_path / "learning", tmp_path / "report"
    stage.mkdir()
    for name, width in (("a", 1900), ("b", 300)):
        noise = np.random.default_rng(0).integers(0, 256, (40, width), dtype=np.uint8)
        Image.fromarray(noise).save(stage / f"{name}.png")
    write_figures(stage, [Figure("A", "", "a.png"), Figure("B", "", "b.png")])
    wide, narrow = gather_figures("learning", stage, report, embed_limit=10**9, free_bytes=30_000)
    assert (wide.is_wide, narrow.is_wide) == (True, False)
    assert (wide.shown_size, narrow.shown_size) == ((950, 20), (150, 20))  # two dots of the picture a pixel
    assert wide.source == "figures/learning/a.png"
    assert (report / wide.source).is_file()
    assert wide.embedded_bytes == 0
    assert narrow.embedded_bytes == len(narrow.source) > 1000


def test_keys_are_worded_and_long_captions_have_a_folded_rest(tmp_path: Path) -> None:
    Image.new("L", (70, 40)).save(tmp_path / "000.gif")
    write_figures(tmp_path, [Figure("type_1/bca: episode 0", f"First. {'Rest. ' * 40}", "000.gif", stage="enn")])
    (film,) = gather_figures("expert@seed=1", tmp_path, tmp_path, embed_limit=10**9)
    assert (film.title, film.stage, film.is_film, film.shown_size) == ("Type I, BCA: episode 0", "enn", True, (70, 40))
    assert film.caption_parts[0] == "First."
    assert film.caption_parts[1].startswith("Rest.")


def test_the_page_has_the_tables_of_the_source_and_their_kept_figures() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert rendered(text) == text, "run python -m pipeline.report.comparison"
    assert rendered(text.replace("| 83.3 |", "| 100 |")) == text
    rows = {row[0]: row[1:] for row in comparisons()["imitation"].rows}
    assert rows["BCA, Image with ENN"] == ("100 ± 0", "83.3", "98.9")
    for one in comparisons().values():
        page = (PROJECT_ROOT / "docs" / one.page.partition("#")[0]).read_text(encoding="utf-8")
        typed = {cell for _, _, *cells in one.rows for cell in cells if cell != NOT_MEASURED and "±" in cell}
        for number in re.findall(r"\d+\.\d+ ± \d+\.\d+", " ".join(typed)):
            assert number in page, f"{one.table}: {one.page} does not say {number}"


def test_a_verdict_needs_the_same_thing_to_be_measured() -> None:
    alike = {spec.table for spec in headline_specs() if spec.comparable}
    for one in comparisons().values():
        assert one.differs
        assert one.verdict == "not comparable" or one.table in alike
    results = {table.key for table in report_tables({}) if table.kind == "results" and table.stage}
    elsewhere = {"user_study", "training_time_h", "training_speed_fps", "guide3d_composition"}
    assert results - set(comparisons()) == elsewhere | {"guide3d_reprojection_px"}


def test_the_report_shows_them_beside_the_cells() -> None:
    page = render_page(
        run="x", budget="desk", seeds=[0], written="2026-01-01T00:00:00", records={}, tables=report_tables({}),
        figures=[], commit="", versions={}, machine=defaultdict(str),
    )  # fmt: skip
    assert page.count("As written, and ours") == len(comparisons())
    assert all(one.differs.split(".")[0] in page.replace("&#39;", "'") for one in comparisons().values())


def test_shares_are_compared_by_newcombe_s_interval() -> None:
    """56 of 70 against 48 of 80: Newcombe's paper gives 0.0524 to 0.3339 for the difference."""
    low, high = difference_of_shares(80.0, 70, 60.0, 80)
    assert (low, high) == (pytest.approx(5.24, abs=0.01), pytest.approx(33.39, abs=0.01))
    shares = {"thesis_samples": 80, "samples": 70, "share": True}
    assert compare(60.0, 80.0, **shares) == BETTER
    assert compare(60.0, 80.0, **shares, higher_is_better=False) == WORSE
    assert compare(60.0, 66.0, **shares) == EQUAL
    assert compare(100.0, 100.0, thesis_samples=30, samples=30, share=True) == EQUAL
    assert compare(60.0, 100.0, thesis_samples=30, samples=1, share=True) == OPEN


def test_means_are_compared_by_welch_s_interval_and_numbers_as_they_are_printed() -> None:
    many = {"thesis_samples": 30, "samples": 30, "higher_is_better": False}
    assert compare([36.9, 2.4], [30.0, 3.0], **many) == BETTER
    assert compare([36.9, 2.4], [45.0, 3.0], **many) == WORSE
    assert compare([36.9, 2.4], [37.5, 3.0], **many) == EQUAL
    assert compare([36.9, 2.4], [30.0, 0.0], thesis_samples=30, samples=1, higher_is_better=False) == OPEN
    exact = {"thesis_samples": None, "samples": 4, "higher_is_better": False}
    assert compare([2.88, 0.64], [0.1, 0.05], **exact) == BETTER
    assert compare([2.88, 0.64], [2.9, 1.0], **exact) == EQUAL
    alone = {"thesis_samples": None, "samples": None}
    assert compare(95.06, 95.064, decimals=2, **alone) == EQUAL
    assert compare(95.06, 95.10, decimals=2, **alone) == BETTER
    assert compare(0.445, 0.06, level=0.05, **alone) == EQUAL
    assert compare(0.445, 0.01, level=0.05, **alone) == WORSE


def test_intervals_of_known_cases() -> None:
    low, high = share_interval(50.0, 20) or (0, 0)
    assert (low, high) == (pytest.approx(29.93, abs=0.01), pytest.approx(70.07, abs=0.01))  # Wilson, 10 of 20
    low, high = mean_interval([10.0, 3.0], 10) or (0, 0)
    assert high - 10 == pytest.approx(2.2622, abs=1e-3)  # t of 9 degrees, 2.2622, times 3 / sqrt(9)
    assert mean_interval([1.0, 0.1], 1) is mean_interval(1.0, 30) is share_interval(50.0, None) is None


def test_every_headline_is_a_cell_of_the_thesis_beside_which_a_measured_one_stands() -> None:
    lines = headlines(report_tables({}))
    assert len(lines) == len(headline_specs()) >= 15
    assert all(line.thesis and not line.here and not line.verdict for line in lines)
    measured = {
        "ablation": {"bca/I+V+M": {"success_pct": [90.0, 30.0], "n": 30}},
        "force_prediction_mse": {"baseline": {"mse_n2": 0.02}, "fpn_100k": {"mse_n2": 0.001}},
    }
    lines = {line.label: line for line in headlines(report_tables(measured)) if line.here}
    success = lines["Expert Navigation Network, BCA: success"]
    assert (success.thesis, success.here, success.interval) == ("100 %", "90 %", "74 to 97 %")
    assert (success.samples, success.verdict, success.chapter) == (30, UNLIKE, "ENN")
    assert "demonstrations" in success.differs
    error = next(line for label, line in lines.items() if label.startswith("Force prediction"))
    assert (error.thesis, error.here, error.verdict) == ("1.8 %", "5.0 %", UNLIKE)
    assert len(lines) == 2


def test_over_several_seeds_the_interval_is_that_of_the_seeds() -> None:
    """Success 90 % of 90 pooled episodes, but 80, 90 and 100 % of the three seeds; an error of 2, 3 and 4 mm."""
    clicks = ("guide3d_simulated_ways_mm", "global, clicks", "max_ed")
    measured = {
        "ablation": {"bca/I+V+M": {"success_pct": [90.0, 30.0], "n": 90}},
        clicks[0]: {clicks[1]: {clicks[2]: [3.0, 0.1], "n": 90}},
    }
    seeded = {
        ("ablation", "bca/I+V+M", "success_pct"): OverSeeds([90.0, 8.165], 3, is_share=True),
        clicks: OverSeeds([3.0, 0.8165], 3),
    }
    lines = {line.label: line for line in headlines(report_tables(measured, seeded)) if line.here}
    success = lines["Expert Navigation Network, BCA: success"]
    assert (success.interval, success.samples, success.seeds) == ("65 to 100 %", 3, 3)
    error = lines["Reconstruction of simulated wires: largest error"]
    assert (error.samples, error.seeds, error.verdict) == (3, 3, EQUAL)


def test_only_what_is_comparable_has_a_verdict_and_another_cell_may_be_the_measured_one() -> None:
    measured = {
        "guide3d_simulated_validation_mm": {"max_ed": {"value": [0.01, 0.01], "n": 60}},
        "guide3d_simulated_ways_mm": {"global, clicks": {"max_ed": [1.2, 0.3], "n": 60}},
        "segmentation": {"transunet": {"dice": 97.0}},
    }
    lines = {line.table: line for line in headlines(report_tables(measured)) if line.here}
    clicked = lines["guide3d_simulated_validation_mm"]
    assert (clicked.here, clicked.samples, clicked.verdict) == ("1.200 ± 0.300 mm", 60, BETTER)
    assert lines["segmentation"].verdict == UNLIKE
    assert all(spec.differs for spec in headline_specs())


def test_a_cell_that_is_none_is_refused_where_it_is_written(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"ablation / bca/H / force_n: expected a finite number"):
        write_results(tmp_path, {"ablation": {"bca/H": {"force_n": float("nan")}}})
    with pytest.raises(ValueError, match="a pair"):
        check_cell([1.0, 2.0, 3.0], "t / r / c")
    with pytest.raises(FileNotFoundError, match=r"figure 'a' names b\.png"):
        write_figures(tmp_path, [Figure("a", "", "b.png")])
    assert read_figures(tmp_path) == []


def test_pooling_equals_statistics_over_all_samples() -> None:
    values = [[1.0, 2.0, 6.0], [4.0, 4.0]]
    both = [x for part in values for x in part]

    def pair(samples: list[float]) -> list[float]:
        mean = sum(samples) / len(samples)
        return [mean, math.sqrt(sum((x - mean) ** 2 for x in samples) / len(samples))]

    cell, count = pool([(pair(part), len(part)) for part in values])
    assert cell == pytest.approx(pair(both))
    assert count == 5
    assert pool([(90.0, None), (100.0, None)]) == ([95.0, 5.0], 2)
    assert pool([(None, None), (3, 4)]) == (3, 4)
    assert pool([("a", None), ("a", None)]) == ("a", None)


def test_keys_in_words() -> None:
    labels = {"ppo_image": "PPO image"}
    assert row_words("ppo_image", labels) == "PPO image"
    assert row_words("ppo_image (thesis)", labels) == "PPO image (thesis)"
    assert row_words("fpn_10k", labels) == "FPN, 10k samples"
    assert row_words("fpn_16 V_plain", labels) == "FPN, 16 samples, V plain"
    assert row_words("some_new_row", labels) == "Some new row"
    assert group_words("type_1/bca/enn", {"type_1": "Type I arch", "bca": "BCA"}, {}) == "Type I arch, BCA, ENN"
    assert column_words("value_mm") == ("Value", "mm")
    assert column_words("mean_force") == ("Mean force", "")
    assert place_in_thesis("ch5-fig:reprojection-error") == "thesis, chapter 5, figure"
    assert place_in_thesis("app1tab:training-time") == "thesis, appendix 1, table"
    assert place_in_thesis("guide3d-tab:dataset-stats") == "thesis, chapter 5, table"
    assert in_words("Sampling expert, low_tortuosity, LCCA") == "Sampling expert, Low tortuosity, LCCA"
    assert in_words("0.5 N and/or 2 of 3, type_1/rcca") == "0.5 N and/or 2 of 3, Type I, RCCA"
