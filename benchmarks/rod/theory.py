"""The simulated wire against the theory of rods: elastica, Euler buckling, capstan, helix in a tube.

Every case is the project's own `Guidewire`, contact code and integrator; the table shows each one, the last line the
worst error (%) of each law: elastica_pct, buckling_pct, capstan_pct, helix_pct.
"""

from __future__ import annotations

import argparse
import json
import time

from benchmarks.rod.contact import capstan_cases, helix_cases
from benchmarks.rod.rig import Case
from benchmarks.rod.statics import buckling_cases, elastica_cases

TARGET_PCT = {"elastica": 1.0, "buckling": 3.0, "capstan": 5.0, "helix": 10.0}


def table(cases: list[Case]) -> str:
    """One line a case: law, parameters, measured, theory, error, remark."""
    width = max(len(case.name) for case in cases)
    lines = [f"{'law':<9} {'case':<{width}} {'measured':>10} {'theory':>10} {'error %':>8}"]
    for case in cases:
        figures = f"{case.measured:10.5f} {case.theory:10.5f} {case.error_pct:+8.3f}"
        lines.append(f"{case.group:<9} {case.name:<{width}} {figures}  {case.remark}".rstrip())
    return "\n".join(lines)


def main() -> None:
    """Runs the benchmark and prints its table and its JSON line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="fewer capstan and helix cases, under 50 s")
    quick = parser.parse_args().quick
    begin = time.perf_counter()
    cases = elastica_cases() + buckling_cases() + capstan_cases(quick) + helix_cases(quick)
    print(table(cases))
    print("elastica: deflection/length; buckling: N; capstan: tension ratio; helix: axial force N, wall force N/m")
    figures: dict[str, float] = {}
    for law, target in TARGET_PCT.items():
        figures[f"{law}_pct"] = round(max(abs(case.error_pct) for case in cases if case.group == law), 3)
        print(f"{law:<9} worst {figures[f'{law}_pct']:6.3f} %, aim {target:g} %")
    figures["wall_s"] = round(time.perf_counter() - begin, 1)
    print(json.dumps(figures))


if __name__ == "__main__":
    main()
