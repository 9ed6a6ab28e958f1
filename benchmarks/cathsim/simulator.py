"""Speed of the environment beside dm_control's humanoid, and penetration of the wire into the wall.

    python benchmarks/cathsim/simulator.py [--quick] [--steps N]

Prints tables and, as its last line, one JSON object:
    internal, image_mask, fast   agent steps/s of the whole environment on one core: accurate preset with the internal
                                 observation, with image and mask; fast preset with image and mask
    humanoid                     mj_step/s of dm_control's humanoid in the same run
    *_ratio                      their medians over rounds in which all four take turns
    image_cost_pct               time to draw image and mask, over that of a step without them, both timed in the same
                                 loop
    realtime_factor              simulated seconds per second, internal observation
    vector_speedup               vector environment on two threads over one
    penetration_p99_mm, penetration_max_mm, nan, escapes
                                 over every substep of aggressive insertion, retraction and rotation in all phantoms:
                                 deepest point of the wire's surface in the wall; invalid states; steps in which a joint
                                 of the wire was more than 2 mm outside the lumen. The largest belongs to a tip that
                                 snaps free and hits the wall: it differs between processors, the p99 does not
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import mujoco
import numpy as np

from cathsim import ACCURACY, PHANTOMS, NavigateEnv, Simulation, ThreadedVectorEnv, load_guidewire, load_phantom
from cathsim.environment import ROTATION_STEP, TRANSLATION_STEP
from cathsim.observations.observables import make_observable
from cathsim.physics_checks.unguided import steps_per_second
from cathsim.simulation import CONTROL_STEP

FORWARD_STEPS = 120  # about the length of a successful episode
ESCAPE = 0.002  # m


def humanoid_rate(steps: int) -> float:
    """mj_step/s of dm_control's humanoid, standing up from its initial state and falling."""
    import dm_control

    folder = Path(dm_control.__file__).parent / "suite"
    assets = {f"./common/{path.name}": path.read_bytes() for path in (folder / "common").glob("*.xml")}
    model = mujoco.MjModel.from_xml_string((folder / "humanoid.xml").read_text(), assets)
    data = mujoco.MjData(model)
    start = time.process_time()
    mujoco.mj_step(model, data, nstep=steps)
    return steps / (time.process_time() - start)


def image_cost(steps: int) -> float:
    """Time for image and mask as a share of a step without them, %; advancing and random actions in turn."""
    environment = NavigateEnv(observation="tip")
    pictures = [make_observable(name, environment.simulation, environment.fluoroscope) for name in ("image", "mask")]
    generator = np.random.default_rng(0)
    stepping = drawing = 0.0
    environment.reset(seed=0)
    for step in range(steps):
        action = generator.uniform(-1.0, 1.0, 2)
        if step // FORWARD_STEPS % 2:
            action[0] = 1.0
        start = time.process_time()
        _, _, terminated, truncated, _ = environment.step(action)
        middle = time.process_time()
        for picture in pictures:
            picture.read()
        drawing += time.process_time() - middle
        stepping += middle - start
        if terminated or truncated or (step + 1) % (2 * FORWARD_STEPS) == 0:
            environment.reset()
    return 100 * drawing / stepping


def speeds(rounds: int, steps: int) -> dict[str, float]:
    """Median rates and ratios over rounds in which everything takes its turn."""
    environments = {
        "internal": NavigateEnv(observation="internal"),
        "image_mask": NavigateEnv(observation=("image", "mask")),
        "fast": NavigateEnv(observation=("image", "mask"), accuracy="fast"),
    }
    rows: list[dict[str, float]] = []
    for index in range(rounds):
        row = {"humanoid": humanoid_rate(steps * 30)}
        row |= {name: steps_per_second(environment, steps, seed=index) for name, environment in environments.items()}
        rows.append(row)
    median = {name: statistics.median(row[name] for row in rows) for name in rows[0]}
    ratios = {f"{name}_ratio": statistics.median(row[name] / row["humanoid"] for row in rows) for name in environments}
    cost = image_cost(steps)
    print(f"{'':12s}{'steps/s':>12s}{'over humanoid':>16s}")
    for name, value in median.items():
        print(f"{name:12s}{value:12.0f}{ratios.get(name + '_ratio', 1.0):16.4f}")
    print(f"image and mask cost {cost:.1f} % of a step\n")
    return {**median, **ratios, "image_cost_pct": cost, "realtime_factor": median["internal"] * CONTROL_STEP}


