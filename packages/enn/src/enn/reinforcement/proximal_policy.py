"""Proximal policy optimisation: stable-baselines3's updates, and how they take part in a training."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.utils import obs_as_tensor
from stable_baselines3.common.vec_env import VecEnv

from enn.networks.network import network_class
from enn.networks.normalisation import fit_normalisation
from enn.reinforcement.replay import ReplayBuffer
from enn.reinforcement.training.settings import PpoSettings

HALF_LOG_2_PI = 0.5 * math.log(2.0 * math.pi)
CLONED_FIRST, CLONED_AN_UPDATE = 300, 20  # batches of demonstrations: before the first roll-out, after each update
STORED = ("actions", "rewards", "episode_starts", "values", "log_probs")


class PpoLearner:
    """PPO's part in a training: acts, fills a roll-out, updates when it is full.

    Args:
        demonstrations: towards whose actions the policy is drawn with the weight `cloning_weight`; PPO alone learns
            from its own roll-outs.
    """

    def __init__(
        self, settings: PpoSettings, envs: VecEnv, seed: int, demonstrations: ReplayBuffer | None = None
    ) -> None:
        self.settings, self.n_envs = settings, envs.num_envs
        policy, arguments = network_class(settings.network, envs.observation_space)
        self.model = PPO(
            policy,  # type: ignore[arg-type]
            envs,
            learning_rate=settings.learning_rate,
            n_steps=settings.n_steps,
            batch_size=min(settings.batch_size, settings.n_steps * envs.num_envs),
            n_epochs=settings.epochs,
            gamma=settings.gamma,
            gae_lambda=settings.gae_lambda,
            clip_range=settings.clip_range,
            ent_coef=settings.ent_coef,
            policy_kwargs=arguments,
            seed=seed,
            device=settings.device,
        )
        self._values: dict[str, float] = {}
        self._logger = Logger(None, [])
        self.model.set_logger(self._logger)
        self.policy = self.model.policy
        self.policy.log_std.requires_grad_(settings.log_std_final is None)
        self._next_log_std: float | None = settings.log_std_init
        self._set_log_std()
        self.demonstrations = demonstrations
        self.rollout = self.model.rollout_buffer
        self._generator = np.random.default_rng(seed)
        self._starts = np.ones(self.n_envs, bool)
        self._first: list[Any] = []  # observations of the random decisions, for the normalisation
        self._latest: Any = None
        self._started = False
        self.updates = 0

    def act(self, observations: Any, *, explore: bool) -> NDArray[np.float32]:
        """Actions within the action space; `explore`: uniform ones. Shape (environments, actions)."""
        space: Any = self.policy.action_space
        if explore:
            unit = self._generator.uniform(0, 1, (self.n_envs, *space.shape)).astype(np.float32)
            return space.low + unit * (space.high - space.low)
        if not self._started:
            self._start()
        with torch.inference_mode():
            features = self.policy.extract_features(self._tensors(observations), self.policy.features_extractor)
            latent, latent_value = self.policy.mlp_extractor(features)
            mean, self._value = self.policy.action_net(latent), self.policy.value_net(latent_value)
            log_std = self.policy.log_std
            noise = torch.as_tensor(self._generator.standard_normal(mean.shape, np.float32), device=mean.device)
            self._action = mean + log_std.exp() * noise
            self._log_prob = (-0.5 * noise.square() - log_std - HALF_LOG_2_PI).sum(dim=1)
        return self._action.cpu().numpy().clip(space.low, space.high)

    def _start(self) -> None:
        self._started = True
        if self.settings.normalise and self._first:
            fit_normalisation(self.policy, self._tensors(_stacked(self._first)))
        self._first = []
        self._clone(CLONED_FIRST)

    def _clone(self, batches: int) -> None:
        """Moves the mean action towards the demonstrations'."""
        demonstrations, weight = self.demonstrations, self.settings.cloning_weight
        if demonstrations is None or not weight:
            return
        space: Any = self.policy.action_space
        low, high = (torch.as_tensor(bound, device=self.model.device) for bound in (space.low, space.high))
        half = 0.5 * (high - low)
        self.policy.set_training_mode(True)
        for _ in range(batches):
            rows = self._generator.integers(0, demonstrations.size(), self.settings.batch_size)
            drawn = demonstrations.gather(rows, np.zeros_like(rows))
            expert_actions = low + (drawn.actions + 1.0) * half  # replays keep actions between -1 and 1
            features = self.policy.extract_features(drawn.observations, self.policy.features_extractor)
            mean = self.policy.action_net(self.policy.mlp_extractor(features)[0])
            loss = weight * (mean - expert_actions).square().mean()
            self.policy.optimizer.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(self.policy.parameters(), self.model.max_grad_norm)
            self.policy.optimizer.step()
        self.policy.set_training_mode(False)

    def observe(
        self,
        observations: Any,
        rewards: NDArray[Any],
        dones: NDArray[Any],
        after: Any,
        infos: list[dict[str, Any]],
        *,
        explore: bool,
    ) -> None:
        """Remembers what the last actions led to."""
        if explore:
            self._first.append(observations)
            self._starts = dones.copy()
            return
        rewards = self.settings.reward_scale * rewards
        for index in np.flatnonzero(dones).tolist():
            if infos[index]["TimeLimit.truncated"]:
                last = infos[index]["terminal_observation"]
                single = {key: last[key][None] for key in observations} if isinstance(last, dict) else last[None]
                with torch.inference_mode():
                    rewards[index] += self.settings.gamma * float(self.policy.predict_values(self._tensors(single)))
        self.rollout.add(observations, self._action.cpu().numpy(), rewards, self._starts, self._value, self._log_prob)
        self._starts, self._latest = dones.copy(), after

    def anneal(self, done: float) -> None:
        """Sets the learning rate for the used share of the budget, and the actions' deviation for the next roll-out."""
        rate = self.settings.learning_rate_after(done)
        self.model.lr_schedule = lambda _: rate
        self._next_log_std = self.settings.log_std_after(done)

    def update(self, *, explore: bool) -> None:
        """Updates when the roll-out is full."""
        if explore or not self.rollout.full:
            return
        with torch.inference_mode():
            values = self.policy.predict_values(self._tensors(self._latest))
        self.rollout.compute_returns_and_advantage(last_values=values, dones=self._starts)
        # the library shuffles with numpy's global generator: lent a seed, and given back as it was
        before = np.random.get_state()  # noqa: NPY002
        np.random.seed(int(self._generator.integers(2**32)))  # noqa: NPY002
        try:
            self.model.train()
        finally:
            np.random.set_state(before)  # noqa: NPY002
        self._clone(CLONED_AN_UPDATE)
        self._values = {name: float(value) for name, value in self._logger.name_to_value.items()}
        self.rollout.reset()
        self._set_log_std()
        self.policy.set_training_mode(False)
        self.updates += self.settings.epochs * -(-self.rollout.buffer_size * self.n_envs // self.model.batch_size)

    def _set_log_std(self) -> None:
        if self._next_log_std is not None:
            with torch.no_grad():
                self.policy.log_std.fill_(self._next_log_std)

    def start_from(self, weights: dict[str, torch.Tensor], further: dict[str, Any]) -> None:
        """Takes over the whole network with its normalisation; the actions' deviation where it is learnt."""
        self.policy.load_state_dict(weights)
        if self.settings.log_std_final is not None:
            self._set_log_std()

    def further_state(self) -> dict[str, Any]:
        """Nothing beside the weights."""
        return {}

    def scalars(self) -> dict[str, float]:
        """Losses of the last update."""
        return dict(self._values)

    def state(self) -> dict[str, Any]:
        """Everything but the roll-out, as plain data; for `restore`."""
        return {
            "policy": self.policy.state_dict(),
            "optimizer": self.policy.optimizer.state_dict(),
            "generator": self._generator.bit_generator.state,
            "starts": self._starts,
            "first": self._first,
            "started": self._started,
            "updates": self.updates,
            "position": self.rollout.pos,
            "rollout": {name: getattr(self.rollout, name)[: self.rollout.pos] for name in STORED},
            "observations": _each(self.rollout.observations, lambda array: array[: self.rollout.pos]),
        }

    def chunks(self) -> Iterator[tuple[str, int, NDArray[Any]]]:
        """Nothing is large enough to be saved in pieces."""
        return iter(())

    def restore(self, state: dict[str, Any], chunks: dict[str, NDArray[Any]]) -> None:
        """Goes on where a learner with the same settings was saved."""
        self.policy.load_state_dict(state["policy"])
        self.policy.optimizer.load_state_dict(state["optimizer"])
        self._generator.bit_generator.state = state["generator"]
        self._starts, self._first = state["starts"], list(state["first"])
        self._started, self.updates = state["started"], state["updates"]
        self.rollout.reset()
        position = state["position"]
        for name, array in state["rollout"].items():
            getattr(self.rollout, name)[:position] = array
        if isinstance(self.rollout.observations, dict):
            for name, array in state["observations"].items():
                self.rollout.observations[name][:position] = array
        else:
            self.rollout.observations[:position] = state["observations"]
        self.rollout.pos, self.rollout.full = position, position == self.rollout.buffer_size

    def _tensors(self, observations: Any) -> Any:
        return obs_as_tensor(observations, self.model.device)


def _each(values: Any, work: Any) -> Any:
    return {name: work(array) for name, array in values.items()} if isinstance(values, dict) else work(values)


def _stacked(batches: list[Any]) -> Any:
    if isinstance(batches[0], dict):
        return {name: np.concatenate([batch[name] for batch in batches]) for name in batches[0]}
    return np.concatenate(batches)
