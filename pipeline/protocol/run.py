"""One claim measured: its cases played in processes, kept as they come, and summed up with intervals."""

from __future__ import annotations

import contextlib
import json
import os
import re
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from datetime import UTC, datetime
from multiprocessing import active_children, get_context
from pathlib import Path
from typing import Any

import numpy as np

from cathsim.metrics.episodes import wilson_interval
from pipeline.protocol import calibration, forces, navigation, reconstruction, rehearsal, speed, xray
from pipeline.protocol.claims import Claim, Navigation, Protocol, RealXray, Rehearsal, declared
from pipeline.store.atomic_files import write_text
from pipeline.store.interruption import end_with_parent
from pipeline.store.provenance import hash_file, hash_value, present_commit, software_versions, uncommitted_changes

KINDS: dict[str, Any] = {
    "navigation": navigation,
    "reconstruction": reconstruction,
    "forces": forces,
    "rehearsal": rehearsal,
    "real_xray": xray,
    "calibration": calibration,
    "speed": speed,
}
_MEANS = ("before_pct", "after_pct", "depth_mm", "force_p95_n", "steps", "mean_mm", "max_mm", "tip_mm", "place_mm",
          "dice", "within_4px_pct", "curve_mean_px", "tip_px", "leave_out_px", "mean_px", "steps_per_s",
          "cpu_s")  # fmt: skip
_MEDIANS = ("resultant_error_pct", "sum_error_pct")
_FOLDERS = re.compile(r"(?<![\w.])~?(/[^\s/:;,]+)*/(?=[^\s/])")
_DRAWS = 4000  # of the bootstrap
_SECONDS_TO_END = 20.0  # that processes have before they are killed


def require_data(claim: Claim) -> None:
    """Refuses a claim whose data is not there, before the cases of others are played for hours."""
    inputs(claim)
    next(iter(KINDS[claim.kind].cases(claim, 0)), None)


def measure(
    name: str,
    protocol: Protocol,
    folder: Path,
    *,
    seeds: int = 1,
    workers: int = 2,
    tell: Callable[[str, int, int], None] = lambda *_: None,
) -> dict[str, Any]:
    """Plays the cases of a claim that were not played yet, and writes `<folder>/<name>.json`.

    Cases of another commit, other libraries, weights or entry of the protocol are moved to `<name>.old-<time>.jsonl`:
    code is not mixed.

    Args:
        seeds: how many times the claim is measured, on other anatomies each time.
        workers: processes.
        tell: called with the name, how many cases are done, and how many there are.

    Returns:
        What is written.
    """
    claim = protocol.claims[name]
    made_by = {
        "commit": present_commit(),
        "changes": uncommitted_changes(),
        "inputs": inputs(claim),
        "claim": hash_value(declared(claim, words=False)),
    }
    journal = folder / f"{name}.jsonl"
    played = _played(journal, {**made_by, "versions": software_versions()})
    cases = [case for seed in range(seeds) for case in KINDS[claim.kind].cases(claim, seed)]
    left = [case for case in cases if hash_value(case) not in played]
    tell(name, len(cases) - len(left), len(cases))
    with journal.open("a", encoding="utf-8") as file:
        pool = ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=end_with_parent)
        try:
            futures = {pool.submit(play, claim, case): case for case in left}
            for done, future in enumerate(as_completed(futures), len(cases) - len(left) + 1):
                case, outcome = futures[future], future.result()
                played[hash_value(case)] = outcome
                file.write(json.dumps({"case": case, "outcome": outcome}) + "\n")
                file.flush()
                tell(name, done, len(cases))
        except BaseException:
            _end(pool)
            raise
        pool.shutdown()
    outcomes = [{**case, **played[hash_value(case)]} for case in cases]
    result = {
        "claim": name,
        "protocol": protocol.version,
        "declared": declared(claim),
        "seeds": seeds,
        "made_by": made_by,
        "versions": software_versions(),
        "summary": summary(outcomes),
        "cases": outcomes,
    }
    write_text(folder / f"{name}.json", result_text(result))
    return result


def result_text(result: Mapping[str, Any]) -> str:
    """JSON of a result, each of its cases, which come last, on a line; a ValueError for NaN and infinity."""
    cases = ",\n".join(json.dumps(case, allow_nan=False) for case in result["cases"])
    rest = {key: value for key, value in result.items() if key != "cases"}
    return json.dumps(rest, indent=1, allow_nan=False).removesuffix("\n}") + f',\n "cases": [\n{cases}\n]}}\n'


def play(claim: Claim, case: Mapping[str, Any]) -> dict[str, Any]:
    """A case's outcome, with the processor time that it took."""
    before = os.times()
    outcome: dict[str, Any] = KINDS[claim.kind].play(claim, case)
    spent = sum(os.times()[:4]) - sum(before[:4])  # of this process and of its children, unless the claim knows better
    if "reason" in outcome:  # results are published, places on a machine are not
        outcome["reason"] = _FOLDERS.sub("", outcome["reason"])
    return {"played_cpu_s": round(spent, 1)} | outcome


