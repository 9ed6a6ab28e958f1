"""A human's episodes: the recorder that the console finds, which writes them as logs with `operator` "human"."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cathsim.console.recorder import OPERATION, OPERATOR, OperationTotals, episode_path, write_answers
from pipeline.episodes import EpisodeOutcome, EpisodeWriter
from pipeline.recording.record import describe_episode, logged_pictures, open_log, phantom_mesh, step_record

if TYPE_CHECKING:
    from cathsim import NavigateEnv
    from cathsim.metrics import EpisodeMetrics

FOLDER = "human"  # of a run: the episodes, which no stage may clear away
SUFFIX = ".mcap"
ENDS_AT_FORCE_LIMIT = "ends_at_force_limit"  # key of a log's configuration


def recordings(runs_dir: Path, run: str) -> Path:
    """Where the episodes of a run lie."""
    return runs_dir / run / FOLDER


class McapRecorder:
    """Writes each episode step by step, `<folder>/<phantom>/<target>/<NNN>.mcap`; a kill loses less than a second.

    An episode that is broken off is kept with the status "interrupted" and an unknown success. Every method raises an
    `EpisodeWriteError` where the log cannot be written.

    Of the X-ray side a log has `xray_on`, `injections` and `force_warning` in every step (further scalars), the
    operator's force limit in its configuration, and `fluoroscopy_time_s`, `injections` and `force_warnings` among the
    outcome's metrics, also where it was broken off.
    """

    default_folder = recordings(Path("runs"), "desk")

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._log: EpisodeWriter | None = None
        self._begin: Callable[[NavigateEnv], EpisodeWriter] | None = None
        self._steps = 0
        self._totals, self._control_dt = OperationTotals(), 0.0

    def start(self, environment: NavigateEnv, info: Mapping[str, Any], *, seed: int) -> None:
        """Keeps the state after reset; the log is opened with the first step, when somebody touches the controls."""
        still = np.zeros(environment.action_space.shape or (), np.float32)
        record = step_record(environment, 0, still, 0.0, info, further=_operation(info))
        configuration = {
            name: info[key]
            for key, name in (("force_limit", "force_limit_n"), ("ends_at_force_limit", ENDS_AT_FORCE_LIMIT))
            if key in info
        }
        pictures = logged_pictures(environment)
        task, entry = environment.task, environment.simulation.entry
        phantom_mesh(environment.phantom, task.target, entry)  # made now, so that the first touch does not wait

        def begin(environment: NavigateEnv) -> EpisodeWriter:
            path = episode_path(self.folder, environment.phantom.name, task.target_name, SUFFIX)
            description = describe_episode(environment, seed=seed, operator=OPERATOR, configuration=configuration)
            self._control_dt = description.control_dt
            log = open_log(environment, path, description, overwrite=False)
            log.step(record, **pictures)
            return log

        self._begin, self._log, self._steps = begin, None, 0
        self._totals = OperationTotals()

    def step(
        self,
        environment: NavigateEnv,
        action: np.ndarray,
        reward: float,
        info: Mapping[str, Any],
        *,
        terminated: bool,
        truncated: bool,
    ) -> None:
        """Writes a step with its action, (2,), with a catheter (4,)."""
        if self._begin is None:
            raise RuntimeError("no episode was started: call start() before step()")
        if self._log is None:
            self._log = self._begin(environment)
        self._steps += 1
        self._totals.add(info)
        record = step_record(
            environment, self._steps, action, reward, info,
            terminated=terminated, truncated=truncated, further=_operation(info),
        )  # fmt: skip
        try:
            self._log.step(record, **logged_pictures(environment))
        except BaseException:
            self._log.abandon()
            raise

    def finish(self, metrics: EpisodeMetrics | None) -> Path | None:
        """Ends the log, broken off where there are no metrics; None when there was no step."""
        log, self._log, self._begin = self._log, None, None
        if log is None:
            return None
        totals = self._totals.metrics(self._control_dt)
        if metrics is None:
            return log.finish(EpisodeOutcome(success=None, steps=self._steps, metrics=totals, status="interrupted"))
        all_metrics = {**asdict(metrics), **totals}
        return log.finish(EpisodeOutcome(success=metrics.success, steps=self._steps, metrics=all_metrics))

    def answer(self, episode: Path, answers: Mapping[str, Any]) -> Path:
        """Keeps a questionnaire, as `cathsim.console.check_answers` gives it, in a JSON file beside the log."""
        return write_answers(episode, answers)


def _operation(info: Mapping[str, Any]) -> dict[str, float]:
    return {name: float(info[name]) for name in OPERATION if name in info}
