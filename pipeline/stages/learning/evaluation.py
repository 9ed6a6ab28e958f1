"""Evaluation of a trained policy: its logged episodes on held-out seeds, in one folder a mode."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.recording.trials import MODES, Controller, Origin, run_trials, summary
from pipeline.seeds import held_out_seeds

if TYPE_CHECKING:
    from cathsim import NavigateEnv

EVALUATION = "evaluation"


def evaluate(
    environment: NavigateEnv,
    controllers: Callable[[str], Callable[[int], Controller]],
    folder: Path,
    origin: Origin,
    episodes: int,
    report: Callable[[float, str], None],
    modes: Sequence[str] = MODES,
) -> dict[str, Any]:
    """Records held-out episodes of a policy; those that are there are not repeated.

    Args:
        controllers: gives for a mode what `run_trials` takes.
        folder: of the training; the logs go into ``evaluation/<mode>``.
        origin: its training seed chooses the episodes.

    Returns:
        Mode to the summary of its episodes.
    """
    outcome = {}
    for index, mode in enumerate(modes):

        def tell(share: float, text: str, index: int = index, mode: str = mode) -> None:
            report((index + share) / len(modes), f"{mode} {text}")

        metrics = run_trials(
            environment,
            controllers(mode),
            folder / EVALUATION / mode,
            seeds=held_out_seeds(origin.training_seed, episodes),
            mode=mode,
            origin=origin,
            report=tell,
        )
        outcome[mode] = summary(metrics)
    return outcome