def summary(outcomes: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Shares and means over cases, each with the 95 % interval of a bootstrap over anatomies.

    Of a share the interval is as wide as Wilson's at least, since a bootstrap of equal cases has no width.
    """
    figures: dict[str, Any] = {"cases": len(outcomes), "anatomies": len({one["anatomy"] for one in outcomes})}
    for key in ("success", "straight"):
        if any(key in one for one in outcomes):
            figures[f"{key}_pct"] = _share([(one["anatomy"], one.get(key, False)) for one in outcomes])
    for part in ("target", "variation"):
        for name in dict.fromkeys(one[part] for one in outcomes if part in one):
            chosen = [(one["anatomy"], one["success"]) for one in outcomes if one.get(part) == name]
            figures[f"success_{name}_pct"] = _share(chosen)
    for key in (*_MEANS, *_MEDIANS):
        if values := [(one["anatomy"], float(one[key])) for one in outcomes if key in one]:
            statistic = "median" if key in _MEDIANS else "mean"
            figures[f"{key}_{statistic}"] = _interval(values, 3, statistic)
    if largest := [one["force_max_n"] for one in outcomes if "force_max_n" in one]:
        figures["force_max_n"] = max(largest)
    if all("played_cpu_s" in one for one in outcomes):
        figures["cpu_min"] = round(sum(one["played_cpu_s"] for one in outcomes) / 60, 1)
    return figures


def _share(values: Sequence[tuple[str, bool]]) -> dict[str, float]:
    interval = _interval([(name, 100.0 * success) for name, success in values], 1)
    # where all cases end alike nothing shows that those of one anatomy differ: each anatomy counts once
    alike = len({success for _, success in values}) == 1
    cases = [success for _, success in (dict(values).items() if alike else values)]
    low, high = (100 * bound for bound in wilson_interval(sum(cases), len(cases)))
    return interval | {"low": round(min(interval["low"], low), 1), "high": round(max(interval["high"], high), 1)}


def _interval(values: Sequence[tuple[str, float]], digits: int, statistic: str = "mean") -> dict[str, float]:
    """Mean or median as `mean`, and its 95 % interval of a bootstrap that draws anatomies with all their cases."""
    of_names: dict[str, list[float]] = {}
    for name, value in values:
        of_names.setdefault(name, []).append(value)
    drawn = np.random.default_rng(0).integers(len(of_names), size=(_DRAWS, len(of_names)))
    if statistic == "mean":
        sums = np.array([[sum(own), len(own)] for own in (of_names[name] for name in sorted(of_names))])
        resamples = sums[drawn, 0].sum(axis=1) / sums[drawn, 1].sum(axis=1)
    else:
        groups = [np.array(of_names[name]) for name in sorted(of_names)]
        resamples = np.array([np.median(np.concatenate([groups[k] for k in draw])) for draw in drawn])
    whole = getattr(np, statistic)([value for _, value in values])
    numbers = {"mean": whole, **dict(zip(("low", "high"), np.percentile(resamples, (2.5, 97.5)), strict=True))}
    return {name: round(float(number), digits) for name, number in numbers.items()}


def _end(pool: ProcessPoolExecutor) -> None:
    """Ends a pool's processes, each of which may begin a further case that waits in its queue."""
    pool.shutdown(wait=False, cancel_futures=True)
    deadline = time.monotonic() + _SECONDS_TO_END
    while processes := active_children():
        for process in processes:
            process.terminate() if time.monotonic() < deadline else process.kill()
        processes[0].join(0.2)


def inputs(claim: Claim) -> dict[str, str]:
    """SHA-256 of the file of each network that takes part, and of each file of public data."""
    if isinstance(claim, RealXray):
        from guide3d.shipped import shipped_file

        with shipped_file("reader") as path:
            return {"reader": hash_file(path)}
    if not isinstance(claim, (Navigation, Rehearsal)):
        return {}
    if isinstance(claim, Rehearsal):
        from pipeline.stages.rehearsal.start import shipped_policies

        return {path.stem: hash_file(path) for path in shipped_policies()}
    from enn.shipped import weight_files

    return {path.stem: hash_file(path) for path in weight_files() if path.stem in claim.policies} | navigation.files(
        claim
    )


def _played(journal: Path, made_by: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Outcomes of the journal, by their case's hash; the journal begins anew where something else made it."""
    journal.parent.mkdir(parents=True, exist_ok=True)
    lines = journal.read_text("utf-8", "replace").splitlines() if journal.is_file() else []
    if not lines or lines[0] != json.dumps(made_by):
        if lines:
            journal.replace(journal.with_suffix(f".old-{datetime.now(UTC):%Y%m%dT%H%M%S.%f}.jsonl"))
        write_text(journal, json.dumps(made_by) + "\n")
        return {}
    outcomes, whole = {}, lines[:1]
    for line in lines[1:]:
        with contextlib.suppress(ValueError, KeyError, TypeError):  # an interrupted write leaves half a line
            record = json.loads(line)
            outcomes[hash_value(record["case"])] = record["outcome"]
            whole.append(line)
    if len(whole) < len(lines):
        write_text(journal, "\n".join(whole) + "\n")
    return outcomes
