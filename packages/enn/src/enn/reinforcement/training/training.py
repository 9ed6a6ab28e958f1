"""Reinforcement learning: a training from settings to the best policy, resumable at any moment."""

from __future__ import annotations

import json
import logging
import time
import zlib
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.utils import get_device

from enn.curves import open_writer
from enn.model_file import UNFIT, write_whole
from enn.policy import Policy
from enn.reinforcement.checkpoint import CheckpointError, CheckpointFolder, random_states, restore_random_states
from enn.reinforcement.evaluation import BestPolicy, LatestPolicy
from enn.reinforcement.proximal_policy import PpoLearner
from enn.reinforcement.replay import ReplayBuffer, demonstration_replay
from enn.reinforcement.resources import trim_heap
from enn.reinforcement.sampling import without_checks
from enn.reinforcement.soft_actor_critic import SacLearner
from enn.reinforcement.training.inputs import TrainingInputs, start_from
from enn.reinforcement.training.result import Progress, TrainingLog, TrainingResult, read_curve
from enn.reinforcement.training.settings import PpoSettings, SacSettings, TrainingSettings

logger = logging.getLogger(__name__)

TICK = 0.25  # s between calls of the progress callback
# settings that may change when a training is resumed
CHANGEABLE = {
    "decisions",
    "threads",
    "evaluate_every",
    "evaluation_episodes",
    "stop_after",
    "curve_every",
    "checkpoint_seconds",
    "logger",
    "device",
    "keep_critics",
}


