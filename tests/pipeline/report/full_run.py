"""A run with every cell of every table and figures of usual sizes, for tests of the page."""

import time
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from PIL import Image

from pipeline.stages import available_stages
from pipeline.store.provenance import PROJECT_ROOT
from pipeline.store.run_folder import Identity, RunFolder
from pipeline.tables import Figure, write_figures, write_results

THESIS = yaml.safe_load((PROJECT_ROOT / "pipeline" / "report" / "thesis.yaml").read_text())["tables"]
OWN_ROWS = {
    "phantoms": ["type_1", "type_2", "type_3", "bovine"],
    "expert": ["type_1/bca", "type_1/lcca", "type_2/bca", "type_2/lcca"],
    "baselines": ["type_1/bca/ppo_internal", "type_1/bca/path_follower"],
    "generalisation": [f"{row}/bca/unseen" for row in ("roadmap", "roadmap_curve", "image_true_mask", "xray")],
    "load_cell": ["type_1/bca/wire/enn/I+V+M safe 5", "misregistered 4 mm/bca/wire/unseen/roadmap"],
    "force_share": ["fpn_200", "fpn_16 V_plain"],
    "devices": ["type_1/bca/expert/sampling_expert/wire", "type_1/bca/expert/sampling_expert/simmons_2"],
    "splineformer_segmentation": ["none/unet", "noise/published", "low_contrast/ordered", "occlusion/swinunet"],
    "navigation_trials": ["splineformer/type_1", "splineformer_100/type_1", "splineformer_dagger/unseen_arches"],
}  # fmt: skip
FURTHER_ROWS = {
    "ablation": ["bca/sampling_expert", "bca/I+V+M safe 5", "lcca/sampling_expert"],
    "imitation": ["bca/dagger", "bca/image_w_enn_disturbed", "lcca/dagger", "lcca/image_w_enn_disturbed"],
    "cathsim_results": ["type_1/path_follower", "type_2/path_follower"],
    "force_prediction_mse": ["fpn_200", "untrained", "shape", "shape_errors"],
    "navigation": ["sampling_expert", "enn_expert", "splineformer_100", "splineformer_500", "splineformer_dagger"],
}
SENTENCE = "Location: the simulated wire presses less on the wall than the real one, whose mean force is 0.40 N. "


def add_full_run(run: Path) -> None:
    """Leaves in a run what every stage could leave, with invented numbers.

    Args:
        run: folder of the run.
    """
    generator = np.random.default_rng(0)
    tables: dict[str, dict[str, Any]] = {}
    for key, table in THESIS.items():
        stage = table.get("stage") or "validate"
        if stage != "report":
            names = [*table["rows"], *OWN_ROWS.get(key, []), *FURTHER_ROWS.get(key, [])]
            names = names or ["type_1/bca/round 1", "other_row"]
            tables.setdefault(stage, {})[key] = {name: _cells(table, name, generator) for name in names}
    tables["validate"]["force_validation"] |= {"agrees": {"value": SENTENCE * 3}, "differs": {"value": SENTENCE * 5}}
    for stage in available_stages():
        if stage == "report":
            continue
        folder = RunFolder(run / stage, Identity("c", {}, 1))
        with folder.locked():
            folder.prepare()
            write_results(folder.path, tables.get(stage, {}))
            write_figures(folder.path, _figures(folder.path, stage))
            folder.finish(stage=stage, run=run.name, budget="desk", seed=7, config={}, started=time.monotonic() - 63)


def _cells(table: dict[str, Any], name: str, generator: np.random.Generator) -> dict[str, Any]:
    thesis = dict(zip(table["columns"], table["rows"].get(name, []), strict=False))
    cells: dict[str, Any] = {"n": 30}
    for column, described in table["columns"].items():
        example = thesis.get(column, 1.0)
        share = described.get("unit") == "%"
        largest = 100 if share else {"N": 1.0, "N²": 0.1, "px": 60, "mm": 30}.get(described.get("unit", ""), 100)
        number = float(generator.uniform(0, largest))
        if isinstance(example, str):
            cells[column] = "autonomous, knows the state"
        elif isinstance(example, list) or (name not in table["rows"] and not share):
            cells[column] = [number, float(generator.uniform(0, largest))]
        else:
            cells[column] = number
    return cells


def _figures(folder: Path, stage: str) -> list[Figure]:
    """Three charts and a wide one, and a film of the expert."""
    sizes = {"a.png": (1496, 924), "b.png": (1848, 1450), "c.png": (1496, 924), "wide.png": (2640, 1400)}
    figures = []
    for name, (width, height) in sizes.items():
        Image.new("L", (width, height), 220).save(folder / name)
        figures.append(Figure(f"type_1/bca: {name[0]}", "What it shows, in a sentence of some length. " * 4, name))
    if stage == "expert":
        frames = [Image.new("L", (700, 400), grey) for grey in (0, 255)]
        frames[0].save(folder / "000.gif", save_all=True, append_images=frames[1:])
        figures.append(Figure("type_1/bca: episode 0", "Fluoroscopy and 3-D view.", "000.gif"))
    return figures
