"""Twist of a bent catheter that is turned in a bent sheath: angle of the tip against that of the hub, beside theory.

    python benchmarks/devices/torsion.py [--output FILE.png]

The catheter has one bend over its last 60 mm, which lie in a sheath of 25 mm radius of curvature; the rest is straight.
Theory is the pendulum's equation (`cathsim.physics_checks.two_devices.theoretical_hub_angle`): where it gives several
tip angles for a hub angle, the tip lags and then whips round. Prints a table for several torsional stiffnesses and one
JSON line: hub_error_deg, the largest difference between the hub's angle and that which theory gives for the simulated
tip's, over the stable stretch; whip_error_deg, the largest difference of the hub's angles at which the tip whips round.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from cathsim.devices.catheter import Catheter
from cathsim.physics_checks.two_devices import SHEATH_ARC, theoretical_hub_angle, tips_in_bent_sheath

STIFFNESSES_NMM2 = (3000.0, 1000.0, 500.0)  # GJ
STEP_DEG = 1.0  # of the hub
LENGTH = 0.10  # from hub to tip, m
BEND = 1.8  # rad


def bent_catheter(torsional_stiffness_nmm2: float) -> Catheter:
    """A catheter of one stiffness, 300 N mm^2, with a bend of `BEND` over the sheath's."""
    return Catheter(
        shape=((0.0, SHEATH_ARC, BEND, 0.0),),
        torsional_stiffness_nmm2=torsional_stiffness_nmm2,
        taper=(0.0, 0.0),
        tip_stiffness_nmm2=300.0,
        length=LENGTH,
    )


def main() -> None:
    """Turns each catheter once round, prints the table and a JSON line, and draws the angles."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--output", type=Path, help="of the picture (PNG)")
    output = parser.parse_args().output
    hubs = np.radians(np.arange(0.0, 361.0, STEP_DEG))
    curves, errors, whips = [], [0.0], [0.0]
    print(f"{'GJ, N mm2':>10} {'largest lag, deg':>17} {'error, deg':>11} {'whip at':>8} {'theory':>8}")
    for stiffness in STIFFNESSES_NMM2:
        catheter = bent_catheter(stiffness)
        tips = tips_in_bent_sheath(catheter, hubs)
        free = np.linspace(0.0, 2 * np.pi, 361)
        theory = np.array([theoretical_hub_angle(catheter, tip) for tip in free])
        jump = int(np.argmax(np.diff(tips)))
        whips_round = np.diff(tips)[jump] > 1.0
        stable = slice(0, jump + 1) if whips_round else slice(None)
        expected = np.array([theoretical_hub_angle(catheter, tip) for tip in tips[stable]])
        error = float(np.degrees(np.abs(expected - hubs[stable]).max()))
        errors.append(error)
        lag = float(np.degrees((hubs - tips).max()))
        at, critical = "-", "-"
        if whips_round:
            highest = float(np.degrees(theory[: len(free) // 2 + 1].max()))
            whips.append(abs(float(np.degrees(hubs[jump + 1])) - highest))
            at, critical = f"{np.degrees(hubs[jump + 1]):.0f}", f"{highest:.1f}"
        print(f"{stiffness:10.0f} {lag:17.1f} {error:11.3f} {at:>8} {critical:>8}")
        curves.append((stiffness, tips, free, theory))
    print(json.dumps({"hub_error_deg": round(max(errors), 3), "whip_error_deg": round(max(whips), 3)}))
    if output is not None:
        draw(curves, np.degrees(hubs), output)


def draw(curves: list[tuple[float, np.ndarray, np.ndarray, np.ndarray]], hubs_deg: np.ndarray, output: Path) -> None:
    """Draws tip against hub angles, simulated and by theory."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(6.0, 5.0), layout="constrained")
    for index, (stiffness, tips, free, theory) in enumerate(curves):
        colour = f"C{index}"
        axes.plot(np.degrees(theory), np.degrees(free), "--", color=colour, linewidth=1)
        axes.plot(hubs_deg, np.degrees(tips), color=colour, label=f"GJ {stiffness:.0f} N mm²")
    axes.plot([], [], "--", color="grey", label="theory, unstable part too")
    axes.plot([0, 360], [0, 360], ":", color="black", label="rigid twist")
    axes.set(xlabel="hub (deg)", ylabel="tip (deg)", xlim=(0, 360), ylim=(0, 360))
    axes.grid(alpha=0.3)
    axes.legend()
    output.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(output, dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    main()
