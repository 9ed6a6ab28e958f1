"""The expert stage: logged episodes of the sampling expert, with films, paths and metrics.

There are two kinds. Demonstrations, which others learn from, begin with a wire that is not turned. Evaluations, which
stand in the tables, have the first starts and seeds of the episodes that policies are compared by, and nothing learns
from them.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

from pipeline.anatomies.anatomy_file import load_anatomy
from pipeline.anatomies.settings import ChosenAnatomies, check_anatomies, settle
from pipeline.seeds import demonstration_seeds, held_out_seeds
from pipeline.settings.kinds import NO_EFFECT_ON_RESULTS, CountOrNone, Episodes, Processes, validated
from pipeline.stages import Stage, StageContext
from pipeline.stages.learning.task import LearningTask
from pipeline.store.atomic_files import atomic_path, write_json
from pipeline.tables import Figure, Results
from pipeline.task import joint_observations, number_of_actions, require_feeder, require_known_task

OPERATOR, EVALUATION = "sampling_expert", "evaluation"


@validated()
class ExpertSettings(ChosenAnatomies):
    """Settings of the sampling expert's episodes; the task is that of the evaluation."""

    shows_ct: ClassVar[str | None] = "film"

    name: str = "expert"
    episodes: Episodes = 3  # demonstrations a phantom and target, from starts that are not turned
    # for the tables, from the starts and seeds of the policies compared with; a search takes 10 CPU-s, and nearly all
    # succeed
    evaluation_episodes: Episodes = 10
    threads: Processes = field(default=0, metadata=NO_EFFECT_ON_RESULTS)  # of the search; 0: one a core
    film: bool = True
    film_episodes: CountOrNone = 1  # films a phantom and target


@dataclass(frozen=True)
class Trial:
    """One episode to record."""

    phantom: str
    target: str
    episode: int
    evaluation: bool = False  # of the tables; otherwise a demonstration

    @property
    def task(self) -> str:
        """Its phantom and target, the name of the folder."""
        return f"{self.phantom}/{self.target}"

    @property
    def label(self) -> str:
        kind = f"-{EVALUATION}" if self.evaluation else ""
        return f"{self.phantom}-{self.target}{kind}-{self.episode:03d}"

    @property
    def log(self) -> str:
        return f"{self.task}/{f'{EVALUATION}/' if self.evaluation else ''}{self.episode:03d}.mcap"

    @property
    def film(self) -> str:
        return f"{self.task}/{self.episode:03d}.gif"


def check_expert(settings: ExpertSettings) -> None:
    """Refuses unknown phantoms, targets and wires with a ConfigurationError that lists the valid names."""
    check_anatomies(settings)
    require_known_task(settings.task)
    require_feeder(settings.task, "expert")


def run_expert(settings: ExpertSettings, context: StageContext) -> Results:
    seeds = {
        False: demonstration_seeds(context.seed, settings.episodes),
        True: held_out_seeds(context.seed, settings.evaluation_episodes),
    }
    trials = [
        Trial(phantom, target, episode, evaluation)
        for phantom in settings.phantoms
        for target in settings.targets
        for evaluation, of_kind in seeds.items()
        for episode in range(len(of_kind))
    ]
    for trial in context.folder.resumable(trials, key=lambda trial: trial.label, label="expert episodes"):
        metrics = record_trial(trial, settings, context.path, seed=seeds[trial.evaluation][trial.episode])
        context.folder.mark_done(trial.label, metrics)
    return Results({"task": task_settings(settings, context.seed)}, figures(trials, settings, context.path))


def record_trial(trial: Trial, settings: ExpertSettings, folder: Path, *, seed: int) -> dict[str, Any]:
    """Records one episode with its log and, if wanted, its film; `seed` is that of start and search."""
    from cathsim.planning.sampling import SamplingExpert
    from cathsim.viewing.film import Film
    from pipeline.recording.record import record_episode

    task = settings.task if trial.evaluation else replace(settings.task, start_rotation_deg=0.0)
    environment = LearningTask(trial.phantom, trial.target, task, settings.anatomy_file).environment("tip")
    expert = SamplingExpert(environment, seed=seed, threads=settings.threads or None)
    film = None
    if settings.film and not trial.evaluation and trial.episode < settings.film_episodes:
        file = settings.anatomy_file
        film = Film(background=None if file is None else file.background())
    try:
        metrics = record_episode(
            environment,
            lambda observation, info: expert.action(),
            folder / trial.log,
            seed=seed,
            operator=OPERATOR,
            configuration={"expert": asdict(expert.settings)},
            film=film,
        )
        if film is not None:
            with atomic_path(folder / trial.film) as temporary:
                film.write(temporary)
    finally:
        expert.close()
        environment.close()
        if film is not None:
            film.close()
    return asdict(metrics)


def task_settings(settings: ExpertSettings, seed: int) -> dict[str, Any]:
    """The expert's task, beside the thesis's settings: row to column to cell."""
    values = {
        "episode_limit_enn": settings.task.max_steps,
        "seed": seed,
        "start_jitter_mm": settings.task.start_jitter_mm,
        "success_radius_mm": settings.task.success_radius_mm,
        "image_size_px": settings.task.image_size_px,
        "joint_observations": joint_observations(settings.task),
        "actions": number_of_actions(settings.task),
    }
    return {name: {"value": value} for name, value in values.items()}


def figures(trials: list[Trial], settings: ExpertSettings, folder: Path) -> list[Figure]:
    """Draws paths and forces of every task and lists them with the films."""
    from pipeline.plots.episodes import draw_planned_path, draw_task

    entries = []
    for task in dict.fromkeys(trial.task for trial in trials):
        phantom_name, target = task.split("/")
        phantom = load_anatomy(settings.anatomy(phantom_name))
        group = f"Sampling expert, {phantom_name}, {target.upper()}"
        logs = [folder / trial.log for trial in trials if trial.task == task]
        radius = settings.task.success_radius_mm
        draw_task(phantom, target, logs, folder / task / "episodes.png", radius_mm=radius)
        entries.append(
            Figure(
                f"{task}: path of the tip and contact force",
                f"{len(logs)} episodes, demonstrations among them; the target's sphere of success is dashed.",
                f"{task}/episodes.png",
                group,
            )
        )
        length = draw_planned_path(phantom, target, folder / task / "path.png", entry=settings.task.entry)
        write_json(folder / task / "path.json", {"length_m": length})
        entries.append(
            Figure(f"{task}: shortest path", "A* in the lumen from the entry to the target.", f"{task}/path.png", group)
        )
        if settings.film:
            entries += [
                Figure(
                    f"{task}: episode {trial.episode}",
                    "Fluoroscopy and 3-D view, 2.5 times the episode's speed.",
                    trial.film,
                    group,
                )
                for trial in trials
                if trial.task == task and not trial.evaluation and trial.episode < settings.film_episodes
            ]
    return entries


STAGE = Stage(settings=ExpertSettings, run=run_expert, reads=("phantoms",), prepare=settle, check=check_expert)