class TrainingRun:
    """A training while it runs: its environments, learner, counters and clocks.

    Args:
        progress: called a few times a second between decisions.
    """

    def __init__(self, inputs: TrainingInputs, progress: Callable[[Progress], None] | None) -> None:
        settings = inputs.settings
        if inputs.encoder is not None:
            settings = replace(settings, normalise=False)  # the encoder's features are normalised already
        self.inputs, self.settings, self.progress = inputs, settings, progress
        self.folder = None if inputs.folder is None else Path(inputs.folder)
        torch.set_num_threads(1)
        self.sampled = inputs.make_envs(settings, inputs.make_start_state_buffer(settings))
        self.envs: Any = self.sampled
        if inputs.encoder is not None:
            from enn.reinforcement.encoded import EncodedEnvs

            inputs.encoder.to(get_device(settings.device))
            self.envs = EncodedEnvs(self.sampled, inputs.encoder)
        demonstrations = self._demonstrations()
        self.learner: SacLearner | PpoLearner
        self.overlap = isinstance(settings, SacSettings) and settings.overlap
        if isinstance(settings, SacSettings):
            self.learner = SacLearner(settings, self.envs, inputs.seed, demonstrations)
        else:
            assert isinstance(settings, PpoSettings)
            self.learner = PpoLearner(settings, self.envs, inputs.seed, demonstrations)
        if inputs.initial is not None:
            start_from(self.learner, inputs.initial, settings, self.sampled)
        self.policy = Policy(
            settings.network,
            self.learner.policy,
            self.sampled.observation_space,
            self.sampled.action_space,  # type: ignore[arg-type]
            encoder=inputs.encoder,
            action_repeat=settings.action_repeat,
            metadata={"seed": inputs.seed, **(inputs.metadata or {})},
        )
        self._evaluation_envs: list[gymnasium.Env[Any, Any]] = []
        self.decisions = 0
        self.next_row, self.next_evaluation = settings.curve_every, settings.evaluate_every or 1 << 62
        judge = partial(LatestPolicy, first=inputs.initial_result) if settings.keep_latest else BestPolicy
        self.best_policy = judge(settings.evaluation_episodes, inputs.seed, keeps_first=inputs.initial is not None)
        self.log = TrainingLog(self.folder, lambda: getattr(self.sampled, "cpu_s", 0.0))
        self.here = 0  # decisions of this run alone
        self.ticked = 0.0
        self.consistent = False
        self.checkpoint = None
        if self.folder is not None:
            self.folder.mkdir(parents=True, exist_ok=True)
            self.checkpoint = CheckpointFolder(self.folder / "checkpoint", self._architecture())
        self.observations: Any = None
        self._go_on()
        self.saved = time.perf_counter()
        if self.folder is not None:
            self.log.writer = open_writer(self.folder, settings.logger, self.decisions)

    def _demonstrations(self) -> ReplayBuffer | None:
        """Those that take part in updates."""
        inputs, settings = self.inputs, self.settings
        if not (settings.learns_from_demonstrations and inputs.demonstrations):
            return None
        return demonstration_replay(
            inputs.demonstrations,
            self.envs.observation_space,
            self.envs.action_space,
            action_repeat=settings.action_repeat,
            encode=None if inputs.encoder is None else self.envs.encode,
            seed=inputs.seed,
        )

    def _go_on(self) -> None:
        """Takes up the checkpoint, if there is one."""
        if self.checkpoint is None or not self.checkpoint.exists():
            return
        state, pieces = self.checkpoint.read()
        try:
            self._restore(state, pieces)
        except UNFIT as error:
            reason = " ".join(str(error).split())[:200]
            raise self.checkpoint.unusable(f"its state cannot be taken up: {reason}") from error

    def train(self) -> TrainingResult:
        """Trains to the end; whatever stops it between decisions leaves a checkpoint of that moment."""
        self.consistent = True
        try:
            while not self._pause():
                self._decide()
        except BaseException:
            if self.consistent and self.checkpoint is not None and self.observations is not None:
                self._save()
            raise
        return self._finish()

    def _decide(self) -> None:
        """One decision of every environment, and the updates that it pays for."""
        self.consistent = False
        explore = waiting = self.decisions < self.settings.learning_starts
        if self.inputs.initial is not None:  # it acts itself, and SAC waits until its replay buffer holds something
            explore, waiting = False, waiting and self.settings.algorithm == "sac"
        actions = self.learner.act(self.observations, explore=explore)
        self.envs.step_async(actions)
        if self.overlap:
            self._update(waiting or not self.decisions)
        clock = time.perf_counter()
        after, rewards, dones, infos = self.envs.step_wait()
        self.log.spent["simulation_s"] += time.perf_counter() - clock
        self.learner.observe(self.observations, rewards, dones, after, infos, explore=explore)
        self.observations = after
        self.decisions += self.sampled.num_envs
        self.here += self.sampled.num_envs
        self.log.observe(rewards.tolist(), infos)
        if not self.overlap:
            self._update(waiting)
        self.consistent = True

    def _update(self, waiting: bool) -> None:
        clock = time.perf_counter()
        self.learner.anneal(min(self.decisions / self.settings.decisions, 1.0))
        self.learner.update(explore=waiting)
        self.log.spent["update_s"] += time.perf_counter() - clock

    def _pause(self) -> bool:
        """What is due between decisions; whether the training is over."""
        over = self.decisions >= self.settings.decisions
        final_evaluation = over and self.settings.evaluate_every > 0 and self.best_policy.evaluated_at < self.decisions
        first = self.inputs.initial is not None and self.settings.evaluate_every > 0 > self.best_policy.evaluated_at
        if self.decisions >= self.next_evaluation or final_evaluation or first:
            self._evaluate()
            while self.next_evaluation <= self.decisions:
                self.next_evaluation += self.settings.evaluate_every
        if self.observations is None:  # after the first evaluation: meanwhile the environments were made
            self.observations = self.envs.reset()
        over |= 0 < self.settings.stop_after <= self.best_policy.perfect
        if self.decisions >= self.next_row or (over and self.log.last_row_at() < self.decisions):
            self.log.add_row(self.decisions, {} if self.log.writer is None else self.learner.scalars())
            trim_heap()
            while self.next_row <= self.decisions:
                self.next_row += self.settings.curve_every
        waited = time.perf_counter() - self.saved >= self.settings.checkpoint_seconds
        if not over and self.checkpoint is not None and self.here and waited:
            self._save()
        self._tick()
        return over

    def _evaluate(self) -> None:
        clock = time.perf_counter()
        while len(self._evaluation_envs) < min(self.settings.evaluation_episodes, self.settings.n_envs):
            self._evaluation_envs.append(without_checks((self.inputs.make_validation_env or self.inputs.make_env)()))
        self.policy.module.set_training_mode(False)
        self.log.evaluation = self.best_policy.evaluate(
            self.policy, self._evaluation_envs, self.decisions, self._tick, self.sampled.workers
        )
        if self.inputs.after_evaluation is not None:
            self.inputs.after_evaluation(self.policy, self.decisions)
        self.log.spent["evaluation_s"] += time.perf_counter() - clock

    def _tick(self) -> None:
        now = time.perf_counter()
        if self.progress is None or now - self.ticked < TICK:
            return
        self.ticked = now
        total = self.settings.decisions
        pace = (now - self.log.began[0]) / self.here if self.here else 0.0
        self.progress(
            Progress(
                self.decisions,
                total,
                self.log.success(),
                self.log.episode_return(),
                self.best_policy.success,
                self.log.clocks()[0],
                pace * (total - self.decisions),
            )
        )

    def _architecture(self) -> dict[str, Any]:
        settings = {name: value for name, value in asdict(self.settings).items() if name not in CHANGEABLE}
        encoder = self.inputs.encoder
        initial = None if self.inputs.initial is None else self.inputs.initial.module
        return {
            **settings,
            "observations": str(self.envs.observation_space),
            "actions": str(self.envs.action_space),
            "seed": self.inputs.seed,
            "encoder": _digest(encoder),
            **({} if initial is None else {"initial": _digest(initial)}),
            "shown": _digest_of([demonstration.actions for demonstration in self.inputs.demonstrations]),
            "starts": _digest_of(self.inputs.starts),
        }

    def _save(self) -> None:
        assert self.checkpoint is not None
        state = {
            "learner": self.learner.state(),
            "envs": self.sampled.state(),
            "random": random_states(),
            "counters": (self.decisions, self.log.env_steps, self.next_row, self.next_evaluation),
            "best_policy": self.best_policy.state(),
            **self.log.state(),
        }
        self.checkpoint.write(state, self.learner.chunks())
        self.saved = time.perf_counter()

    def _restore(self, state: dict[str, Any], pieces: dict[str, Any]) -> None:
        self.learner.restore(state["learner"], pieces)
        observations = self.sampled.restore(state["envs"])
        self.observations = observations if self.inputs.encoder is None else self.envs.encode(observations)
        restore_random_states(state["random"])
        self.decisions, self.log.env_steps, self.next_row, self.next_evaluation = state["counters"]
        self.best_policy.restore(state["best_policy"])
        # the intervals may have been changed since
        self.next_evaluation = min(self.next_evaluation, self.decisions + (self.settings.evaluate_every or 1 << 62))
        self.next_row = min(self.next_row, self.decisions + self.settings.curve_every)
        self.log.restore(state)
        logger.info("training goes on after %d of %d decisions", self.decisions, self.settings.decisions)

    def _finish(self) -> TrainingResult:
        wall, cpu = self.log.clocks()
        timings = {
            **self.log.spent,
            "wall_s": wall,
            "cpu_s": cpu,
            "decisions": float(self.decisions),
            "env_steps": float(self.log.env_steps),
            "updates": float(self.learner.updates),
        }
        evaluation = self.best_policy.load_best_into(self.policy.module)
        self.policy.metadata |= {"decisions": self.decisions}
        if self.settings.keep_critics:
            self.policy.metadata |= self.learner.further_state()
        if self.folder is not None:
            self.policy.save(self.folder / "policy.pt", critics=self.settings.keep_critics)
            self.log.write()
            record = {
                "settings": asdict(self.settings),
                "metadata": self.policy.metadata,
                "timings": timings,
                "evaluation": evaluation,
            }
            write_whole(self.folder / "training.json", json.dumps(record, indent=2).encode())
        if self.checkpoint is not None:
            self.checkpoint.remove()
        return TrainingResult(self.policy, self.log.curve, timings, evaluation)

    def close(self) -> None:
        """Frees environments and files."""
        self.log.close()
        self.sampled.close()
        for env in self._evaluation_envs:
            env.close()


