"""Reconstruction of wires in space: reprojection on annotated pairs, or millimetres against synthetic ground truth.

    python benchmarks/guide3d/reconstruction.py PAIRS.json --cameras DIR
    python benchmarks/guide3d/reconstruction.py --synthetic

Reads {"units": ..., "pairs": [{"pair", "camera_a": [[x, y]], "camera_b"}]}, tip first. DIR holds the files of
both cameras (*16710*.txt is A, *16709*.txt is B, world unit cm), and may hold X-rays of a perforated sheet
(undistort_<detector>.*): then it is found out whether annotations are raw, and raw ones are undistorted. Prints a
table, and as the last line one JSON object. Times are processor time of one thread.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from matplotlib.figure import Figure

from guide3d.calibration.folder import Rig, distortions_of_sheets, rigs_in
from guide3d.geometry.camera import Camera
from guide3d.geometry.metrics import curve_metrics
from guide3d.reconstruction.reconstruction import Reconstruction, reconstruct, reconstruct_greedy
from guide3d.reconstruction.synthetic_scene import KINDS, scenes
from guide3d.reconstruction.view_checks import epipolar_residuals, swapped_cameras, undistorted_or_raw

PairOfPoints = tuple[np.ndarray, np.ndarray]


def read_pairs(path: Path) -> tuple[list[Any], list[PairOfPoints], str]:
    """Returns names and annotations of a file of pairs, and what it says of itself."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ValueError(f"{path} is missing: expected a JSON file of annotated pairs") from None
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise ValueError(f"{path}: expected JSON, found something else ({error})") from None
    listed = content.get("pairs") if isinstance(content, dict) else None
    if not isinstance(listed, list) or not listed:
        raise ValueError(
            f'{path}: expected {{"pairs": [{{"camera_a": [[x, y]], "camera_b": [[x, y]]}}]}}, found no pairs'
        )
    names, pairs = [], []
    for number, entry in enumerate(listed):
        try:
            a, b = (np.asarray(entry[f"camera_{view}"], dtype=float) for view in "ab")
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"{path}: pair {number} has no readable camera_a and camera_b ({error})") from None
        names.append(entry.get("pair", number))
        pairs.append((a, b))
    return names, pairs, str(content.get("units", ""))


def rig_of(folder: Path, pairs: Sequence[PairOfPoints], said: str) -> tuple[Rig, str]:
    """Returns the cameras of a folder, and why: those that the pairs' file names, or else those that fit them best."""
    rigs = rigs_in(folder)
    named = [rig for rig in rigs if rig.name in said]
    chosen = named if len(named) == 1 else rigs
    fit = {rig: float(np.median(epipolar_residuals(*rig.cameras, pairs))) for rig in chosen}
    best = min(chosen, key=lambda rig: fit[rig])
    why = "named by the pairs" if len(named) == 1 else "the only set" if len(rigs) == 1 else "of several, the best fit"
    return best, f"cameras {best.name} ({why}, epipolar residual {fit[best]:.2f} px)"


def numbers(result: Reconstruction) -> dict[str, Any]:
    """Returns a reconstruction's figures as plain numbers: reprojection, coverage, uncertainty and warnings."""
    figures: dict[str, Any] = {}
    for letter, residual in (("a", result.residual_a_px), ("b", result.residual_b_px)):
        figures[f"mean_px_{letter}"] = float(residual.mean())
        figures[f"p95_px_{letter}"] = float(np.quantile(residual, 0.95))
        figures[f"max_px_{letter}"] = float(residual.max())
    figures["coverage"] = result.coverage
    figures["coverage_a"], figures["coverage_b"] = result.coverage_a, result.coverage_b
    figures["tangent_share_a"], figures["tangent_share_b"] = result.tangent_share
    figures["epipolar_px"] = result.match.residual_px
    figures["length_mm"] = result.length_mm
    figures["mean_sd_mm"] = float(result.sd_mm.mean())
    figures["noise_px"] = result.noise_px
    figures["accepted"] = bool(result.accepted)
    figures["warnings"] = list(result.warnings)
    return figures


