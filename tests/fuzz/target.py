"""What is fuzzed: a target makes a case of a seed, runs it, and says whether it was refused or gave what is right."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from pathlib import Path
from typing import ClassVar

LONGEST_SENTENCE = 1500  # characters of a refusal


class WrongError(Exception):
    """A case that failed: wrong data were accepted, or a refusal is no sentence."""


class Target(ABC):
    """A reader of something that may be damaged.

    Args:
        folder: for the target's own files.
    """

    name: ClassVar[str]
    seconds: ClassVar[float] = 5.0  # of CPU time that a seed may take
    megabytes: ClassVar[int] = 500  # that a case may add to the process
    share: ClassVar[float] = 1.0  # of the time, beside the others

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.counts: Counter[str] = Counter()

    @abstractmethod
    def run(self, seed: int) -> None:
        """Runs the cases of a seed, always the same, and counts each as refused, equal or accepted.

        Raises:
            Exception: anything that is not the promised error.
        """


def refused(error: BaseException) -> str:
    """Checks that a refusal is one sentence, and returns ``refused``.

    Raises:
        WrongError: it is none.
    """
    text = str(error)
    if not text.strip() or "\n" in text.strip() or len(text) > LONGEST_SENTENCE:
        raise WrongError(f"a refusal is no sentence: {type(error).__name__}: {text[:300]!r}") from error
    return "refused"