def _digest(network: torch.nn.Module | None) -> int:
    """A number that changes with the weights; of no network, that of no bytes."""
    weights = {} if network is None else network.state_dict()
    return _digest_of([value.cpu().numpy() for value in weights.values()])


def _digest_of(arrays: Sequence[NDArray[Any]]) -> int:
    return zlib.adler32(b"".join(np.ascontiguousarray(array).tobytes() for array in arrays))


class Training(TrainingInputs):
    """One reinforcement learning run; with a folder it can be interrupted and goes on exactly where it was.

        folder/policy.pt        the best policy           folder/training.csv   the curve
        folder/training.json    settings and outcome      folder/checkpoint/    until it is finished
        folder/tensorboard/     event files, if asked for

    Args and attributes are those of `TrainingInputs`.
    """

    def run(self, progress: Callable[[Progress], None] | None = None) -> TrainingResult:
        """Trains to the end of the budget, going on from a checkpoint if the folder holds one.

        Args:
            progress: called a few times a second between decisions; what it raises stops the training, which can go
                on later from that decision.

        Raises:
            NotFiniteError: an observation or a reward was not finite.
            CheckpointError: the folder's checkpoint, or its record of a finished training, is damaged or of another
                training.
        """
        if self.folder is not None and (Path(self.folder) / "training.json").is_file():
            return self._finished(Path(self.folder))
        run = TrainingRun(self, progress)
        try:
            return run.train()
        finally:
            run.close()

    def _finished(self, folder: Path) -> TrainingResult:
        policy = Policy.load(folder / "policy.pt", get_device(self.settings.device))
        try:
            record = json.loads((folder / "training.json").read_text(encoding="utf-8"))
            curve = read_curve(folder / "training.csv")
            result = TrainingResult(policy, curve, dict(record["timings"]), record["evaluation"])
            # what was not a setting yet was as its default is
            before = {**_as_stored(type(self.settings)()), **record["settings"], "seed": record["metadata"]["seed"]}
        except (KeyError, OSError, RecursionError, TypeError, ValueError) as error:
            raise CheckpointError(
                f"the training in {folder} is finished, but its training.json or training.csv is damaged: remove "
                "both to train again"
            ) from error
        settings = self.settings if self.encoder is None else replace(self.settings, normalise=False)
        mine = {**_as_stored(settings), "seed": (self.metadata or {}).get("seed", self.seed)}
        changeable = CHANGEABLE - {"decisions"}
        if other := [name for name in mine if name not in changeable and before[name] != mine[name]]:
            values = ", ".join(f"{name} {before[name]}, not {mine[name]}" for name in other[:4])
            raise CheckpointError(f"{folder} holds a finished training of another kind ({values}): take another folder")
        return result


def _as_stored(settings: TrainingSettings) -> dict[str, Any]:
    """Settings as a training's record gives them back: lists instead of tuples."""
    fields: dict[str, Any] = json.loads(json.dumps(asdict(settings)))
    return fields
