"""An anatomy of your own: an arch by its measures, a mesh, or a label volume.

python examples/own_anatomy.py [arch.stl | segmentation.nii.gz]
"""

from __future__ import annotations

import sys

import gymnasium

import cathsim
from cathsim.anatomy import ArchParameters


def main(path: str | None = None, steps: int = 100) -> dict[str, float]:
    """Push and turn the wire; give what was inserted (m) and the largest force (N)."""
    measures = ArchParameters(apex_ratio=1.2, arch_width=0.072, bovine=True, bca_diameter=0.016)  # m
    phantom = cathsim.load_phantom(path) if path else cathsim.load_phantom("mine", parameters=measures)
    print(f"{phantom.name}: targets {', '.join(phantom.targets)}")
    target = "lcca" if "lcca" in phantom.targets else next(iter(phantom.targets))
    wire = cathsim.load_guidewire("radifocus_angled").scaled(0.36)  # m
    env = gymnasium.make("cathsim/Navigate-v0", phantom=phantom, target=target, wire=wire, observation="tip")
    env.reset(seed=0)
    largest = 0.0
    for _ in range(steps):
        _, _, terminated, truncated, info = env.step([1.0, 0.3])  # 2 mm forwards, 4.5 degrees
        largest = max(largest, info["force"])
        if terminated or truncated:
            break
    print(f"{1e3 * info['insertion']:.0f} mm inserted, {1e3 * info['distance']:.0f} mm from the {target}")
    return {"insertion": info["insertion"], "force": largest}


if __name__ == "__main__":
    main(*sys.argv[1:2])
