"""What helped the measured rows that stand beside the thesis's: worded from the jobs that made them, so it is true.

The thesis trains on its reward, from one start, with its networks on raw observations, an action a step. What a job has
beyond that is an aid, and the report names it beneath the table.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from pipeline.stages.learning.task import ACCURACY_OF_TESTS, REWARD_OF_EVALUATION
from pipeline.task import Task, number_of_actions

if TYPE_CHECKING:
    from pipeline.stages.learning.force import ForceJob
    from pipeline.stages.learning.training import PolicyTrainingJob
    from pipeline.stages.navigation.jobs import NavigatorJob

_PICTURES = ("image", "mask", "sequential")


def note_of(rows: Mapping[str, Sequence[str]]) -> str:
    """One note for a table of rows' aids: what all rows share, then the rest, rows with the same aids together."""
    every = list(rows.values())
    shared = [aid for aid in every[0] if all(aid in aids for aids in every)] if every else []
    groups: dict[str, list[str]] = {}
    for row, aids in rows.items():
        groups.setdefault("; ".join(aid for aid in aids if aid not in shared), []).append(row)
    sentences = [f"How the measured rows were made: {'; '.join(shared) or 'with nothing in common'}."] if every else []
    sentences += [f"{', '.join(names)}: {text}." for text, names in groups.items() if text]
    return " ".join(sentences)


def note(jobs: Iterable[Any], aids: Callable[[Any], list[str]]) -> str:
    """The note of a table of jobs, each named by its row, whose aids a function words; tasks that differ are named."""
    rows: dict[str, dict[tuple[str, ...], list[str]]] = {}
    for job in jobs:
        tasks = rows.setdefault(job.origin.row, {}).setdefault(tuple(aids(job)), [])
        tasks.append(getattr(getattr(job, "task", None), "name", ""))
    return note_of({
        row if len(of_row) == 1 else f"{row} in {', '.join(dict.fromkeys(tasks))}": words
        for row, of_row in rows.items()
        for words, tasks in of_row.items()
    })  # fmt: skip


def of_training(job: PolicyTrainingJob) -> list[str]:
    """What a policy was trained with."""
    settings, task, aids = job.settings, job.task, []
    if task.reward != REWARD_OF_EVALUATION:
        price = f", less {task.path_penalty:g} a metre of the tip's path" if task.path_penalty else ""
        aids.append(f"shaped reward of training ({task.reward}{price})")
    if task.force_penalty:
        aids.append(f"a newton costs {task.force_penalty:g} in the reward")
    if task.accuracy != ACCURACY_OF_TESTS:
        aids.append(f"trained in {task.accuracy} physics, chosen and tested in {ACCURACY_OF_TESTS} ones")
    if settings.start_state_buffer_share:
        states = "demonstrations and own successes" if job.demonstrations else "own successes"
        aids.append(
            f"{100 * settings.start_state_buffer_share:.0f} % of the resets along the path, to states of {states}"
        )
    if (in_replay := getattr(settings, "demonstrations_in_replay", 0.0)) and job.demonstrations:  # of SAC alone
        share, count = 100 * in_replay, len(job.demonstrations)
        aids.append(f"{share:.0f} % of each batch are steps of the planner's demonstrations ({count})")
    if settings.cloning_weight and job.demonstrations:
        aids.append(f"drawn towards the actions of the planner's demonstrations ({len(job.demonstrations)})")
    if job.encoder is not None:
        aids.append("an encoder fitted beforehand and frozen")
    if settings.action_repeat > 1:
        aids.append(f"actions held for {settings.action_repeat} steps")
    aids += of_task(task.task, job.keys)
    return [*aids, f"{settings.decisions:,} decisions"]


def of_force(job: ForceJob, task: Task) -> list[str]:
    """What a network that predicts forces was fitted to: episodes of a task."""
    learnt = "network on disturbed episodes of the expert, which had the aids of its own table"
    return [f"{job.settings.network.variant} {learnt}", *of_task(task, _PICTURES)]


def of_navigator(job: NavigatorJob) -> list[str]:
    """What a navigator was trained with and sees."""
    settings = job.settings
    aids = [f"{len(settings.cameras)} cameras of {settings.image_size_px} px"]
    if settings.guided:
        aids.append("a contrast run before the procedure")
    if settings.in_space:
        aids.append("wire and vessels measured in space by the cameras' known geometry")
    aids.append(f"actions held for {settings.action_repeat} steps")
    if job.episodes:
        aids.append(f"cloned from {job.episodes} episodes a target of an expert that knows the state")
    if job.rounds:
        places = len({anatomy for course in job.courses for anatomy in course.anatomies})
        aids.append(
            f"{job.rounds} rounds of {job.round_episodes} episodes in {places} anatomies with a teacher that knows the "
            "state"
        )
    return aids


def of_task(task: Task, observed: Sequence[str]) -> list[str]:
    """What a task has, whose learner observes these."""
    aids = [f"{number_of_actions(task)} actions"]
    if task.catheter is not None:
        devices = f"the wire in the catheter {task.catheter}" if task.two_devices else f"the catheter {task.catheter}"
        aids.append(f"{devices}, {task.torsion} torsion")
    if any(name in _PICTURES for name in observed):
        aids.append(f"images of {task.image_size_px} px")
    if task.start_rotation_deg:
        aids.append(f"starts turned by up to {task.start_rotation_deg:g} degrees either way")
    return aids
