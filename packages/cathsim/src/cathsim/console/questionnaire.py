"""The questionnaire after a procedure: seven criteria, each rated on a five-point Likert scale."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

LOWEST, HIGHEST = 1, 5
LONGEST_PARTICIPANT = 40


@dataclass(frozen=True)
class Criterion:
    """One question."""

    key: str  # its name in files and tables
    title: str  # in two words
    question: str  # as the operator reads it


# Criteria of the thesis, chapter CathSim, "User Study"; the wording of the questions is this console's own.
CRITERIA: tuple[Criterion, ...] = (
    Criterion("anatomical_accuracy", "Anatomical accuracy", "How well do the vessels match real anatomy?"),
    Criterion("navigation_realism", "Navigation realism", "How close does it look to a real procedure on the monitor?"),
    Criterion("user_satisfaction", "User satisfaction", "How satisfied are you with the simulator as a whole?"),
    Criterion("friction_accuracy", "Friction accuracy", "How well is the wire's friction on the wall portrayed?"),
    Criterion("interaction_realism", "Interaction realism", "How real does the wire look where it meets the wall?"),
    Criterion("motion_accuracy", "Motion accuracy", "Did the wire move as you would expect of a real one?"),
    Criterion("visual_realism", "Visual realism", "How real does the wire itself look?"),
)


def check_answers(answers: Mapping[str, Any]) -> dict[str, Any]:
    """Checks a filled-in questionnaire.

    Args:
        answers: a whole number from 1 (worst) to 5 (best) for each criterion, and optionally `participant`, a code.

    Returns:
        The answers in the order of the criteria, and `participant` ("" when none was given).

    Raises:
        ValueError: a criterion is missing, unknown, or not answered on the scale.
    """
    keys = [criterion.key for criterion in CRITERIA]
    unknown = sorted(set(answers) - {*keys, "participant"})
    if unknown:
        raise ValueError(f"the questionnaire has no criterion {', '.join(unknown)}; its criteria are {', '.join(keys)}")
    missing = [key for key in keys if key not in answers]
    if missing:
        raise ValueError(f"every criterion needs an answer, {', '.join(missing)} has none")
    for key in keys:
        value = answers[key]
        if isinstance(value, bool) or not isinstance(value, int) or not LOWEST <= value <= HIGHEST:
            raise ValueError(f"{key} must be a whole number from {LOWEST} to {HIGHEST}, got {value!r}")
    participant = answers.get("participant", "")
    if not isinstance(participant, str) or len(participant) > LONGEST_PARTICIPANT:
        raise ValueError(f"participant must be a code of at most {LONGEST_PARTICIPANT} characters")
    return {**{key: answers[key] for key in keys}, "participant": participant.strip()}


def mean_scores(answers: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Mean and standard deviation of each criterion; of a participant with a code the last answers count.

    Args:
        answers: the questionnaires, oldest first.

    Returns:
        Criterion to `score`, [mean, standard deviation], and `n`, the number of participants; empty without answers.
    """
    from cathsim.metrics import Statistic

    last = {answer.get("participant") or f"anonymous {number}": answer for number, answer in enumerate(answers)}
    rows = {}
    for criterion in CRITERIA if last else ():
        scores = Statistic.of([answer[criterion.key] for answer in last.values()])
        rows[criterion.key] = {"score": [scores.mean, scores.sd], "n": len(last)}
    return rows
