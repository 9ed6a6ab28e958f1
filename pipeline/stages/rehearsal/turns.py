"""The files of a rehearsal's demonstrations, and whose turn it is by what lies in them.

Copies are divided among processes, which play a turn beside each other. What a turn rests on is the files of those
before, so that it is the same however often the work was interrupted. Rules: `enn.reinforcement.rehearsal_rules`.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from pipeline.recording.demonstration_files import arrived
from pipeline.stages.rehearsal.copies import RehearsalJob

if TYPE_CHECKING:
    from enn.reinforcement.rehearsal_rules import Turn

DEMONSTRATIONS = "demonstrations"  # folder, and first part of the jobs' names
EXPERT = "expert"


def turn_of(job: RehearsalJob) -> Turn[Path] | None:
    """Who plays in the job's turn; None: enough is shown, or nobody is left who may show more."""
    turns = job.rules.turns(job.shown_by, job.start, job.tried)
    try:
        turn = next(turns)
        for _ in range(job.turn):
            turn = turns.send(_outcomes(job, turn))
    except StopIteration:
        return None
    return turn


def first_turn(job: RehearsalJob) -> list[bool]:
    """Where the policy that a rehearsal starts from arrives in its demonstrations; empty where it did not play all."""
    if job.start is None:
        return []
    files = [demonstration_file(job, job.start.stem, copy, 0) for copy in job.training_cases]
    return [arrived(file) for file in files] if all(file.is_file() for file in files) else []


def _outcomes(job: RehearsalJob, turn: Turn[Path]) -> list[bool]:
    """Where the episodes of a turn arrived."""
    if turn.policy is None:
        return [arrived(file) for file in sorted((job.folder / DEMONSTRATIONS).glob(f"{EXPERT}_*.npz"))]
    name = policy_names(job)[turn.policy]
    return [arrived(demonstration_file(job, name, copy, turn.number)) for copy in job.training_cases]


def demonstration_file(job: RehearsalJob, name: str, copy: int, number: int) -> Path:
    """The file of an episode.

    Args:
        name: of the policy, or the expert's.
        number: of its turn.
    """
    return job.folder / DEMONSTRATIONS / f"{name}_{copy}_{number}.npz"


def policy_names(job: RehearsalJob) -> dict[Path, str]:
    """Stems of the policies' files; where several have one, all but the first get a number."""
    names: dict[Path, str] = {}
    for path in job.shown_by:
        alike = sum(other.stem == path.stem for other in names)
        names[path] = f"{path.stem}{alike + 1}" if alike else path.stem
    return names
