"""The sampling expert's score for a procedure's task, computed beside it by a process of its own.

``python -m cathsim.console.expert '{"phantom": "type_1", ...}'`` prints lines of JSON: how far it is, and the score.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from typing import IO, Any

from cathsim.metrics import EpisodeMetrics
from cathsim.planning.plan_trials import TWO_DEVICES, ExpertSettings

# fewer plans than elsewhere: the operator waits for the score
ONE_DEVICE_SEARCH = ExpertSettings(samples=12, elites=4, rounds=2)
TWO_DEVICE_SEARCH = replace(TWO_DEVICES, samples=16, elites=4, rounds=1)
ROLLOUTS = 1200  # after which the expert gives up
_NICENESS = 5  # the console goes first
_TOLD_EVERY = 0.5  # s
_SCORE, _PROGRESS = "score", "progress"  # keys of the lines that the process prints
Task = Mapping[str, Any]
Score = dict[str, Any]

_LOGGER = logging.getLogger(__name__)


class ExpertScores:
    """Asks for the expert's score of tasks, each once: a score that is known stays known.

    Args:
        tell: called with task and score from a thread of its own once a score is there; with None where the expert
            failed.
        progress: called in the same way while it is computed, with `steps` of the expert's episode and `seconds`
            since it was asked for.
    """

    def __init__(
        self,
        tell: Callable[[dict[str, Any], Score | None], None],
        progress: Callable[[dict[str, Any], dict[str, Any]], None] | None = None,
    ) -> None:
        self._tell, self._progress = tell, progress
        self._scores: dict[str, Score | None] = {}  # None: it is being computed, or could not be
        self._process: subprocess.Popen[str] | None = None
        self._lock = threading.Lock()

    def score(self, task: Task) -> Score | None:
        """The expert's score of a task, None where it is not there yet."""
        return self._scores.get(_key(task))

    def ask(self, task: dict[str, Any]) -> None:
        """Begins to compute the score of a task, unless it is known or being computed; one task at a time."""
        with self._lock:
            if _key(task) in self._scores:
                return
            self._end()
            self._scores = {key: score for key, score in self._scores.items() if score is not None}
            self._scores[_key(task)] = None
            command = [sys.executable, "-m", "cathsim.console.expert", json.dumps(task)]
            errors = tempfile.TemporaryFile("w+", encoding="utf-8")  # noqa: SIM115  read when the process has ended
            self._process = subprocess.Popen(
                command, stdout=subprocess.PIPE, stderr=errors, stdin=subprocess.DEVNULL, text=True,
                env={**os.environ, "OMP_NUM_THREADS": "1"},
            )  # fmt: skip
            threading.Thread(target=self._wait, args=(task, self._process, errors), daemon=True).start()

    def close(self) -> None:
        """Ends what is being computed."""
        with self._lock:
            self._end()

    def _end(self) -> None:
        if self._process is not None and self._process.poll() is None:
            self._process.kill()
        self._process = None

    def _wait(self, task: dict[str, Any], process: subprocess.Popen[str], errors: IO[str]) -> None:
        """Reads what the process prints, until it has ended."""
        score: Score | None = None
        began = time.monotonic()
        with process, errors:
            assert process.stdout is not None
            for line in process.stdout:
                message = json.loads(line)
                score = message.get(_SCORE)
                if self._progress is not None and _PROGRESS in message:
                    self._progress(task, {**message[_PROGRESS], "seconds": time.monotonic() - began})
            if process.wait() < 0:  # ended for another task, or with the console
                return
            if score is None:
                errors.seek(0)
                _LOGGER.warning("no score of the expert: %s", (errors.read().strip().splitlines() or ["it failed"])[-1])
        if score is not None:
            self._scores[_key(task)] = score
        self._tell(task, score)


def _key(task: Task) -> str:
    return json.dumps(task, sort_keys=True)


def expert_score(task: Task, report: Callable[[dict[str, Any]], None] | None = None) -> Score:
    """One episode of the sampling expert, with the searches above.

    Args:
        task: phantom, target, wire, catheter, accuracy, max_steps, success_radius and seed of the start, as of the
            console's setup; most_force: N at which the episode ends, None: it does not.
        report: called after each step with `steps`, those made so far.
    """
    import numpy as np

    from cathsim.environment import NavigateEnv
    from cathsim.planning.sampling import SamplingExpert
    from cathsim.simulation import CONTROL_STEP

    arguments = dict(task)
    seed, target, most_force = arguments.pop("seed"), arguments.pop("target"), arguments.pop("most_force", None)
    environment = NavigateEnv(arguments.pop("phantom"), target, observation="tip", **arguments)
    _, info = environment.reset(seed=seed)
    settings = TWO_DEVICE_SEARCH if environment.feeders.devices == 2 else ONE_DEVICE_SEARCH
    expert = SamplingExpert(environment, seed=seed, threads=1, settings=settings)
    tips, forces, rewards = [info["tip"]], [], []
    over = False
    while not over and expert.rollouts < ROLLOUTS:
        _, reward, terminated, truncated, info = environment.step(expert.action())
        tips.append(info["tip"])
        forces.append(info["force"])
        rewards.append(reward)
        over = terminated or truncated or (most_force is not None and info["force"] >= most_force)
        if report is not None:
            report({"steps": len(forces)})
    expert.close()
    metrics = EpisodeMetrics.from_arrays(
        np.array(tips), np.array(forces), np.array(rewards), bool(info["success"]), target=target, ending=info
    )
    ending = {"success": bool(info["success"]), "gave_up": not over}
    return {**ending, "time_s": len(forces) * CONTROL_STEP, "metrics": asdict(metrics)}


class _Teller:
    """Prints progress, twice a second at most."""

    def __init__(self) -> None:
        self._at = 0.0

    def __call__(self, progress: Mapping[str, Any]) -> None:
        if time.monotonic() - self._at >= _TOLD_EVERY:
            self._at = time.monotonic()
            _say(**{_PROGRESS: progress})


def _say(**line: Any) -> None:
    sys.stdout.write(json.dumps(line) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    with contextlib.suppress(OSError):
        os.nice(_NICENESS)
    _say(**{_SCORE: expert_score(json.loads(sys.argv[1]), _Teller())})