def vector_speedup(rounds: int, steps: int) -> float:
    """How much faster a vector environment is with two threads than with one, median over rounds."""
    count = 16
    vectors = {threads: ThreadedVectorEnv(count, threads=threads, observation=("image", "mask")) for threads in (1, 2)}
    ratios = []
    for index in range(rounds):
        rates = {}
        for threads, vector in vectors.items():
            generator = np.random.default_rng(index)
            vector.reset(seed=index)
            start = time.perf_counter()
            for _ in range(steps):
                actions = generator.uniform(-1.0, 1.0, (count, 2))
                actions[:, 0] = np.abs(actions[:, 0])
                vector.step(actions)
            rates[threads] = count * steps / (time.perf_counter() - start)
        ratios.append(rates[2] / rates[1])
    for vector in vectors.values():
        vector.close()
    print(f"vector environment of {count}: {statistics.median(ratios):.2f} x on two threads\n")
    return statistics.median(ratios)


def aggression(name: str, steps: int) -> tuple[np.ndarray, int, int, float, str]:
    """Bursts of full insertion, retraction and rotation; depths (mm), invalid states, escapes, force p99, deepest."""
    wire = load_guidewire("default")
    simulation = Simulation(load_phantom(name), wire, ACCURACY["accurate"], measure_penetration=True)
    generator = np.random.default_rng(0)
    depths, forces, invalid, escapes = [], [], 0, 0
    translation = rotation = deepest = 0.0
    where = ""
    for step in range(steps):
        before = simulation.tip
        if step % 400 == 0:
            simulation.reset(0.0, generator.uniform(-np.pi, np.pi))
        if step % 20 == 0:
            # two bursts of three go in, and the first of every 400 steps do
            translation = 1.0 if step % 400 < 120 or generator.random() < 0.65 else -1.0
            rotation = generator.choice([-1.0, 0.0, 1.0])
        simulation.advance(TRANSLATION_STEP * translation, ROTATION_STEP * rotation)
        depths.append(simulation.depths.copy())
        forces.append(simulation.summary.force_max)
        if simulation.depths.max() > deepest:
            deepest, moved = float(simulation.depths.max()), 1e3 * float(np.linalg.norm(simulation.tip - before))
            drive, tip = "in" if translation > 0 else "out", ", ".join(f"{1e3 * x:.0f}" for x in simulation.tip)
            where = f"step {step}, drive {drive}, tip at ({tip}) mm, moved by {moved:.1f} mm"
        if not simulation.valid:
            invalid += 1
            simulation.reset()
        escapes += bool((simulation.vessel.distance(simulation.inserted_points())[0] < -ESCAPE).any())
    return np.concatenate(depths) * 1e3, invalid, escapes, float(np.percentile(forces, 99)), where


def penetration(steps: int) -> dict[str, float]:
    """Penetration over `steps` agent steps shared among all phantoms."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        results = list(pool.map(lambda name: aggression(name, steps // len(PHANTOMS)), PHANTOMS))
    print(
        f"{'penetration, mm':18s}{'p50':>8s}{'p99':>8s}{'max':>8s}{'invalid':>9s}{'escapes':>9s}{'force p99, N':>14s}"
        "  deepest at"
    )
    for name, (depths, invalid, escapes, force, where) in zip(PHANTOMS, results, strict=True):
        p50, p99 = np.percentile(depths, [50, 99])
        print(f"{name:18s}{p50:8.3f}{p99:8.3f}{depths.max():8.3f}{invalid:9d}{escapes:9d}{force:14.3f}  {where}")
    everything = np.concatenate([result[0] for result in results])
    print(f"{len(everything)} substeps of preset 'accurate'\n")
    return {
        "penetration_p99_mm": float(np.percentile(everything, 99)),
        "penetration_max_mm": float(everything.max()),
        "nan": sum(result[1] for result in results),
        "escapes": sum(result[2] for result in results),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="fewer steps, under 50 s")
    parser.add_argument("--steps", type=int, help="agent steps of the penetration test (40000, quick 3000)")
    arguments = parser.parse_args()
    quick = arguments.quick
    result = speeds(rounds=3 if quick else 9, steps=600 if quick else 1500)
    result["vector_speedup"] = vector_speedup(rounds=3 if quick else 7, steps=150)
    result |= penetration(arguments.steps or (3000 if quick else 40000))
    print(json.dumps({name: round(value, 4) for name, value in result.items()}))


if __name__ == "__main__":
    main()
