"""The sampling expert's score for a procedure's task, computed beside it by a process of its own.

``python -m cathsim.console.expert '{"phantom": "type_1", ...}'`` prints one line of JSON.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import Any

from cathsim.metrics import EpisodeMetrics

ROLLOUTS = 1200  # after which the expert gives up
_NICENESS = 5  # the console goes first

_LOGGER = logging.getLogger(__name__)


class ExpertScores:
    """Asks for the expert's score of tasks, each once.

    Args:
        tell: called with task and score from a thread of its own once a score is there; with None where the expert
            failed.
    """

    def __init__(self, tell: Callable[[dict[str, Any], dict[str, Any] | None], None]) -> None:
        self._tell = tell
        self._scores: dict[str, dict[str, Any] | None] = {}  # None: it is being computed, or could not be
        self._process: subprocess.Popen[str] | None = None
        self._lock = threading.Lock()

    def score(self, task: Mapping[str, Any]) -> dict[str, Any] | None:
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
            self._process = subprocess.Popen(
                command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, stdin=subprocess.DEVNULL, text=True
            )
            threading.Thread(target=self._wait, args=(task, self._process), daemon=True).start()

    def close(self) -> None:
        """Ends what is being computed."""
        with self._lock:
            self._end()

    def _end(self) -> None:
        if self._process is not None and self._process.poll() is None:
            self._process.kill()
        self._process = None

    def _wait(self, task: dict[str, Any], process: subprocess.Popen[str]) -> None:
        output, errors = process.communicate()
        if process.returncode < 0:  # ended for another task, or with the console
            return
        if process.returncode:
            _LOGGER.warning("no score of the expert: %s", (errors.strip().splitlines() or ["it failed"])[-1])
            self._tell(task, None)
            return
        score = json.loads(output)
        self._scores[_key(task)] = score
        self._tell(task, score)


def _key(task: Mapping[str, Any]) -> str:
    return json.dumps(task, sort_keys=True)


def expert_score(task: Mapping[str, Any]) -> dict[str, Any]:
    """One episode of the sampling expert.

    Args:
        task: phantom, target, wire, catheter, accuracy, max_steps and seed of the start, as of the console's setup.

    Returns:
        `success`, `time_s` and the episode's metrics.
    """
    import numpy as np

    from cathsim.environment import NavigateEnv
    from cathsim.planning.expert_settings import TWO_DEVICES, ExpertSettings
    from cathsim.planning.sampling import SamplingExpert
    from cathsim.simulation import CONTROL_STEP

    given = dict(task)
    seed, target = given.pop("seed"), given.pop("target")
    environment = NavigateEnv(given.pop("phantom"), target, observation="tip", **given)
    _, info = environment.reset(seed=seed)
    settings = TWO_DEVICES if environment.feeders.devices == 2 else ExpertSettings()
    expert = SamplingExpert(environment, seed=seed, threads=1, settings=settings)
    tips, forces, rewards = [info["tip"]], [], []
    terminated = truncated = False
    while not (terminated or truncated) and expert.rollouts < ROLLOUTS:
        _, reward, terminated, truncated, info = environment.step(expert.action())
        tips.append(info["tip"])
        forces.append(info["force"])
        rewards.append(reward)
    expert.close()
    metrics = EpisodeMetrics.from_arrays(
        np.array(tips), np.array(forces), np.array(rewards), bool(info["success"]), target=target
    )
    return {"success": bool(info["success"]), "time_s": len(forces) * CONTROL_STEP, "metrics": asdict(metrics)}


if __name__ == "__main__":
    with contextlib.suppress(OSError):
        os.nice(_NICENESS)
    sys.stdout.write(json.dumps(expert_score(json.loads(sys.argv[1]))) + "\n")
