"""The simulated wire against the theory of rods: elastica, Euler buckling, capstan, helix in a tube.

The table shows every case of `cathsim.physics_checks`, the last line the worst error (%) of each law: elastica_pct,
buckling_pct, capstan_pct, helix_pct.
"""

from __future__ import annotations

import argparse
import json
import time

from cathsim.physics_checks import AIM_PCT, LAWS, worst_error_pct


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="fewer capstan and helix cases, under 50 s")
    quick = parser.parse_args().quick
    begin = time.perf_counter()
    laws = {law: cases(quick) for law, cases in LAWS.items()}
    width = max(len(case.name) for cases in laws.values() for case in cases)
    print(f"{'law':<9} {'case':<{width}} {'measured':>10} {'theory':>10} {'error %':>8}")
    for case in (case for cases in laws.values() for case in cases):
        figures = f"{case.measured:10.5f} {case.theory:10.5f} {case.error_pct:+8.3f}"
        print(f"{case.law:<9} {case.name:<{width}} {figures}  {case.remark}".rstrip())
    print("elastica: deflection/length; buckling: N; capstan: tension ratio; helix: axial force N, wall force N/m")
    worst = {f"{law}_pct": worst_error_pct(cases) for law, cases in laws.items()}
    for law, aim in AIM_PCT.items():
        print(f"{law:<9} worst {worst[f'{law}_pct']:6.3f} %, aim {aim:g} %")
    print(json.dumps(worst | {"wall_s": round(time.perf_counter() - begin, 1)}))


if __name__ == "__main__":
    main()
