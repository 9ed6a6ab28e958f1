"""Shapes of real aortas beside those of generated arches, in one table and one picture.

    python benchmarks/anatomy/shapes.py PATH ... [--arches N] [--setting random] [--output shapes.png]

Every PATH is an anatomy that imports, or a folder of such; what does not import is named and left out. N arches of a
setting ("random", "random_wide", "random_scan", "random_steep", "random_trunk") are built at --resolution and measured
with the same code. The table has a row a measure: the setting's percentiles 1, 50 and 99, then each aorta's value,
marked * where it lies outside.
The last line is one JSON object {"aortas", "arches", "outside": {measure: [names]}, "outside_pct", "seconds"}.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import time
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from cathsim.anatomy import load_phantom
from cathsim.anatomy.generator.recipe import draw_recipe
from cathsim.anatomy.importing import is_anatomy_path
from cathsim.anatomy.library import build_phantom
from cathsim.anatomy.measurement.shape import measure_shape


def anatomies_of(paths: list[Path]) -> list[Path]:
    """The anatomies among paths: files, folders of one vessel a file, and what stands in other folders."""
    found: list[Path] = []
    for path in paths:
        inside = sorted(path.iterdir()) if path.is_dir() and not is_anatomy_path(str(path)) else [path]
        found += [one for one in inside if is_anatomy_path(str(one))]
    return found


def real_shapes(files: list[Path]) -> dict[str, dict[str, float]]:
    """Shape of every file that imports, by its name."""
    shapes = {}
    for file in files:
        try:
            phantom = load_phantom(str(file))
        except ValueError as error:
            print(f"{file.name} is left out: {error}")
            continue
        shapes[file.name.split(".")[0]] = measure_shape(phantom)
    return shapes


def generated_shapes(setting: str, arches: int, resolution: float) -> dict[str, np.ndarray]:
    """Values (arches,) of every measure over the arches of seeds 0, 1, ..."""
    rows = []
    for seed in range(arches):
        phantom = build_phantom(f"{setting}_{seed}", draw_recipe(setting, seed), resolution=resolution)
        rows.append(measure_shape(phantom))
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


def percentiles(values: np.ndarray) -> tuple[float, float, float]:
    """The values' percentiles 1, 50 and 99, without what is missing."""
    known = values[np.isfinite(values)]
    low, middle, high = np.percentile(known, [1, 50, 99]) if len(known) else (math.nan,) * 3
    return float(low), float(middle), float(high)


def draw(path: Path, generated: dict[str, np.ndarray], real: dict[str, dict[str, float]]) -> None:
    """A panel a measure: histogram of the generated arches with its middle 98 %, a line for each real aorta."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    columns = 5
    rows = -(-len(generated) // columns)
    figure = Figure(figsize=(3.1 * columns, 2.0 * rows), dpi=90, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    colours = [f"C{index}" for index in range(1, 1 + len(real))]
    panels = figure.subplots(rows, columns).ravel()
    for panel, (name, values) in zip(panels, generated.items(), strict=False):
        low, _, high = percentiles(values)
        panel.hist(values[np.isfinite(values)], bins=24, color="0.8")
        panel.axvspan(low, high, color="C0", alpha=0.12)
        for shape, colour in zip(real.values(), colours, strict=True):
            if math.isfinite(shape[name]):
                panel.axvline(shape[name], color=colour, linewidth=1.8)
        panel.set_title(name, fontsize=8)
        panel.tick_params(labelsize=7)
        panel.set_yticks([])
    for panel in panels[len(generated) :]:
        panel.set_axis_off()
    handles = [Line2D([], [], color=colour, label=label) for label, colour in zip(real, colours, strict=True)]
    if handles:
        figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), fontsize=8)
    figure.savefig(path)


def main() -> None:
    """Runs the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("paths", nargs="*", type=Path)
    parser.add_argument("--arches", type=int, default=500)
    parser.add_argument("--setting", default="random")
    parser.add_argument("--resolution", type=float, default=1.5e-3, help="of the generated arches, m")
    parser.add_argument("--output", type=Path, help="picture to write")
    chosen = parser.parse_args()
    start = time.process_time()
    real = real_shapes(anatomies_of(chosen.paths))
    generated = generated_shapes(chosen.setting, chosen.arches, chosen.resolution)
    print(f"{'measure':<28}{'p1':>9}{'p50':>9}{'p99':>9}" + "".join(f"{name[:13]:>15}" for name in real))
    outside: dict[str, list[str]] = {}
    compared = 0
    for name, values in generated.items():
        low, middle, high = percentiles(values)
        cells = []
        for label, shape in real.items():
            value = shape[name]
            known = math.isfinite(value) and math.isfinite(low)
            beyond = known and not low <= value <= high
            compared += known
            if beyond:
                outside.setdefault(name, []).append(label)
            cells.append(f"{value:.2f}{'*' if beyond else ' '}" if math.isfinite(value) else "- ")
        print(f"{name:<28}{low:>9.2f}{middle:>9.2f}{high:>9.2f}" + "".join(f"{cell:>15}" for cell in cells))
    if chosen.output:
        draw(chosen.output, generated, real)
    share = 100 * sum(map(len, outside.values())) / compared if compared else math.nan
    seconds = round(time.process_time() - start, 1)
    summary = {"aortas": list(real), "arches": chosen.arches, "outside": outside, "outside_pct": share}
    print(json.dumps({**summary, "seconds": seconds}))


if __name__ == "__main__":
    main()
