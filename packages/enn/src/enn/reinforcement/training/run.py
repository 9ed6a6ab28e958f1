"""Training run: the loop of decisions, updates, evaluations and checkpoints."""

from __future__ import annotations

import json
import logging
import time
import zlib
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.utils import get_device

from enn.model_file import UNFIT
from enn.policy import Policy
from enn.reinforcement.checkpoint import CheckpointFolder, random_states, restore_random_states
from enn.reinforcement.evaluation import BestPolicy
from enn.reinforcement.free_memory import trim_heap
from enn.reinforcement.proximal_policy import PpoLearner
from enn.reinforcement.replay import ReplayBuffer, demonstration_replay
from enn.reinforcement.reset_bank import CaseResetBank, ResetBank, fill_reset_bank
from enn.reinforcement.sampling import SampledEnvs, without_checks
from enn.reinforcement.soft_actor_critic import SacLearner
from enn.reinforcement.starting_policy import start_from
from enn.reinforcement.training.result import COLUMNS, Progress, TrainingResult, replace_text, write_curve
from enn.reinforcement.training.settings import TrainingSettings
from enn.trajectory import Trajectory

logger = logging.getLogger(__name__)

REWARD_WINDOW, EPISODE_WINDOW = 100, 50
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
    "tensorboard",
    "device",
    "keep_critics",
}


