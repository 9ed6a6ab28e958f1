"""Tables: the thesis's figures as transcribed; sweeps joined."""

from __future__ import annotations

import yaml

from pipeline.report.tables import join_sweep
from pipeline.store.provenance import PROJECT_ROOT

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
