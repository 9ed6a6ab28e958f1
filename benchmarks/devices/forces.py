"""What a load cell under the phantom reads, by device, friction, operator and target, beside a measured distribution.

    python benchmarks/devices/forces.py [--quick] [--seeds N] [--devices A,B] [--policy FILE] [--json FILE] [--png FILE]

Episodes in Type I to within 8 mm of the target, at most 300 steps; nothing is fitted. Of every control step: the
reading of the load cell (ATI Mini40, SI-20-1, low-pass of 2 Hz), the mean sum of the contacts' magnitudes, and the
largest single contact. Devices: "wire", or a catheter of `cathsim.devices` over that wire. Operators: "expert", the
sampling expert (wire alone); "search", which carries out the best of some motion primitives, for every device;
"random"; "push_and_turn", scripted motions without a target; "enn", a policy of --policy (wire alone).

Further parts: the expert's motions fed again into walls of other stiffness (1 ms); normal force over depth at rest,
over the stiffness asked for; the force of the flow alone. Intervals: 95 %, bootstrap over episodes. Prints tables and,
as its last line, one JSON object. --quick takes one seed, two frictions and one catheter.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import json
import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray

from cathsim import ACCURACY, NavigateEnv, Phantom, Simulation, load_guidewire, load_phantom
from cathsim.blood.field import blood_field
from cathsim.blood.flow import FLOWS
from cathsim.contact.compliance import stiffest_wall
from cathsim.devices.pair import DevicePair
from cathsim.devices.shelf import load_catheter
from cathsim.devices.simulation import DualSimulation
from cathsim.environment import ROTATION_STEP, TRANSLATION_STEP
from cathsim.metrics.load_cell import MINI40, StepForces, step_forces
from cathsim.navigation import NavigationTask
from cathsim.planning.sampling import SamplingExpert
from cathsim.planning.scripted_motions import MAX_ADVANCE, MAX_TURN, RandomMoves
from cathsim.simulation import CONTROL_STEP

Array = NDArray[np.float64]
Act = Callable[[], Array]  # the next motion, in shares of a full step

REAL_MEAN, REAL_SD = 0.40, 0.19  # N, a catheter steered through a robot in a silicone phantom of Type I
PHANTOM = "type_1"
TARGETS = ("bca", "lcca")
FRICTIONS, QUICK_FRICTIONS = (0.03, 0.06, 0.1, 0.2), (0.06, 0.2)
WALLS = (None, 1.0, 2.0, 5.0, 10.0)  # N/mm
QUANTITIES = {"load_cell": "load cell", "sum": "sum of magnitudes", "largest": "largest contact"}
RESAMPLES = 2000
CATHETERS = ("vertebral", "simmons2")
MOST_STEPS, SUCCESS_RADIUS = 300, 8.0e-3  # m
LAST_STEPS = 30
# of the search: steps of a plan, steps that are carried out, random plans of two primitives
LOOK_AHEAD, HOLD, MIXED = 18, 6, 12
FREE_FORCE, FORCE_COST = 0.15, 0.004  # N, m/N: those of the sampling expert
# translation and rotation of the wire, then of the catheter, in shares of a full step
PRIMITIVES = np.array(
    [
        *((1, 0, 1, 0), (1, 0.7, 1, 0), (1, -0.7, 1, 0), (1, 0, 1, 0.7), (1, 0, 1, -0.7)),
        *((1, 0, 0, 0), (1, 0.7, 0, 0), (1, -0.7, 0, 0), (0, 0, 1, 0), (0, 1, 0, 1), (0, -1, 0, -1)),
        *((0, 1, 0, 0), (0, -1, 0, 0), (0, 0, 0, 1), (0, 0, 0, -1), (-1, 0, 0, 0), (0, 0, -1, 0), (-1, 0, -1, 0)),
    ],
    dtype=float,
)


@dataclasses.dataclass
class Scene:
    """The task of an episode: devices of one friction in a phantom, and where the tip is to go."""

    phantom: Phantom
    device: str
    friction: float
    target: str

    def __post_init__(self) -> None:
        self.task = NavigationTask(self.target)
        self.goal = self.task.goal(self.phantom)


@dataclasses.dataclass
class Episode:
    """Forces of one episode, a row a control step.

    Attributes:
        loads: mean force on the vessel, N, world frame. Shape (T, 3).
        sheath: mean force on the sheath, N. Shape (T, 3).
        sums, largest, resultants: N; the last is the largest resultant of a step. Shape (T,).
        motions: of the feeders, in shares of a full step. Shape (T, 2 or 4).
    """

    device: str
    friction: float
    operator: str
    target: str
    seed: int
    success: bool
    loads: Array
    sheath: Array
    sums: Array
    largest: Array
    resultants: Array
    motions: Array

    def quantities(self) -> dict[str, Array]:
        """The compared quantities, N. Shape (T,) each."""
        return {"load_cell": self.reading("SI-20-1"), "sum": self.sums, "largest": self.largest}

    def reading(self, calibration: str, *, sheath: bool = False, **changes: Any) -> Array:
        """Magnitudes of a load cell's readings, N. Shape (T,)."""
        cell = dataclasses.replace(MINI40[calibration], **changes)
        loads = self.loads + self.sheath if sheath else self.loads
        readings = cell.read(loads, interval=CONTROL_STEP, generator=np.random.default_rng(self.seed))
        return np.linalg.norm(readings, axis=1)