@dataclass
class TrainingInputs:
    """What a training starts from.

    Attributes:
        make_env: makes one environment; called for each of those sampled, and for evaluation.
        folder: where it is kept; None: only in memory.
        demonstrations: their states enter the reset bank; their steps take part in updates, if the settings say so.
        encoder: frozen, turns observations into features.
        metadata: kept in the policy's file, with the seed.
        starts: further states of the reset bank, an array for each case or way. Shapes (k, n).
        make_validation_env: makes the environments of the evaluations that choose the best policy; None: `make_env`.
        initial: a policy with critics to start from instead of fresh weights: it acts from the first decision on, is
            evaluated before the first update, and its normalisation stays. Learning begins after `learning_starts`.
    """

    settings: TrainingSettings
    make_env: Callable[[], gymnasium.Env[Any, Any]]
    folder: Path | str | None = None
    seed: int = 0
    demonstrations: Sequence[Trajectory] = ()
    encoder: Any = None
    metadata: dict[str, Any] | None = None
    starts: Sequence[NDArray[Any]] = ()
    make_validation_env: Callable[[], gymnasium.Env[Any, Any]] | None = None
    initial: Policy | None = None


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
        reset_bank = _make_reset_bank(settings, inputs.seed)
        self.sampled = _make_envs(inputs, settings, reset_bank)
        self.envs: Any = self.sampled
        if inputs.encoder is not None:
            from enn.reinforcement.encoded import EncodedEnvs

            inputs.encoder.to(get_device(settings.device))
            self.envs = EncodedEnvs(self.sampled, inputs.encoder, settings.passthrough)
        demonstrations = self._demonstrations()
        self.learner: SacLearner | PpoLearner
        if settings.algorithm == "sac":
            self.learner = SacLearner(settings, self.envs, inputs.seed, demonstrations)
        else:
            self.learner = PpoLearner(settings, self.envs, inputs.seed, demonstrations)
        if inputs.initial is not None:
            start_from(self.learner, inputs.initial, settings, self.sampled)
        self.policy = Policy(
            settings.network,
            self.learner.policy,
            self.sampled.observation_space,
            self.sampled.action_space,  # type: ignore[arg-type]
            encoder=inputs.encoder,
            passthrough=settings.passthrough,
            action_repeat=settings.action_repeat,
            metadata={"seed": inputs.seed, **(inputs.metadata or {})},
        )
        self._evaluation_envs: list[gymnasium.Env[Any, Any]] = []
        self.decisions = self.env_steps = 0
        self.next_row, self.next_evaluation = settings.curve_every, settings.evaluate_every or 1 << 62
        self.best_policy = BestPolicy(settings.evaluation_episodes, inputs.seed, keeps_first=inputs.initial is not None)
        self.curve: list[dict[str, Any]] = []
        self.latest: dict[str, Any] = {}
        self.rewards: deque[float] = deque(maxlen=REWARD_WINDOW)
        self.episodes: deque[tuple[int, bool]] = deque(maxlen=EPISODE_WINDOW)
        self.spent = {"wall_s": 0.0, "cpu_s": 0.0, "simulation_s": 0.0, "update_s": 0.0, "evaluation_s": 0.0}
        self.began = time.perf_counter(), time.process_time()
        self.here = 0  # decisions of this run alone
        self.ticked = 0.0
        self.consistent = False
        self.writer: Any = None
        self.checkpoint = None
        if self.folder is not None:
            self.folder.mkdir(parents=True, exist_ok=True)
            self.checkpoint = CheckpointFolder(self.folder / "checkpoint", self._architecture())
        self._begin(reset_bank)
        self.saved = time.perf_counter()
        if settings.tensorboard and self.folder is not None:
            from torch.utils.tensorboard import SummaryWriter

            self.writer = SummaryWriter(str(self.folder / "tensorboard"), purge_step=self.decisions or None)

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

    def _begin(self, reset_bank: ResetBank | None) -> None:
        """Goes on from the checkpoint, or from the start where there is none."""
        if self.checkpoint is not None and self.checkpoint.exists():
            state, pieces = self.checkpoint.read()
            try:
                self._restore(state, pieces)
            except UNFIT as error:
                reason = " ".join(str(error).split())[:200]
                raise self.checkpoint.unusable(f"its state cannot be taken up: {reason}") from error
            return
        if reset_bank is not None:
            fill_reset_bank(reset_bank, self.inputs.demonstrations)
            for states in self.inputs.starts:
                reset_bank.add_episode(states)
        self.observations = self.envs.reset()

    def train(self) -> TrainingResult:
        """Trains to the end; whatever stops it between decisions leaves a checkpoint of that moment."""
        self.consistent = True
        try:
            while not self._pause():
                self._decide()
        except BaseException:
            if self.consistent and self.checkpoint is not None:
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
        clock = time.perf_counter()
        after, rewards, dones, infos = self.envs.step(actions)
        self.spent["simulation_s"] += time.perf_counter() - clock
        self.learner.observe(self.observations, rewards, dones, after, infos, explore=explore)
        self.observations = after
        self.decisions += self.sampled.num_envs
        self.here += self.sampled.num_envs
        for reward, info in zip(rewards.tolist(), infos, strict=True):
            self.env_steps += info["steps"]
            self.rewards.append(reward / info["steps"])
            episode = info.get("episode")
            if episode is not None and episode["fresh"]:
                self.episodes.append((episode["l"], episode["success"]))
        clock = time.perf_counter()
        self.learner.set_learning_rate(self._learning_rate())
        self.learner.update(explore=waiting)
        self.spent["update_s"] += time.perf_counter() - clock
        self.consistent = True

    def _learning_rate(self) -> float:
        settings = self.settings
        done = min(self.decisions / settings.decisions, 1.0)
        return settings.learning_rate * (1.0 - (1.0 - settings.final_learning_rate) * done)

    def _pause(self) -> bool:
        """What is due between decisions; whether the training is over."""
        over = self.decisions >= self.settings.decisions
        final_evaluation = over and self.settings.evaluate_every > 0 and self.best_policy.evaluated_at < self.decisions
        first = self.inputs.initial is not None and self.settings.evaluate_every > 0 > self.best_policy.evaluated_at
        if self.decisions >= self.next_evaluation or final_evaluation or first:
            self._evaluate()
            while self.next_evaluation <= self.decisions:
                self.next_evaluation += self.settings.evaluate_every
        over |= 0 < self.settings.stop_after <= self.best_policy.perfect
        last = self.curve[-1]["decisions"] if self.curve else 0
        if self.decisions >= self.next_row or (over and last < self.decisions):
            self._row()
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
        self.latest = self.best_policy.evaluate(self.policy, self._evaluation_envs, self.decisions, self._tick)
        self.spent["evaluation_s"] += time.perf_counter() - clock

    def _row(self) -> None:
        wall, cpu = self._clocks()
        row = {
            "decisions": self.decisions,
            "env_steps": self.env_steps,
            "wall_s": round(wall, 3),
            "cpu_s": round(cpu, 3),
            "reward": float(np.mean(self.rewards)) if self.rewards else None,
            "episode_length": float(np.mean([length for length, _ in self.episodes])) if self.episodes else None,
            "success": self._success(),
            **self.latest,
        }
        self.latest = {}
        self.curve.append({name: row.get(name) for name in COLUMNS})
        if self.folder is not None:
            write_curve(self.folder / "training.csv", self.curve)
        if self.writer is not None:
            for name, value in {**{f"curve/{k}": v for k, v in row.items()}, **self.learner.scalars()}.items():
                if value is not None and name != "curve/decisions":
                    self.writer.add_scalar(name, value, self.decisions)

    def _success(self) -> float | None:
        return float(np.mean([success for _, success in self.episodes])) if self.episodes else None

    def _clocks(self) -> tuple[float, float]:
        wall, cpu = time.perf_counter() - self.began[0], time.process_time() - self.began[1]
        return self.spent["wall_s"] + wall, self.spent["cpu_s"] + cpu

    def _tick(self) -> None:
        now = time.perf_counter()
        if self.progress is None or now - self.ticked < TICK:
            return
        self.ticked = now
        total = self.settings.decisions
        pace = (now - self.began[0]) / self.here if self.here else 0.0
        self.progress(
            Progress(
                self.decisions,
                total,
                self._success(),
                self.best_policy.success,
                self._clocks()[0],
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
        }

    def _save(self) -> None:
        assert self.checkpoint is not None
        wall, cpu = self._clocks()
        state = {
            "learner": self.learner.state(),
            "envs": self.sampled.state(),
            "random": random_states(),
            "counters": (self.decisions, self.env_steps, self.next_row, self.next_evaluation),
            "best_policy": self.best_policy.state(),
            "curve": self.curve,
            "latest": self.latest,
            "rewards": list(self.rewards),
            "episodes": list(self.episodes),
            "spent": {**self.spent, "wall_s": wall, "cpu_s": cpu},
        }
        self.checkpoint.write(state, self.learner.chunks())
        self.saved = time.perf_counter()

    def _restore(self, state: dict[str, Any], pieces: dict[str, Any]) -> None:
        self.learner.restore(state["learner"], pieces)
        observations = self.sampled.restore(state["envs"])
        self.observations = observations if self.inputs.encoder is None else self.envs.encode(observations)
        restore_random_states(state["random"])
        self.decisions, self.env_steps, self.next_row, self.next_evaluation = state["counters"]
        self.best_policy.restore(state["best_policy"])
        # the intervals may have been changed since
        self.next_evaluation = min(self.next_evaluation, self.decisions + (self.settings.evaluate_every or 1 << 62))
        self.next_row = min(self.next_row, self.decisions + self.settings.curve_every)
        self.curve, self.latest = state["curve"], state["latest"]
        self.rewards.extend(state["rewards"])
        self.episodes.extend(state["episodes"])
        self.spent |= state["spent"]
        logger.info("training goes on after %d of %d decisions", self.decisions, self.settings.decisions)

    def _finish(self) -> TrainingResult:
        wall, cpu = self._clocks()
        timings = {
            **self.spent,
            "wall_s": wall,
            "cpu_s": cpu,
            "decisions": float(self.decisions),
            "env_steps": float(self.env_steps),
            "updates": float(self.learner.updates),
        }
        evaluation = self.best_policy.load_best_into(self.policy.module)
        self.policy.metadata |= {"decisions": self.decisions}
        if self.settings.keep_critics:
            self.policy.metadata |= self.learner.further_state()
        if self.folder is not None:
            self.policy.save(self.folder / "policy.pt", critics=self.settings.keep_critics)
            write_curve(self.folder / "training.csv", self.curve)
            record = {
                "settings": asdict(self.settings),
                "metadata": self.policy.metadata,
                "timings": timings,
                "evaluation": evaluation,
            }
            replace_text(self.folder / "training.json", json.dumps(record, indent=2))
        if self.checkpoint is not None:
            self.checkpoint.remove()
        return TrainingResult(self.policy, self.curve, timings, evaluation)

    def close(self) -> None:
        """Frees environments and files."""
        if self.writer is not None:
            self.writer.close()
        self.sampled.close()
        for env in self._evaluation_envs:
            env.close()


def _make_reset_bank(settings: TrainingSettings, seed: int) -> ResetBank | None:
    kept = settings.reset_bank_share, settings.reset_bank_capacity, seed
    if settings.reset_bank_cases:
        return CaseResetBank(settings.reset_bank_cases, *kept)
    return ResetBank(*kept) if settings.reset_bank_share > 0 else None


def _make_envs(inputs: TrainingInputs, settings: TrainingSettings, reset_bank: ResetBank | None) -> SampledEnvs:
    """The environments that are sampled; they observe what the networks read, or all that an encoder may."""
    keys = tuple(dict.fromkeys((*settings.keys, *settings.critic_keys))) if settings.keys else ()
    return SampledEnvs(
        [inputs.make_env] * settings.n_envs,
        seed=inputs.seed,
        threads=settings.threads,
        action_repeat=settings.action_repeat,
        reset_bank=reset_bank,
        keys=keys if inputs.encoder is None else (),
    )


def _digest(network: torch.nn.Module | None) -> int:
    """A number that changes with the weights; of no network, that of no bytes."""
    weights = {} if network is None else network.state_dict()
    return zlib.adler32(b"".join(value.cpu().numpy().tobytes() for value in weights.values()))
