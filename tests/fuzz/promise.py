"""What a reader promises of damaged input: nothing is lost, or one sentence says why, in bounded time and memory."""

import functools
import os
import random
import resource
import signal
import time
from collections import Counter
from collections.abc import Callable
from types import FrameType
from typing import Any

import hypothesis
from hypothesis import HealthCheck, Phase
from hypothesis import strategies as st

LONGEST_SENTENCE = 1500  # characters of a refusal
WALL_SECONDS_A_SECOND = 6  # other work on the machine is no fault of a case
IN_THE_SUITE, IN_A_FUZZ = 5, int(os.environ.get("EXAMPLES", "300"))  # cases of each test; of a slow one a twentieth

verdicts: dict[str, Counter[str]] = {}  # of every test: refused, equal, accepted, and ms


class BrokenPromiseError(AssertionError):
    """Wrong data were accepted, a refusal is no sentence, or a case took too much."""


def refused(error: BaseException) -> str:
    """Checks that a refusal is one sentence, and returns ``refused``.

    Raises:
        BrokenPromiseError: it is none.
    """
    text = str(error)
    if not text.strip() or "\n" in text.strip() or len(text) > LONGEST_SENTENCE:
        raise BrokenPromiseError(f"a refusal is no sentence: {type(error).__name__}: {text[:300]!r}") from error
    return "refused"


def fuzz(
    *seeds: int, seconds: float = 5.0, megabytes: int = 500, slow: bool = False
) -> Callable[[Callable[..., str]], Callable[..., None]]:
    """Turns a test that draws one case from ``rng`` and returns its verdict into one of many cases.

    A case that fails is shown as ``rng=Random(SEED)``; its seed, added to the decorator, is tried in every run.

    Args:
        seeds: that are always tried.
        seconds: of CPU time that a case may take.
        megabytes: that a case may add to this process.
        slow: whether a case takes seconds.
    """

    def decorate(test: Callable[..., str]) -> Callable[..., None]:
        count = verdicts.setdefault(test.__name__.removeprefix("test_"), Counter())

        @functools.wraps(test)
        def case(*args: Any, **keywords: Any) -> None:
            before, cpu, began = _peak_mb(), time.process_time(), time.monotonic()
            signal.signal(signal.SIGALRM, _too_long)
            signal.setitimer(signal.ITIMER_REAL, WALL_SECONDS_A_SECOND * seconds)
            try:
                count[test(*args, **keywords)] += 1
            finally:
                signal.setitimer(signal.ITIMER_REAL, 0)
            count["ms"] += round(1000 * (time.monotonic() - began))
            grown, spent = _peak_mb() - before, time.process_time() - cpu
            if grown > megabytes or spent > seconds:
                raise BrokenPromiseError(f"{spent:.1f} s of CPU time and {grown:.0f} MB more than before")

        profile = hypothesis.settings.get_current_profile_name()
        examples = IN_A_FUZZ if profile == "fuzz" else IN_THE_SUITE
        # phases without shrinking: a smaller seed is no simpler case
        run = hypothesis.settings(
            max_examples=max(examples // 20, 1) if slow else examples,
            deadline=None,
            database=None,
            derandomize=profile != "fuzz",
            phases=(Phase.explicit, Phase.generate),
            suppress_health_check=list(HealthCheck),
        )(hypothesis.given(rng=st.randoms(use_true_random=True))(case))
        for seed in seeds:
            run = hypothesis.example(rng=random.Random(seed))(run)
        return run

    return decorate


def _too_long(signum: int, frame: FrameType | None) -> None:
    raise BrokenPromiseError("the case has no end")


def _peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
