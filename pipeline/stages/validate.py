"""The validate stage: contact forces of expert episodes against real ones, speed, and the wire against rod theory."""

from __future__ import annotations

import logging
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from annotated_types import Ge, Gt, Le

from pipeline.anatomies.settings import require_known_phantoms
from pipeline.evaluations.forces import (
    ALONE,
    QUANTITIES,
    WIRE,
    EpisodeForces,
    WallForces,
    pooled,
    pooled_wall,
    read_forces,
)
from pipeline.jobs.pool import Job, Report, run_jobs
from pipeline.plots.forces import draw_distribution, draw_heat
from pipeline.settings.kinds import Count, FolderName, validated
from pipeline.stages import Stage, StageContext
from pipeline.store.atomic_files import write_text
from pipeline.store.errors import StageError
from pipeline.store.run_folder import RunFolder
from pipeline.tables import Figure, Results

if TYPE_CHECKING:
    from cathsim.metrics.forces import ForceComparison

# Observations whose speed is measured: row of the table -> what the environment is asked for.
SPEED_MODES: dict[str, str | tuple[str, ...]] = {
    "internal": "internal",
    "image": "image",
    "sequential": "sequential",
    "image_mask": ("image", "mask"),
}
GROUP = "Force validation"
VERDICT, DISTRIBUTION = "verdict.txt", "distribution.png"

_LOGGER = logging.getLogger(__name__)


@validated()
class ValidateSettings:
    """Settings of the validation against real forces and theory."""

    name: str = "validate"
    phantom: FolderName = "type_1"  # that of the real experiments; its episodes are compared, and its speed is measured
    real_mean_n: Annotated[float, Gt(0), Le(100)] = 0.40  # normal distribution of the real forces
    real_sd_n: Annotated[float, Gt(0), Le(100)] = 0.19
    speed_steps: Count = 600  # an observation and round
    speed_rounds: Annotated[int, Ge(1), Le(100)] = 3
    physics: bool = True  # the wire against the theory of rods, most of a minute


def check_validate(settings: ValidateSettings) -> None:
    """Refuses an unknown phantom with a `ConfigurationError` that lists the valid names."""
    require_known_phantoms([settings.phantom])


def run_validate(settings: ValidateSettings, context: StageContext) -> Results:
    """Compares forces, measures the speed, checks the physics, and draws."""
    episodes = read_forces(context.inputs["expert"])
    tables = validate_forces(episodes, settings, context.path, seed=context.seed)
    tables["simulators"] = simulator_row(settings.phantom)
    tables["training_speed_fps"] = speed_rows(settings, seed=context.seed)
    if settings.physics:
        tables["wire_physics"] = physics_rows(context.folder)
    return Results(tables, figures(episodes, settings, context.inputs["phantoms"], context.path))


def validate_forces(
    episodes: list[EpisodeForces], settings: ValidateSettings, folder: Path, *, seed: int
) -> dict[str, Any]:
    """Tests the expert's forces against the real distribution and writes the verdict.

    Only episodes in the phantom of the real experiments count, unless there are none. The seed is that of the real
    sample, and of the pushed wire.
    """
    from cathsim.metrics.forces import compare_forces, verdict
    from cathsim.physics_checks.unguided import pushed_forces

    inside = [episode for episode in episodes if episode.phantom == settings.phantom]
    if not inside and episodes:
        _LOGGER.warning("validate: no episodes in %s, comparing those of all phantoms", settings.phantom)
    selection = inside or episodes
    try:
        comparison = compare_forces(
            pooled(selection),
            real_mean_n=settings.real_mean_n,
            real_sd_n=settings.real_sd_n,
            generator=np.random.default_rng(seed),
        )
    except ValueError as error:
        raise StageError(
            f"the expert stage's episodes cannot be compared with real forces ({error}): record more of them"
        ) from error
    pushed = pushed_forces(settings.phantom, settings.speed_steps, seed=seed)
    wall, devices = pooled_wall(selection), {episode.device for episode in selection}
    agrees, differs = verdict(
        comparison,
        pushed,
        None if wall is None else wall.load_cell_n,
        operators={episode.operator for episode in selection},
        catheters={name for name in devices if name != WIRE and not name.endswith(ALONE)},
        catheters_alone={name.removesuffix(ALONE) for name in devices if name.endswith(ALONE)},
        bare_wire=WIRE in devices,
        free_force_n=min((e.free_force_n for e in selection if e.free_force_n is not None), default=None),
    )
    write_text(folder / VERDICT, f"Agrees: {agrees}\n\nDiffers: {differs}\n")
    return {"force_validation": table_rows(comparison, pushed, agrees, differs, wall)}


