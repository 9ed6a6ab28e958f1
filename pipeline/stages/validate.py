"""The validate stage: contact forces of expert episodes against real ones, speed, and the wire against rod theory."""

from __future__ import annotations

import json
import logging
import subprocess
import sys
import time
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.report.force_logs import EpisodeForces, pooled, read_forces, table_rows
from pipeline.report.plots.forces import draw_boxes, draw_distribution, draw_heat
from pipeline.report.results import Figure, write_figures, write_results
from pipeline.settings.stage_settings import ValidateSettings
from pipeline.stages import Stage, StageContext
from pipeline.stages.phantoms import require_known_phantoms
from pipeline.store.atomic_files import write_text
from pipeline.store.errors import StageError
from pipeline.store.provenance import PROJECT_ROOT, hash_file

# Observations whose speed is measured: row of the table -> what the environment is asked for.
SPEED_MODES: dict[str, str | tuple[str, ...]] = {
    "internal": "internal",
    "image": "image",
    "sequential": "sequential",
    "image_mask": ("image", "mask"),
}
GROUP = "Force validation"
VERDICT = "verdict.txt"
_FORWARD_STEPS = 120  # about the length of a successful episode
_ROD = "benchmarks.rod.theory"
_ROD_LIMIT_S = 600.0

_LOGGER = logging.getLogger(__name__)


def check_validate(settings: ValidateSettings) -> None:
    """Refuses an unknown phantom.

    Args:
        settings: the stage's settings.

    Raises:
        ConfigurationError: listing the valid names.
    """
    require_known_phantoms([settings.phantom])


def run_validate(settings: ValidateSettings, context: StageContext) -> None:
    """Compares, measures and draws.

    Args:
        settings: the real distribution, how long to measure.
        context: where the logs lie and where to write.

    Raises:
        StageError: the expert stage left no episodes long enough to compare.
    """
    episodes = read_forces(context.inputs["expert"])
    tables = validate_forces(episodes, settings, context.path, seed=context.seed)
    tables["simulators"] = simulator_row(settings.phantom)
    tables["training_speed_fps"] = speed_rows(settings, seed=context.seed)
    if settings.physics:
        tables["wire_physics"] = physics_rows()
    write_results(context.path, tables)
    write_figures(context.path, figures(episodes, settings, context.inputs["phantoms"], context.path))


def validate_forces(
    episodes: list[EpisodeForces], settings: ValidateSettings, folder: Path, *, seed: int
) -> dict[str, Any]:
    """Tests the forces, in the phantom of the real experiments where there are episodes in it, and writes the verdict.

    Args:
        episodes: of the expert.
        settings: the real distribution.
        folder: of the stage.
        seed: of the draws from the real distribution.

    Returns:
        Table to row to column to cell.

    Raises:
        StageError: there are too few steps to compare.
    """
    from cathsim.metrics.forces import compare_forces, verdict

    inside = [episode for episode in episodes if episode.phantom == settings.phantom]
    if not inside and episodes:
        _LOGGER.warning("validate: no episodes in %s, comparing those of all phantoms", settings.phantom)
    chosen = inside or episodes
    try:
        comparison = compare_forces(
            pooled(chosen),
            real_mean_n=settings.real_mean_n,
            real_sd_n=settings.real_sd_n,
            generator=np.random.default_rng(seed),
        )
    except ValueError as error:
        raise StageError(
            f"the expert stage's episodes cannot be compared with real forces ({error}): record more of them"
        ) from error
    pushed = pushed_forces(settings.phantom, settings.speed_steps, seed=seed)
    agrees, differs = verdict(
        comparison,
        pushed,
        operators={episode.operator for episode in chosen},
        free_force_n=min((e.free_force_n for e in chosen if e.free_force_n is not None), default=None),
    )
    write_text(folder / VERDICT, f"Agrees: {agrees}\n\nDiffers: {differs}\n")
    return {"force_validation": table_rows(comparison, pushed, agrees, differs)}