def simulation_of(phantom: Phantom, device: str, friction: float, accuracy: str) -> Simulation:
    """The wire alone, or a catheter over it, both of one friction."""
    wire, numerics = load_guidewire("default", friction=friction), ACCURACY[accuracy]
    if device == "wire":
        return Simulation(phantom, wire, numerics)
    return DualSimulation(phantom, DevicePair(wire, load_catheter(device, friction=friction)), numerics)


def move(simulation: Simulation, motion: Array) -> None:
    """One control step: translation and rotation of the wire, then of the catheter, in shares of a full step."""
    steps = motion * np.tile((TRANSLATION_STEP, ROTATION_STEP), len(motion) // 2)
    if isinstance(simulation, DualSimulation):
        simulation.advance(steps[0], steps[1], catheter=(steps[2], steps[3]))
    else:
        simulation.advance(steps[0], steps[1])


def motions_of(device: str) -> int:
    """How many numbers a motion has."""
    return 2 if device == "wire" else 4


def search(scene: Scene, simulation: Simulation, generator: np.random.Generator) -> Act:
    """Carries out the best of the motion primitives, looked for every `HOLD` steps in a copy of the simulation."""
    copy = simulation_of(scene.phantom, scene.device, scene.friction, "fast")
    primitives = PRIMITIVES if motions_of(scene.device) == 4 else np.unique(PRIMITIVES[:, :2], axis=0)
    plan: list[Array] = []

    def cost(first: Array, second: Array, state: Array) -> float:
        copy.restore(state)
        force = 0.0
        for step in range(LOOK_AHEAD):
            move(copy, first if step < LOOK_AHEAD // 2 else second)
            if not copy.valid:
                return np.inf
            force += max(float(copy.summary.force_max) - FREE_FORCE, 0.0) / LOOK_AHEAD
            if np.linalg.norm(copy.tip - scene.goal) < 0.9 * SUCCESS_RADIUS:
                return -1.0 + 0.01 * step + FORCE_COST * force
        return scene.task.remaining(scene.phantom, copy.tip) + FORCE_COST * force

    def act() -> Array:
        if not plan:
            state = simulation.state()
            mixed = primitives[generator.integers(len(primitives), size=(MIXED, 2))]
            tried = [(one, one) for one in primitives] + [(one[0], one[1]) for one in mixed]
            best = min(tried, key=lambda one: cost(*one, state))
            plan.extend([best[0]] * HOLD)
        return plan.pop()

    return act


def expert(scene: Scene, simulation: Simulation, generator: np.random.Generator) -> Act:
    """The sampling expert, with the wire alone."""
    environment = NavigateEnv(scene.phantom, scene.target, wire=simulation.wire, observation="tip")
    environment.simulation = simulation
    return SamplingExpert(environment, seed=int(generator.integers(2**31)), threads=1).action


def uniform(scene: Scene, simulation: Simulation, generator: np.random.Generator) -> Act:
    """Uniformly random motions."""
    return lambda: generator.uniform(-1.0, 1.0, motions_of(scene.device))


def push_and_turn(scene: Scene, simulation: Simulation, generator: np.random.Generator) -> Act:
    """The scripted motion "advance" of each device, without a look at the target."""
    moves = [RandomMoves("advance", generator) for _ in range(motions_of(scene.device) // 2)]
    return lambda: np.concatenate([one.next() for one in moves]) / np.tile((MAX_ADVANCE, MAX_TURN), len(moves))


OPERATORS = {"expert": expert, "search": search, "random": uniform, "push_and_turn": push_and_turn}


def run_episode(phantom: Phantom, device: str, friction: float, operator: str, target: str, seed: int) -> Episode:
    """Steers one episode."""
    generator = np.random.default_rng((seed, TARGETS.index(target)))
    scene = Scene(phantom, device, friction, target)
    simulation = simulation_of(phantom, device, friction, "accurate")
    scene.task.start(simulation, generator)
    act = OPERATORS[operator](scene, simulation, generator)
    rows, motions, resultants = [], [], []
    success = False
    while not success and len(rows) < MOST_STEPS and simulation.valid:
        motions.append(np.asarray(act(), np.float64))
        move(simulation, motions[-1])
        rows.append(step_forces(simulation))
        resultants.append(float(simulation.summary.force_max))
        success = bool(np.linalg.norm(simulation.tip - scene.goal) <= SUCCESS_RADIUS)
    return episode_of((device, friction, operator, target, seed, success), rows, resultants, motions)


def run_policy(phantom: Phantom, friction: float, target: str, seed: int, file: Path) -> Episode:
    """An episode of a trained policy with the wire alone."""
    from enn.policy import Policy, PolicyController

    policy = Policy.load(file)
    wire = load_guidewire("default", friction=friction)
    environment = NavigateEnv(phantom, target, wire=wire, observation=policy.keys)
    controller = PolicyController(policy, seed=seed)
    observation, info = environment.reset(seed=seed)
    rows, motions, resultants = [], [], []
    ended = False
    while not ended:
        motions.append(np.asarray(controller(observation), np.float64))
        observation, _, terminated, truncated, info = environment.step(motions[-1])
        rows.append(step_forces(environment.simulation))
        resultants.append(info["force"])
        ended = terminated or truncated
    environment.close()
    return episode_of(("wire", friction, "enn", target, seed, bool(info["success"])), rows, resultants, motions)


def episode_of(
    case: tuple[str, float, str, str, int, bool],
    rows: Sequence[StepForces],
    resultants: Sequence[float],
    motions: Sequence[Array],
) -> Episode:
    """Stacks the steps of an episode."""
    return Episode(
        *case,
        loads=np.array([row.load for row in rows]),
        sheath=np.array([row.sheath for row in rows]),
        sums=np.array([row.magnitude_sum for row in rows]),
        largest=np.array([row.largest_contact for row in rows]),
        resultants=np.array(resultants),
        motions=np.array(motions),
    )


def moments(samples: Sequence[Array], generator: np.random.Generator) -> dict[str, Any]:
    """Mean and SD over the steps of all episodes, with 95 % intervals over episodes; 5th, 50th, 95th percentile; N."""
    sizes = np.array([len(sample) for sample in samples])
    sums, squares = (np.array([(sample**power).sum() for sample in samples]) for power in (1, 2))
    drawn = generator.integers(len(samples), size=(RESAMPLES, len(samples)))
    n = sizes[drawn].sum(1)
    means = sums[drawn].sum(1) / n
    sds = np.sqrt(np.maximum(squares[drawn].sum(1) / n - means**2, 0.0))
    pooled = np.concatenate(samples)
    return {
        "mean": float(pooled.mean()),
        "sd": float(pooled.std()),
        "mean_interval": np.percentile(means, [2.5, 97.5]).tolist(),
        "sd_interval": np.percentile(sds, [2.5, 97.5]).tolist(),
        "percentiles": np.percentile(pooled, [5, 50, 95]).tolist(),
        "sd_of_episode_means": float(np.std([sample.mean() for sample in samples])),
    }


def summarise(episodes: Sequence[Episode], keys: Sequence[str]) -> list[dict[str, Any]]:
    """One row for every combination of the attributes `keys` that there are episodes of."""
    rows, generator = [], np.random.default_rng(0)
    groups = dict.fromkeys(tuple(getattr(one, key) for key in keys) for one in episodes)
    for group in groups:
        chosen = [one for one in episodes if tuple(getattr(one, key) for key in keys) == group]
        row: dict[str, Any] = dict(zip(keys, group, strict=True))
        row |= {
            "episodes": len(chosen),
            "steps": sum(len(one.sums) for one in chosen),
            "success_pct": 100.0 * float(np.mean([one.success for one in chosen])),
        }
        for name in QUANTITIES:
            row[name] = moments([one.quantities()[name] for one in chosen], generator)
        last = np.concatenate([one.reading("SI-20-1")[-LAST_STEPS:] for one in chosen])
        row["load_cell_last_30"] = {"mean": float(last.mean()), "sd": float(last.std())}
        reading = np.concatenate([one.reading("SI-20-1") for one in chosen])
        row["above_real_mean_pct"] = 100.0 * float(np.mean(reading > REAL_MEAN))
        rows.append(row)
    return rows


def cell_settings(episodes: Sequence[Episode]) -> dict[str, dict[str, float]]:
    """Mean and SD of the reading with other settings of the cell, over the same episodes, N."""
    variants: dict[str, dict[str, Any]] = {
        "true load": {"calibration": "SI-20-1", "resolution": (0.0, 0.0, 0.0), "cutoff": 0.0},
        **{name: {"calibration": name} for name in MINI40},
        "no filter": {"calibration": "SI-20-1", "cutoff": 0.0},
        "filter of 0.5 Hz": {"calibration": "SI-20-1", "cutoff": 0.5},
        "tared": {"calibration": "SI-20-1", "tared": True},
        "with the sheath": {"calibration": "SI-20-1", "sheath": True},
    }
    rows = {}
    for name, settings in variants.items():
        pooled = np.concatenate([one.reading(**settings) for one in episodes])
        rows[name] = {"mean": float(pooled.mean()), "sd": float(pooled.std())}
    largest = np.concatenate([one.resultants for one in episodes])
    rows["largest resultant of a step"] = {"mean": float(largest.mean()), "sd": float(largest.std())}
    return rows


def replay(phantom: Phantom, episode: Episode, wall: float | None) -> dict[str, Array]:
    """Feeds an episode's motions into a wall of another stiffness with steps of 1 ms; load and sum of each step, N."""
    wire = load_guidewire("default", friction=episode.friction)
    simulation = Simulation(phantom, wire, ACCURACY["reference"], wall_stiffness=wall)
    loads, sums = [], []
    for motion in episode.motions:
        move(simulation, motion)
        forces = step_forces(simulation)
        loads.append(float(np.linalg.norm(forces.load)))
        sums.append(forces.magnitude_sum)
    return {"load": np.array(loads), "sum": np.array(sums)}


def replay_rows(phantom: Phantom, episodes: Sequence[Episode]) -> list[dict[str, Any]]:
    """Mean forces of replays by the wall's stiffness, and the ratio to the usual wall's with its interval."""
    rows: list[dict[str, Any]] = []
    generator = np.random.default_rng(0)
    base: dict[str, Array] = {}
    drawn = generator.integers(len(episodes), size=(RESAMPLES, len(episodes)))
    for wall in WALLS:
        runs = [replay(phantom, episode, wall) for episode in episodes]
        row: dict[str, Any] = {"wall_n_per_mm": wall, "episodes": len(runs)}
        for name in ("load", "sum"):
            means = np.array([run[name].mean() for run in runs])
            base.setdefault(name, means)
            ratios = means[drawn].mean(1) / base[name][drawn].mean(1)
            row[name] = {"mean": float(means.mean()), "ratio": float(means.mean() / base[name].mean())}
            row[name]["ratio_interval"] = np.percentile(ratios, [2.5, 97.5]).tolist()
        rows.append(row)
    return rows


def stiffness_errors(phantom: Phantom, accuracy: str, stiffness: float, seeds: int) -> dict[str, Any]:
    """Normal force over depth at rest, over the stiffness that was asked for."""
    simulation = Simulation(phantom, load_guidewire("default"), ACCURACY[accuracy], wall_stiffness=stiffness)
    wall, ratios = simulation.model.geom("vessel").id, []
    for seed in range(seeds):
        generator = np.random.default_rng(seed)
        simulation.reset(rotation=generator.uniform(-np.pi, np.pi))
        for _ in range(100):
            simulation.advance(TRANSLATION_STEP, 0.15 * generator.standard_normal())
        for _ in range(40):
            simulation.advance(0.0, 0.0)
        data = simulation.data
        for contact in data.contact:
            if contact.geom[1] == wall and contact.efc_address >= 0:
                force = float(data.efc_force[contact.efc_address])
                if force > 1e-3:
                    ratios.append(force / -contact.dist / 1000.0 / stiffness)
    low, median, high = np.percentile(ratios, [5, 50, 95]).tolist()
    return {
        "accuracy": accuracy,
        "asked_n_per_mm": stiffness,
        "median": median,
        "p5": low,
        "p95": high,
        "contacts": len(ratios),
    }


def flow_force(phantom: Phantom) -> dict[str, float]:
    """Force of the pulsatile flow on the empty vessel, N: change of momentum, without the pressure at the ends.

    In the direction of the stream the fluid's momentum per length is density x flow; what enters at the root and what
    leaves at the ends carries density x flow^2 / area (a blunt profile).
    """
    field = blood_field(phantom, FLOWS["pulsatile"])
    density, period = field.flow.density, 1.0 / field.flow.heart_rate
    times = np.arange(96) / 96 * period
    flow = field.flow_rate(times)
    rate = (np.roll(flow, -1) - np.roll(flow, 1)) / (2 * period / 96)
    stored, flux = np.zeros(3), np.zeros(3)
    for branch in phantom.tree:
        arc = np.linspace(0.0, branch.length, 400)
        downstream = -1.0 if branch.parent is None else 1.0
        tangent, carried = downstream * branch.tangent_at(arc), field.carried(branch.name, arc)
        stored += np.trapezoid(carried[:, None] * tangent, arc, axis=0)
        area = np.pi * branch.radius_at(arc) ** 2
        if branch.parent is None:
            flux += carried[-1] ** 2 / area[-1] * tangent[-1] - carried[0] ** 2 / area[0] * tangent[0]
        elif branch.open_end:
            flux -= carried[-1] ** 2 / area[-1] * tangent[-1]
    force = density * (flow[:, None] ** 2 * flux - rate[:, None] * stored)
    size = np.linalg.norm(force, axis=1)
    return {"mean": float(size.mean()), "sd": float(size.std()), "max": float(size.max())}


def draw(episodes: Sequence[Episode], file: Path) -> None:
    """Draws the three quantities by device, operator and friction beside the measured distribution."""
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    rows = list(dict.fromkeys((one.device, one.operator) for one in episodes))
    frictions = sorted({one.friction for one in episodes})
    colours = [
        (0.75 - 0.6 * share, 0.85 - 0.5 * share, 0.95 - 0.3 * share) for share in np.linspace(0, 1, len(frictions))
    ]
    figure = Figure(figsize=(11.0, 1.6 + 0.7 * len(rows)), layout="constrained")
    for axes, (name, label) in zip(figure.subplots(1, 3, sharey=True), QUANTITIES.items(), strict=True):
        axes.axvspan(REAL_MEAN - REAL_SD, REAL_MEAN + REAL_SD, color="tab:orange", alpha=0.2)
        axes.axvline(REAL_MEAN, color="tab:orange")
        for place, (device, operator) in enumerate(rows):
            for index, friction in enumerate(frictions):
                chosen = [
                    one for one in episodes if (one.device, one.operator, one.friction) == (device, operator, friction)
                ]
                if not chosen:
                    continue
                box = axes.boxplot(
                    [np.concatenate([one.quantities()[name] for one in chosen])],
                    positions=[place + 0.8 * ((index + 0.5) / len(frictions) - 0.5)],
                    widths=0.7 / len(frictions),
                    orientation="horizontal",
                    whis=(5, 95),
                    showfliers=False,
                    showmeans=True,
                    patch_artist=True,
                    medianprops={"color": "black"},
                    meanprops={"markersize": 4, "markerfacecolor": "black", "markeredgecolor": "black"},
                )
                box["boxes"][0].set(facecolor=colours[index], alpha=1.0)
        axes.set(xlabel=f"{label} (N)", xscale="log", xlim=(2e-3, 20.0))
        axes.set_yticks(range(len(rows)), [f"{device}\n{operator.replace('_', ' ')}" for device, operator in rows])
        axes.invert_yaxis() if axes.get_subplotspec().is_first_col() else None
        axes.grid(axis="x", alpha=0.3)
    handles = [
        Patch(color=colour, label=f"friction {friction:g}") for colour, friction in zip(colours, frictions, strict=True)
    ]
    handles.append(Patch(color="tab:orange", alpha=0.3, label=f"measured, {REAL_MEAN:.2f} ± {REAL_SD:.2f} N"))
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), fontsize=8)
    figure.suptitle(
        "Box: quartiles; whiskers: 5 and 95 %; triangle: mean; all steps, both targets; logarithmic", fontsize=9
    )
    figure.savefig(file, dpi=140)


def print_rows(rows: Sequence[dict[str, Any]], keys: Sequence[str]) -> None:
    """Prints a table of `summarise`."""
    head = [*keys, "episodes", "steps", "success %", *QUANTITIES, "load cell, last 30", "above 0.40 N %"]
    print("| " + " | ".join(head) + " |\n" + "|---" * len(head) + "|")
    for row in rows:
        cells = [str(row[key]) for key in keys] + [str(row["episodes"]), str(row["steps"]), f"{row['success_pct']:.0f}"]
        for name in QUANTITIES:
            one = row[name]
            low, high = one["mean_interval"]
            cells.append(f"{one['mean']:.3f} ± {one['sd']:.3f} [{low:.3f}, {high:.3f}]")
        cells.append(f"{row['load_cell_last_30']['mean']:.3f} ± {row['load_cell_last_30']['sd']:.3f}")
        print("| " + " | ".join([*cells, f"{row['above_real_mean_pct']:.1f}"]) + " |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="one seed, two frictions, fewer replays")
    parser.add_argument("--seeds", type=int, default=6, help="episodes of each combination")
    parser.add_argument("--devices", help="wire, or presets of catheters, with commas between")
    parser.add_argument("--policy", type=Path, help="file of a trained policy")
    parser.add_argument("--json", type=Path, help="file for the JSON object")
    parser.add_argument("--png", type=Path, help="file for the figure")
    arguments = parser.parse_args()
    began = time.perf_counter()
    frictions, seeds = (QUICK_FRICTIONS, 1) if arguments.quick else (FRICTIONS, arguments.seeds)
    devices = (
        arguments.devices.split(",") if arguments.devices else ["wire", *CATHETERS[: 1 if arguments.quick else None]]
    )
    phantom = load_phantom(PHANTOM)
    episodes = []
    for device, friction, operator, target, seed in itertools.product(
        devices, frictions, OPERATORS, TARGETS, range(seeds)
    ):
        if operator != "expert" or device == "wire":
            episodes.append(run_episode(phantom, device, friction, operator, target, seed))
    if arguments.policy:
        for friction, target, seed in itertools.product(frictions, TARGETS, range(seeds)):
            episodes.append(run_policy(phantom, friction, target, seed, arguments.policy))
    result: dict[str, Any] = {"real": [REAL_MEAN, REAL_SD], "seeds": seeds}
    for title, keys in {
        "by_operator": ("device", "operator"),
        "by_friction": ("device", "operator", "friction"),
        "by_target": ("device", "operator", "target"),
        "all": ("device", "friction", "operator", "target"),
    }.items():
        result[title] = summarise(episodes, keys)
        print(f"\n{title.replace('_', ' ')}, N, mean ± SD [interval of the mean]")
        print_rows(result[title], keys)
    steered = [one for one in episodes if one.operator == "expert" and one.friction == 0.06 and one.device == "wire"]
    result["cell_settings"] = cell_settings(steered)
    result["replays"] = replay_rows(phantom, steered[: 2 if arguments.quick else None])
    pairs = [(name, stiffness) for name in ACCURACY for stiffness in (0.2, 0.5, 1.0, 2.0, 5.0, 10.0)]
    result["stiffness"] = [
        stiffness_errors(phantom, name, stiffness, 1 if arguments.quick else 6)
        for name, stiffness in pairs
        if stiffness <= stiffest_wall(ACCURACY[name]) * 1.001
    ]
    result["flow_alone"] = flow_force(phantom)
    for part in ("cell_settings", "replays", "stiffness", "flow_alone"):
        print(f"\n{part.replace('_', ' ')}")
        value = result[part]
        for row in value if isinstance(value, list) else value.items():
            print(row)
    result["seconds"] = time.perf_counter() - began
    if arguments.png:
        draw(episodes, arguments.png)
    text = json.dumps(result)
    if arguments.json:
        arguments.json.write_text(text + "\n", encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