def draw(cameras: tuple[Camera, Camera], annotations: PairOfPoints, result: Reconstruction, file: Path) -> None:
    """Draws both views with annotation, px (red), and reprojected curve (blue), and the errors along the wire below."""
    figure = Figure(figsize=(10, 7.5), layout="constrained")
    residuals = (result.residual_a_px, result.residual_b_px)
    for view, (above, below) in enumerate(figure.subplots(2, 2, height_ratios=(5, 2)).T):
        camera, annotation, residual = cameras[view], annotations[view], residuals[view]
        above.plot(*annotation.T, color="tab:red", linewidth=3)
        above.plot(*camera.project(result.curve_mm).T, color="tab:blue", linewidth=1)
        above.plot(*annotation[0], "o", color="tab:green")
        mean, most = residual.mean(), np.quantile(residual, 0.95)
        above.set(xlim=(0, camera.width), ylim=(camera.height, 0), aspect="equal")
        above.set_title(f"view {'AB'[view]}: mean {mean:.2f} px, 95 % below {most:.2f} px")
        below.plot(np.linspace(0, result.length_mm, len(residual)), residual, color="tab:blue")
        below.set(xlabel="mm from the tip", ylabel="reprojection error, px", ylim=(0, None))
    figure.savefig(file)


def timed(
    method: Callable[..., Reconstruction], cameras: tuple[Camera, Camera], pairs: Sequence[PairOfPoints], repeats: int
) -> tuple[list[Reconstruction | str], float]:
    """Returns the results (or what was wrong) and pairs a second."""
    best = np.inf
    results: list[Reconstruction | str] = []
    for _ in range(repeats):
        results, start = [], time.process_time()
        for a, b in pairs:
            try:
                results.append(method(*cameras, a, b))
            except ValueError as error:
                results.append(str(error))
        best = min(best, time.process_time() - start)
    return results, len(pairs) / best


def of_pairs(path: Path, folder: Path, pictures: Path | None, as_given: bool) -> dict[str, Any]:
    names, pairs, said = read_pairs(path)
    rig, sentence = rig_of(folder, pairs, said)
    camera_a, camera_b = rig.cameras
    print(sentence)
    order = swapped_cameras(camera_a, camera_b, pairs)
    print(order.sentence)
    if order.answer == "swapped" and order.sure:
        camera_a, camera_b = camera_b, camera_a
        print("going on with the cameras exchanged")
    maps = None if as_given else distortions_of_sheets(folder)
    state = "as given"
    if maps is not None:
        if order.answer == "swapped" and order.sure:
            maps = maps[::-1]
        verdict = undistorted_or_raw(camera_a, camera_b, pairs, maps[0].undistort_points, maps[1].undistort_points)
        print(verdict.sentence)
        state = verdict.answer
        if verdict.answer == "raw":
            pairs = [(maps[0].undistort_points(a), maps[1].undistort_points(b)) for a, b in pairs]
            print("undistorting them")
    cameras = (camera_a, camera_b)
    report: dict[str, Any] = {}
    header = [
        "pair, variant",
        "A px",
        "p95",
        "B px",
        "p95",
        "coverage",
        "of A",
        "of B",
        "tangent A",
        "B",
        "sd mm",
        "length mm",
    ]
    print(f"{header[0]:16s}" + "".join(f"{title:>10s}" for title in header[1:]))
    for method, label in ((reconstruct, ""), (reconstruct_greedy, "greedy")):
        results, speed = timed(method, cameras, pairs, 5)
        lines = []
        for name, result, annotated in zip(names, results, pairs, strict=True):
            if isinstance(result, str):
                print(f"{name!s} {label}: {result}")
                lines.append({"pair": name, "error": result})
                continue
            line = numbers(result)
            lines.append({"pair": name, **line})
            cells = [line[key] for key in ("mean_px_a", "p95_px_a", "mean_px_b", "p95_px_b", "coverage")]
            cells += [line[key] for key in ("coverage_a", "coverage_b", "tangent_share_a", "tangent_share_b")]
            cells += [line["mean_sd_mm"], line["length_mm"]]
            print(f"{f'{name} {label}':16s}" + "".join(f"{cell:10.3f}" for cell in cells))
            for warning in result.warnings:
                print(f"    {warning}")
            if pictures is not None and not label:
                pictures.mkdir(parents=True, exist_ok=True)
                draw(cameras, annotated, result, pictures / f"pair_{name}.png")
        good = [line for line in lines if "error" not in line]
        whole: dict[str, Any] = {
            key: float(np.mean([line[key] for line in good])) if good else None
            for key in ("mean_px_a", "mean_px_b", "coverage")
        }
        whole["pairs_per_s"] = speed
        if label:
            report["greedy"] = whole
        else:
            report = {**whole, "per_pair": lines, "annotations": state, "cameras": order.answer}
    return report