def pushed_forces(phantom: str, steps: int, *, seed: int) -> np.ndarray:
    """Forces of the wire when it is fed at full speed with random rotation: what the expert's care makes of them.

    Args:
        phantom: its name.
        steps: how many.
        seed: of actions and starts.

    Returns:
        (steps,) N, largest resultant of each step.
    """
    from cathsim import NavigateEnv

    environment = NavigateEnv(phantom, observation="tip")
    generator = np.random.default_rng(seed)
    forces = []
    environment.reset(seed=seed)
    for step in range(steps):
        _, _, terminated, truncated, info = environment.step(np.array([1.0, generator.uniform(-1.0, 1.0)]))
        forces.append(info["force"])
        if terminated or truncated or (step + 1) % _FORWARD_STEPS == 0:
            environment.reset()
    return np.array(forces)


def simulator_row(phantom: str) -> dict[str, dict[str, Any]]:
    """The simulator's row of the table that compares it with others', as it runs here.

    Args:
        phantom: that is simulated.
    """
    from cathsim import NavigateEnv

    environment = NavigateEnv(phantom, observation="tip")
    links = len(environment.simulation.wire.links)
    environment.close()
    return {
        "cathsim": {
            "engine": f"MuJoCo {metadata.version('mujoco')}, contact from a distance grid",
            "catheter": "no",
            "guidewire": f"discretised, {links} links, rod's stiffness",
            "aorta": "3-D artery, generated or imported",
            "open_source": "yes",
        }
    }


def speed_rows(settings: ValidateSettings, *, seed: int) -> dict[str, dict[str, Any]]:
    """Measures the environment's speed on one core for several observations, in turns.

    Args:
        settings: how long to measure.
        seed: of actions and starts.

    Returns:
        Rows of the table `training_speed_fps`: each observation's median over the rounds, slowest and fastest.
    """
    from cathsim import NavigateEnv

    environments = {
        name: NavigateEnv(settings.phantom, observation=observation) for name, observation in SPEED_MODES.items()
    }
    rates: dict[str, list[float]] = {name: [] for name in environments}
    for index in range(settings.speed_rounds):
        for name, environment in environments.items():
            rates[name].append(steps_per_second(environment, settings.speed_steps, seed=seed + index))
    medians = {name: float(np.median(values)) for name, values in rates.items()}
    medians |= {"min": min(medians.values()), "max": max(medians.values())}
    return {name: {"value": round(value, 1)} for name, value in medians.items()}


