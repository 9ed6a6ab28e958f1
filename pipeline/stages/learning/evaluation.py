"""Evaluation of a trained policy: its logged episodes on held-out seeds, in one folder a mode."""

from __future__ import annotations

from collections.abc import Callable, Mapping
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
    episodes: Mapping[str, int],
    report: Callable[[float, str], None],
) -> dict[str, Any]:
    """Records held-out episodes of a policy; those that are there are not repeated.

    Args:
        controllers: gives for a mode what `run_trials` takes.
        folder: of the training; the logs go into ``evaluation/<mode>``.
        origin: its training seed chooses the episodes.
        episodes: mode to their number; see `both_modes`.

    Returns:
        Mode to the summary of its episodes.
    """
    outcome = {}
    total = sum(episodes.values())
    begun = 0
    for mode, count in episodes.items():

        def tell(share: float, text: str, begun: int = begun, count: int = count, mode: str = mode) -> None:
            report((begun + share * count) / total, f"{mode} {text}")

        metrics = run_trials(
            environment,
            controllers(mode),
            folder / EVALUATION / mode,
            seeds=held_out_seeds(origin.training_seed, count),
            mode=mode,
            origin=origin,
            report=tell,
        )
        outcome[mode] = summary(metrics)
        begun += count
    return outcome


def both_modes(best: int, drawn: int) -> dict[str, int]:
    """Mode to number of episodes: by the best action, and, where there are any, by drawn ones."""
    return {mode: count for mode, count in zip(MODES, (best, drawn), strict=True) if count}