def of_scenes(count: int, seed: int) -> dict[str, Any]:
    report: dict[str, Any] = {}
    titles = ("MaxED", "sd", "METE", "mean", "p95 mean", "Fréchet", "coverage", "pairs/s")
    print(f"{'scenes, variant':28s}" + "".join(f"{title:>10s}" for title in titles))
    for noise, group in ((None, "exact"), (1.0, "1 px clicks")):
        drawn = list(scenes(count, seed, noise))
        for method, label in ((reconstruct, ""), (reconstruct_greedy, "greedy")):
            figures, used, start = [], [], time.process_time()
            done: list[Reconstruction | None] = []
            for scene in drawn:
                try:
                    done.append(method(*scene.cameras, *scene.points))
                except ValueError as error:
                    print(f"{scene.kind} {label}: {error}")
                    done.append(None)
            speed = count / (time.process_time() - start)
            for scene, result in zip(drawn, done, strict=True):
                if result is not None:
                    figures.append({**curve_metrics(result.curve_mm, scene.curve_mm), "coverage": result.coverage})
                    used.append(scene.kind)
            table = {key: np.array([figure[key] for figure in figures]) for key in figures[0]}
            for kind in (*KINDS, "all"):
                rows = np.array([kind in (name, "all") for name in used])
                if not rows.any():
                    continue
                chosen = {key: values[rows] for key, values in table.items()}
                cells = [chosen["max_ed"].mean(), chosen["max_ed"].std(), chosen["mete"].mean(), chosen["mers"].mean()]
                cells += [np.quantile(chosen["mers"], 0.95), chosen["frechet"].mean(), chosen["coverage"].mean(), speed]
                print(f"{f'{group}, {kind} {label}':28s}" + "".join(f"{cell:10.3f}" for cell in cells))
            whole = {
                "max_ed_mm": float(table["max_ed"].mean()),
                "mete_mm": float(table["mete"].mean()),
                "mean_mm": float(table["mers"].mean()),
                "pairs_per_s": float(speed),
                "failed": count - len(figures),
            }
            place = report.setdefault("greedy", {}) if label else report
            if noise is None:
                place.update(whole)
            else:
                place["noisy"] = whole
    return report


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pairs", nargs="?", type=Path, help="JSON file of annotated pairs")
    parser.add_argument("--cameras", type=Path, help="folder with the cameras' files")
    parser.add_argument(
        "--as-given", action="store_true", help="take the annotations as undistorted, whatever they look like"
    )
    parser.add_argument("--pictures", type=Path, help="folder for a picture of each pair")
    parser.add_argument("--synthetic", action="store_true", help="synthetic scenes with ground truth")
    parser.add_argument("--scenes", type=int, default=200, help="number of synthetic scenes")
    parser.add_argument("--seed", type=int, default=0, help="of the synthetic scenes")
    parser.add_argument("--quick", action="store_true", help="40 synthetic scenes")
    arguments = parser.parse_args()
    try:
        if arguments.synthetic or (arguments.quick and arguments.pairs is None):
            report = of_scenes(40 if arguments.quick else arguments.scenes, arguments.seed)
        elif arguments.pairs is None or arguments.cameras is None:
            parser.error("expected PAIRS.json --cameras DIR, or --synthetic")
        else:
            report = of_pairs(arguments.pairs, arguments.cameras, arguments.pictures, arguments.as_given)
    except (ValueError, OSError) as error:
        print(f"reconstruction: {error}", file=sys.stderr)
        return 1
    print(json.dumps(report, ensure_ascii=False, allow_nan=False))
    per_pair = report.get("per_pair", [])
    if per_pair and all("error" in line for line in per_pair):
        print("reconstruction: not one pair could be reconstructed; the lines above say why", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