def steps_per_second(environment: Any, steps: int, *, seed: int) -> float:
    """Speed of an environment: half of the steps with random actions, half forwards with random rotation.

    Args:
        environment: a navigation environment of two actions.
        steps: how many.
        seed: of actions and starts.

    Returns:
        Steps a second of processor time; resets count.
    """
    generator = np.random.default_rng(seed)
    spent, done = 0.0, 0
    for forward in (False, True):
        actions = generator.uniform(-1.0, 1.0, (max(steps // 2, 1), 2))
        if forward:
            actions[:, 0] = 1.0
        environment.reset(seed=seed)
        start, count = time.process_time(), 0
        for action in actions:
            _, _, terminated, truncated, _ = environment.step(action)
            count += 1
            if terminated or truncated or (forward and count >= _FORWARD_STEPS):
                environment.reset()
                count = 0
        spent += time.process_time() - start
        done += len(actions)
    return done / max(spent, 1e-9)


def physics_rows() -> dict[str, dict[str, Any]]:
    """Checks the wire against the theory of rods, in a process of its own.

    Returns:
        Rows of the table `wire_physics`: the worst error of each law, percent; none where the benchmark does not lie
        beside the pipeline.

    Raises:
        StageError: the benchmark failed.
    """
    if not (PROJECT_ROOT / "benchmarks" / "rod").is_dir():
        _LOGGER.warning("validate: benchmarks/rod/theory.py is not here, the wire is not checked against theory")
        return {}
    command = [sys.executable, "-m", _ROD, "--quick"]
    try:
        done = subprocess.run(
            command, cwd=PROJECT_ROOT, capture_output=True, text=True, timeout=_ROD_LIMIT_S, check=False
        )
    except subprocess.TimeoutExpired as error:
        raise StageError(f"{_ROD} took more than {_ROD_LIMIT_S:.0f} s: run with stage.physics=false") from error
    if done.returncode != 0:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise StageError(f"{_ROD} failed ({last}): run `python -m {_ROD} --quick` to see all of it")
    return physics_from(done.stdout)


def physics_from(output: str) -> dict[str, dict[str, Any]]:
    """Rows of the table `wire_physics` from the benchmark's output, whose last line is a JSON object.

    Args:
        output: what it printed.

    Returns:
        Law to its worst error, percent.
    """
    last = json.loads(output.strip().splitlines()[-1])
    return {
        name.removesuffix("_pct"): {"worst_error_pct": value} for name, value in last.items() if name.endswith("_pct")
    }


def wall_vertices(phantoms: Path, name: str) -> np.ndarray:
    """Vertices of a phantom's lumen surface: of the phantoms stage, or of the library where that has not built it.

    Args:
        phantoms: folder of the phantoms stage.
        name: of the phantom.

    Returns:
        (v, 3) m.
    """
    stored = phantoms / name / "lumen.stl"
    if stored.is_file():
        import trimesh

        return np.asarray(trimesh.load_mesh(stored).vertices, dtype=np.float64)
    from cathsim import load_phantom

    return np.asarray(load_phantom(name).lumen_mesh.vertices, dtype=np.float64)


def figures(episodes: list[EpisodeForces], settings: ValidateSettings, phantoms: Path, folder: Path) -> list[Figure]:
    """Draws distribution, box plots, and a heat map for each phantom.

    Args:
        episodes: of the expert.
        settings: the real distribution.
        phantoms: folder of the phantoms stage.
        folder: of the stage.

    Returns:
        What the report shows.
    """
    real = settings.real_mean_n, settings.real_sd_n
    in_phantom = [episode for episode in episodes if episode.phantom == settings.phantom]
    chosen = in_phantom or episodes
    place = settings.phantom if in_phantom else "all phantoms"
    draw_distribution(pooled(chosen), *real, folder / "distribution.png")
    draw_boxes(episodes, *real, folder / "boxes.png")
    words = " ".join((folder / VERDICT).read_text(encoding="utf-8").split())
    shown = [
        Figure(
            "Contact forces beside real ones", f"{len(chosen)} episodes in {place}. {words}", "distribution.png", GROUP
        ),
        Figure("Contact forces by arch and target", f"{len(episodes)} expert episodes.", "boxes.png", GROUP),
    ]
    for name in dict.fromkeys(episode.phantom for episode in episodes):
        inside = [episode for episode in episodes if episode.phantom == name]
        file = f"heat/{name}.png"
        draw_heat(wall_vertices(phantoms, name), inside, folder / file, title=f"{name}: contact forces on the wall")
        contacts = sum(len(episode.forces) for episode in inside)
        shown.append(
            Figure(
                f"{name}: contact forces on the vessel wall",
                f"{contacts} contacts of {len(inside)} episodes, seen from the front.",
                file,
                GROUP,
            )
        )
    return shown


def _benchmark(run_path: Path) -> dict[str, str]:
    return {f"benchmarks/{file.name}": hash_file(file) for file in (PROJECT_ROOT / "benchmarks" / "rod").glob("*.py")}


STAGE = Stage(
    name="validate",
    run=run_validate,
    reads=("phantoms", "expert"),
    writes=(
        "distribution.png, boxes.png, heat/<phantom>.png",
        VERDICT,
        "results.json",
        "figures.json",
    ),
    check=check_validate,
    further_inputs=_benchmark,
)