def table_rows(
    c: ForceComparison, pushed: np.ndarray, agrees: str, differs: str, wall: WallForces | None = None
) -> dict[str, dict[str, Any]]:
    """Fills the table `force_validation`; `pushed`: (n,) N without a planner, `wall`: what a load cell reads."""
    cells: dict[str, Any] = {
        "u_statistic": round(c.u_statistic, 1),
        "p_value": c.mann_whitney_p,
        "shapiro_p": c.shapiro_p,
        "levene_p": c.levene_p,
        "simulated_force_n": [c.mean_n, c.sd_n],
        "real_force_n": [c.real_mean_n, c.real_sd_n],
        "samples": c.n,
        "exceedance_pct": 100 * c.exceedance,
        "simulated_median_n": c.median_n,
        "simulated_p95_n": c.p95_n,
        "simulated_max_n": c.max_n,
        "contact_pct": 100 * c.contact_share,
        "pushed_force_n": [float(pushed.mean()), float(pushed.std())],
        "agrees": agrees,
        "differs": differs,
    }
    if wall is not None:
        cells |= {name: [float(getattr(wall, name).mean()), float(getattr(wall, name).std())] for name in QUANTITIES}
    rows = {row: {"value": cell} for row, cell in cells.items()}
    rows["simulated_force_n"]["n"] = c.n
    rows["pushed_force_n"]["n"] = len(pushed)
    return rows


def simulator_row(phantom: str) -> dict[str, dict[str, Any]]:
    """The row of this simulator in the table that compares it with others."""
    from cathsim import NavigateEnv

    environment = NavigateEnv(phantom, observation="tip")
    links = len(environment.simulation.wire.links)
    environment.close()
    return {
        "cathsim": {
            "engine": f"MuJoCo {metadata.version('mujoco')}, contact from a distance grid",
            "catheter": "discretised, over the wire in one rod",
            "guidewire": f"discretised, {links} links, rod's stiffness",
            "aorta": "3-D artery, generated or imported",
            "open_source": "yes",
        }
    }


def speed_rows(settings: ValidateSettings, *, seed: int) -> dict[str, dict[str, Any]]:
    """Measures the environment's speed on one core for several observations, in turns: medians, slowest, fastest."""
    from cathsim.physics_checks.unguided import median_speeds

    medians = median_speeds(
        settings.phantom, SPEED_MODES, settings.speed_steps, rounds=settings.speed_rounds, seed=seed
    )
    medians |= {"min": min(medians.values()), "max": max(medians.values())}
    return {name: {"value": round(value, 1)} for name, value in medians.items()}


def physics_rows(folder: RunFolder, laws: tuple[str, ...] = ()) -> dict[str, dict[str, Any]]:
    """Checks the wire against the theory of rods (`cathsim.physics_checks.LAWS`; none: all), in its own process."""
    job = Job("wire_physics", check_laws, laws)
    rows: dict[str, dict[str, Any]] = run_jobs(folder, [job], label="physics checks")[job.key]
    return rows


def check_laws(laws: tuple[str, ...], report: Report) -> dict[str, dict[str, float]]:
    """The job of `physics_rows`."""
    from cathsim.physics_checks import LAWS, worst_error_pct

    rows: dict[str, dict[str, float]] = {}
    for law in laws or LAWS:
        report(len(rows) / len(LAWS), law)
        rows[law] = {"worst_error_pct": worst_error_pct(LAWS[law](True))}
    return rows


def wall_vertices(phantoms: Path, name: str) -> np.ndarray:
    """Vertices (v, 3) m of a phantom's lumen surface: from the phantoms stage, or built where it is not there."""
    stored = phantoms / name / "lumen.stl"
    if stored.is_file():
        import trimesh

        return np.asarray(trimesh.load_mesh(stored).vertices, dtype=np.float64)
    from cathsim import load_phantom

    return np.asarray(load_phantom(name).lumen_mesh.vertices, dtype=np.float64)


def figures(episodes: list[EpisodeForces], settings: ValidateSettings, phantoms: Path, folder: Path) -> list[Figure]:
    """Draws the distribution, and a heat map for each phantom."""
    real = settings.real_mean_n, settings.real_sd_n
    in_phantom = [episode for episode in episodes if episode.phantom == settings.phantom]
    selection = in_phantom or episodes
    place = settings.phantom if in_phantom else "all phantoms"
    draw_distribution(pooled(selection), *real, folder / DISTRIBUTION)
    words = " ".join((folder / VERDICT).read_text(encoding="utf-8").split())
    entries = [
        Figure(
            "Contact forces beside real ones", f"{len(selection)} episodes in {place}. {words}", DISTRIBUTION, GROUP
        ),
    ]
    for name in dict.fromkeys(episode.phantom for episode in episodes):
        inside = [episode for episode in episodes if episode.phantom == name]
        file = f"heat/{name}.png"
        draw_heat(wall_vertices(phantoms, name), inside, folder / file, title=f"{name}: contact forces on the wall")
        contacts = sum(len(episode.forces) for episode in inside)
        caption = f"{contacts} contacts of {len(inside)} episodes, seen from the front."
        entries.append(Figure(f"{name}: contact forces on the vessel wall", caption, file, GROUP))
    return entries


STAGE = Stage(settings=ValidateSettings, run=run_validate, reads=("phantoms", "expert"), check=check_validate)
