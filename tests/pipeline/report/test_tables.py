"""Tables of the report: their cells, formats, seeds, layout and headlines, and comparisons of runs."""

from __future__ import annotations

import pytest
import yaml

from benchmarks.pipeline.compare_tables import compare, direction
from pipeline.report.figures import ShownFigure
from pipeline.report.intervals import OverSeeds, over_seeds
from pipeline.report.page import BEYOND, arrange, choose_film
from pipeline.report.tables import as_csv, as_latex, format_over_seeds, join_sweep, metrics, report_tables
from pipeline.store.provenance import PROJECT_ROOT
from pipeline.tables import Cell, Table, format_cell

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
    for column in range(3):
        assert (
            composition["radifocus_angled"][column] + composition["nitrex_straight"][column]
            == composition["total"][column]
        )


def test_sweep_jobs_are_joined_cell_by_cell() -> None:
    joined = join_sweep([{"t": {"r": {"x": 1.0}}}, {"t": {"r": {"y": 2.0}, "s": {"x": 3.0}}}])
    assert joined == {"t": {"r": {"x": 1.0, "y": 2.0}, "s": {"x": 3.0}}}


def test_jobs_with_other_settings_have_rows_of_their_own() -> None:
    parts = [{"t": {"r": {"x": share, "n": 3}}} for share in (100.0, 20.0)]
    joined = join_sweep([{}, *parts], ["", "target=bca", "phantom.file=a/b.stl"])
    assert joined == {"t": {"r (target=bca)": {"x": 100.0, "n": 3}, "r (phantom.file=a·b.stl)": {"x": 20.0, "n": 3}}}
    assert join_sweep(parts, ["", ""])["t"]["r"]["x"] == [60.0, 40.0]  # two seeds
    shared = [{"task": {"limit": {"value": 300}}}] * 2
    assert join_sweep(shared, ["target=bca", "target=lcca"]) == shared[0]


def test_the_number_of_samples_is_that_of_the_samples() -> None:
    parts = [{"t": {"r": {"max_ed": [1.0, 0.5], "epochs": 30, "n": 40}}}] * 2
    assert join_sweep(parts)["t"]["r"]["n"] == 80


@pytest.mark.parametrize(
    ("cell", "decimals", "expected"),
    [(None, None, ""), ("text", 2, "text"), ([0.1234, 0.05], None, "0.123 ± 0.050"), ([-70, 28], 0, "-70 ± 28"),
     (590080, None, "590,080"), (0.0003, None, "0.0003"), (93.14, 0, "93"), (7.0, None, "7")],
)  # fmt: skip
def test_cells_are_worded(cell: object, decimals: int | None, expected: str) -> None:
    assert format_cell(cell, decimals) == expected  # type: ignore[arg-type]


def test_csv_and_latex_hold_both_sides() -> None:
    table = next(t for t in report_tables({"ablation": {"bca/H": {"force_n": [0.5, 0.1]}}}) if t.key == "ablation")
    assert as_csv(table).splitlines()[1].startswith("bca/H,1.02 ± 0.22,0.50 ± 0.10,28.82 ± 11.80,,")
    assert r"H & 1.02 $\pm$ 0.22 & 0.50 $\pm$ 0.10 & 28.82 $\pm$ 11.80 & --" in as_latex(table)
    assert metrics([table])["ablation"]["bca/H"]["force_n"] == [0.5, 0.1]


def test_figures_over_seeds_follow_the_others() -> None:
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


def test_one_seed_has_no_interval() -> None:
    assert over_seeds({0: {"t": {"r": {"c": 1.0}}}}) == over_seeds({}) == {}
    with pytest.raises(ValueError, match="needs two of them, got 1"):
        _ = OverSeeds([1.0, 0.0], 1).interval


def run(**cells: Cell) -> dict[str, Table]:
    return {"trials": {"bca": {"n": 50, **cells}}}


@pytest.mark.parametrize(
    ("column", "expected"),
    [
        ("success_pct", 1), ("bca_success_pct", 1), ("force_n", -1), ("tip_px", -1), ("mse_n2", -1),
        ("interval_pct", 0), ("image_px", 0), ("minutes", 0), ("success_low_pct", 0),
    ],
)  # fmt: skip
def test_what_is_better(column: str, expected: int) -> None:
    assert direction(column) == expected


def test_cells_beyond_their_interval_are_told() -> None:
    earlier = run(success_pct=98.0, force_n=[0.05, 0.02], mse_n2=1.0, minutes=3.0, word="default")
    found = compare([earlier, run(success_pct=70.0, force_n=[0.03, 0.02], mse_n2=1.2, minutes=9.0)], 1.1)
    assert found.worse == ["trials | bca | success_pct: 98, now 70"]
    assert found.better == ["trials | bca | force_n: 0.0500 ± 0.0200, now 0.0300 ± 0.0200"]
    assert found.alone_worse == ["trials | bca | mse_n2: 1, now 1.2"]
    assert (found.compared, found.alone, found.missing) == (2, 1, [])
    within = compare([earlier, run(success_pct=90.0, force_n=[0.055, 0.02], mse_n2=1.05)], 1.1)
    assert not within.worse + within.better + within.alone_worse


def test_a_cell_has_to_be_worse_than_in_every_earlier_run() -> None:
    good, bad, new = (run(success_pct=share) for share in (98.0, 60.0, 70.0))
    assert compare([good, new], 1.1).worse
    assert not compare([good, bad, new], 1.1).worse
    assert compare([bad, good, run(success_pct=20.0)], 1.1).worse


def test_rows_that_have_gone_are_told() -> None:
    assert compare([run(success_pct=98.0), {}], 1.1).missing == ["trials | bca | success_pct"]


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
    placed += [
        table.key for chapter in chapters for block in chapter.blocks for table in (*block.tables, *block.detail)
    ]
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


def test_the_expert_is_open_where_nothing_else_was_measured() -> None:
    tables = report_tables({"expert": MEASURED["expert"]})
    (block,) = (b for chapter in arrange(tables, [figure("paths", "expert")]) for b in chapter.blocks)
    assert [table.key for table in block.tables] == ["expert"]
    assert [one.title for one in block.beside] == ["paths"]


def test_two_figures_stand_beside_the_tables_and_more_are_folded() -> None:
    shown = [
        figure("wide", "enn", width=3000),
        *(figure(name, "enn") for name in "abc"),
        figure("film", "enn", film=True),
    ]
    blocks = [b for chapter in arrange(report_tables(MEASURED), shown) for b in chapter.blocks if b.stage == "enn"]
    assert [one.title for one in blocks[0].beside] == ["a", "b"]
    assert [one.title for one in blocks[0].further] == ["wide", "c", "film"]


def test_the_film_is_that_of_the_stage_that_shows_most() -> None:
    films = [figure("expert", "expert", film=True), figure("navigation", "navigation", film=True)]
    assert choose_film(films) is films[1]
    assert choose_film([figure("picture", "expert")]) is None
