"""Cases of a claim of rehearsal: the stage run in a drawn arch each, and its tables read."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from pipeline.protocol.claims import Rehearsal
from pipeline.seeds import protocol_arches
from pipeline.store.atomic_files import read_json
from pipeline.store.manifest import read_manifest


def cases(claim: Rehearsal, seed: int) -> Iterator[dict[str, Any]]:
    """Each case: the arch, its seed, and the seed of the run."""
    for arch in protocol_arches(claim.first, seed, claim.count):
        yield {"anatomy": f"{claim.arches}_{arch}", "arch": arch, "target": claim.target, "seed": seed}


def play(claim: Rehearsal, case: dict[str, Any], *overrides: str, budget: str = "desk") -> dict[str, Any]:
    """Runs the stage by itself in one process; with further words of its command.

    Returns:
        `success` (whether nine tenths of the copies of the test are reached after it), `before_pct` and `after_pct` of
        the copies, `force_p95_n` and `force_max_n` after it, `cpu_s` of the training, its `decisions` and the devices.

    Raises:
        ValueError: the stage failed; that is no failure of what is measured.
    """
    with TemporaryDirectory(prefix="rehearsal-") as folder:
        command = [sys.executable, "-m", "pipeline", "stage=rehearsal", f"budget={budget}", f"seed={case['seed']}"]
        command += [f"phantom.name={claim.arches}", f"phantom.seed={case['arch']}", f"target={claim.target}"]
        command += [
            "stage.film=false",
            "stage.workers=1",
            "stage.threads=1",
            f"runs_dir={folder}",
            "name=run",
            *overrides,
        ]
        with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as stage:
            try:
                _, messages = stage.communicate()
            except BaseException:
                stage.terminate()
                raise
        finished = [(path, read_manifest(path)) for path in Path(folder).glob("run/rehearsal*")]
        stages = [(path, manifest) for path, manifest in finished if manifest is not None]
        if not stages:
            raise ValueError((messages.strip().splitlines() or ["the stage left no results"])[-1])
        (path, manifest), *_ = stages
        tables = read_json(path / "results.json")
    rows, cost = tables["rehearsal"], tables["rehearsal_cost"][case["anatomy"]]
    after = rows[f"{case['anatomy']}/after copies"]
    return {
        "success": after["success_pct"] >= 90,
        "before_pct": rows.get(f"{case['anatomy']}/before copies", {"success_pct": 0.0})["success_pct"],
        "after_pct": after["success_pct"],
        "force_p95_n": round(after["force_p95_n"], 3),
        "force_max_n": round(after["force_max_n"], 3),
        **{key: cost[key] for key in ("cpu_s", "decisions", "wire", "catheter")},
        "played_cpu_s": round(sum(job["cpu_s"] for job in manifest.jobs.values()), 1),
    }
