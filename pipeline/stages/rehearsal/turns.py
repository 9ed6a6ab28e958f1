"""Turns of a rehearsal's demonstrations: who plays next, by how often those before arrived.

In a turn one policy plays an episode in every copy of the training. The policy that the rehearsal starts from is asked
first. Where it seldom arrives it has nothing to learn from, and every other policy of the same devices is asked, by a
roadmap or by X-ray images, then the best of them again. Where they show next to nothing, or there is none for these
devices, the sampling expert has a turn; where the settings say so it has the first one in any case.

Copies are divided among processes, which play a turn beside each other. What a turn rests on is the files of those
before, so that it is the same however often the work was interrupted.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from pathlib import Path

from pipeline.recording.demonstration_files import arrived
from pipeline.stages.rehearsal.copies import RehearsalJob
from pipeline.stages.rehearsal.settings import ALWAYS, NEEDED, NEVER

DEMONSTRATIONS = "demonstrations"  # folder, and first part of the jobs' names
EXPERT = "expert"
OFTEN = 0.5  # share of episodes, with the trials of its devices: a policy that arrives as often learns from its own
ROUNDS = 4  # turns of one policy at most
FEW = 3  # one in so many of the demonstrations wanted: where policies show fewer, the expert is asked


@dataclass(frozen=True)
class Turn:
    """Who plays.

    Attributes:
        policy: file; None: the sampling expert.
        number: of the turns of that policy, from 0.
    """

    policy: Path | None
    number: int = 0


def turn_of(job: RehearsalJob) -> Turn | None:
    """Who plays in the job's turn; None: enough is shown, or nobody is left who may show more."""
    turns = _turns(job)
    try:
        turn = next(turns)
        for _ in range(job.turn):
            turn = turns.send(_outcomes(job, turn))
    except StopIteration:
        return None
    return turn


def most_turns(job: RehearsalJob) -> int:
    """Turns that there may be."""
    asked = len(job.shown_by)
    return asked + (ROUNDS - 1 if asked else 0) + (job.settings.expert != NEVER)


def _turns(job: RehearsalJob) -> Generator[Turn, list[bool], None]:
    """Turns one after the other; whoever asks sends where the episodes of the last one arrived."""
    settings, shown = job.settings, 0
    if settings.expert == ALWAYS:
        shown += sum((yield Turn(None)))
    arrivals: dict[Path, int] = {}
    best: Path | None = None
    for path in job.shown_by:
        if shown >= settings.demonstrations:
            return
        outcomes = yield Turn(path)
        arrivals[path] = sum(outcomes)
        shown += arrivals[path]
        if path == job.start and in_share(job, outcomes, OFTEN):
            break
    else:
        # others first: what the start shows it can do already (docs/results/rehearsal.md)
        best = max(arrivals, key=lambda path: (arrivals[path] > 0 and path != job.start, arrivals[path]), default=None)
    for number in range(1, ROUNDS):
        if best is None or not arrivals[best] or shown >= settings.demonstrations:
            break
        arrivals[best] = sum((yield Turn(best, number)))  # a turn in which nobody arrives is the last one
        shown += arrivals[best]
    if settings.expert == NEEDED and shown * FEW < settings.demonstrations:
        yield Turn(None)


def in_share(job: RehearsalJob, outcomes: Sequence[bool], share: float) -> bool:
    """Whether a policy arrives in a share of some episodes and of the trials of its devices together."""
    reached, episodes = (0, 0) if job.tried is None else (job.tried.reached, job.tried.episodes)
    return sum(outcomes) + reached >= share * (len(outcomes) + episodes)


def first_turn(job: RehearsalJob) -> list[bool]:
    """Where the policy that a rehearsal starts from arrives in its demonstrations; empty where it did not play all."""
    if job.start is None:
        return []
    files = [demonstration_file(job, job.start.stem, copy, 0) for copy in job.training_cases]
    return [arrived(file) for file in files] if all(file.is_file() for file in files) else []


def _outcomes(job: RehearsalJob, turn: Turn) -> list[bool]:
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
