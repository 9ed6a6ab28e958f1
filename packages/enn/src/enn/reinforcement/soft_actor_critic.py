"""Soft actor-critic: stable-baselines3's updates with less work around them, and how it takes part in a training."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import SAC
from stable_baselines3.common.utils import obs_as_tensor
from stable_baselines3.common.vec_env import VecEnv
from torch import Tensor
from torch.nn import functional

from enn.networks.network import action_distribution, network_class
from enn.networks.normalisation import fit_normalisation
from enn.reinforcement.replay import ReplayBuffer
from enn.reinforcement.training.settings import SacSettings

HALF_LOG_2_PI = 0.5 * math.log(2.0 * math.pi)
LOG_2 = math.log(2.0)
FITS = 4  # of the normalisation: when learning starts, then whenever there is twice as much to fit to
FIT_SAMPLES = 5000
ENTROPY_WEIGHT = "entropy_weight"  # in the metadata of a policy that keeps its critics


class FastSAC(SAC):
    """SAC whose update does the same with fewer operations; noise comes from `noise`, a generator of its own."""

    noise: torch.Generator | None = None
    cloning_weight: float = 0.0
    losses: dict[str, Tensor]
    _entropy_weight: Tensor | None = None

    def sample_actions(self, observations: Any) -> tuple[Tensor, Tensor, Tensor]:
        """Draws squashed actions; also their log-probability, and the mean before squashing.

        Returns:
            Shapes (N, actions), (N, 1) and (N, actions).
        """
        mean, log_std = action_distribution(self.policy, observations)
        noise = torch.randn(mean.shape, generator=self.noise).to(mean.device)
        raw = mean + log_std.exp() * noise
        # log(1 - tanh^2) in the form that does not lose precision far out
        squash = 2.0 * (LOG_2 - raw - functional.softplus(-2.0 * raw))
        log_prob = (-0.5 * noise.square() - log_std - HALF_LOG_2_PI - squash).sum(dim=1, keepdim=True)
        return raw.tanh(), log_prob, mean

    def train(self, gradient_steps: int, batch_size: int = 64) -> None:
        """Updates critic, actor and entropy weight.

        Source: Haarnoja et al. 2018, as stable-baselines3 has it; cloning where the critics prefer what was
        demonstrated: Nair et al. 2018, whose sum of losses is scaled by the values' magnitude here.
        """
        self.policy.set_training_mode(True)
        sources: list[Tensor] = list(self.critic.parameters())
        targets: list[Tensor] = list(self.critic_target.parameters())
        assert isinstance(self.replay_buffer, ReplayBuffer)
        for step in range(self._n_updates, self._n_updates + gradient_steps):
            data = self.replay_buffer.sample(batch_size)
            actions, log_prob, mean = self.sample_actions(data.observations)
            self._learn_entropy_weight(log_prob)
            entropy_weight = self._entropy_weight
            assert entropy_weight is not None
            with torch.no_grad():
                next_actions, next_log_prob, _ = self.sample_actions(data.next_observations)
                values = torch.minimum(*self.critic_target(data.next_observations, next_actions))
                target = data.rewards + (1 - data.dones) * self.gamma * (values - entropy_weight * next_log_prob)
            first, second = self.critic(data.observations, data.actions)
            critic_loss = 0.5 * (functional.mse_loss(first, target) + functional.mse_loss(second, target))
            self.critic.optimizer.zero_grad()
            critic_loss.backward()
            self.critic.optimizer.step()

            self._learn_actor(data, actions, log_prob, mean, entropy_weight)
            if step % self.target_update_interval == 0:
                with torch.no_grad():
                    torch._foreach_lerp_(targets, sources, self.tau)
            self.losses |= {"critic_loss": critic_loss.detach(), "ent_coef": entropy_weight}
        self._n_updates += gradient_steps

    def _learn_actor(self, data: Any, actions: Tensor, log_prob: Tensor, mean: Tensor, entropy_weight: Tensor) -> None:
        # the gradients of what the critic's optimiser learns would be thrown away here
        critic = [parameter for group in self.critic.optimizer.param_groups for parameter in group["params"]]
        for parameter in critic:
            parameter.requires_grad_(False)
        value = torch.minimum(*self.critic(data.observations, actions))
        loss = (entropy_weight * log_prob - value).mean()
        assert isinstance(self.replay_buffer, ReplayBuffer)
        demonstrated = self.replay_buffer.demonstrations_in(len(actions)) if self.cloning_weight else 0
        if demonstrated:
            loss = loss + self.cloning_weight * self._cloning_loss(data, mean, value.detach(), demonstrated)
        self.actor.optimizer.zero_grad()
        loss.backward()
        self.actor.optimizer.step()
        for parameter in critic:
            parameter.requires_grad_(True)
        self.losses |= {"actor_loss": loss.detach(), "entropy": -log_prob.detach().mean()}

    def _cloning_loss(self, data: Any, mean: Tensor, value: Tensor, demonstrated: int) -> Tensor:
        """Squared distance of the best action to a demonstrated one, where the critics prefer the latter.

        Args:
            demonstrated: how many rows are demonstrations; they are the last ones.
            mean: before squashing. Shape (N, actions).
            value: of the actions that were drawn. Shape (N, 1).
        """
        observations = data.observations
        if isinstance(observations, dict):
            observations = {name: rows[-demonstrated:] for name, rows in observations.items()}
        else:
            observations = observations[-demonstrated:]
        with torch.no_grad():
            better = torch.minimum(*self.critic(observations, data.actions[-demonstrated:])) > value[-demonstrated:]
        distance = (mean[-demonstrated:].tanh() - data.actions[-demonstrated:]).square().sum(dim=1, keepdim=True)
        return value.abs().mean() * (distance * better).mean()

    def _learn_entropy_weight(self, log_prob: Tensor) -> None:
        if self.ent_coef_optimizer is None or self.log_ent_coef is None:
            self._entropy_weight = self.ent_coef_tensor
            return
        self._entropy_weight = self.log_ent_coef.detach().exp()
        # the gradient of -log_ent_coef * mean(log_prob + target), written down instead of traced
        self.log_ent_coef.grad = -(log_prob.detach().mean() + float(self.target_entropy)).reshape(1)
        self.ent_coef_optimizer.step()


class SacLearner:
    """SAC's part in a training: acts, remembers, updates.

    Args:
        demonstrations: a filled replay buffer to draw from beside the own one.
    """

    def __init__(
        self, settings: SacSettings, envs: VecEnv, seed: int, demonstrations: ReplayBuffer | None = None
    ) -> None:
        self.settings, self.n_envs = settings, envs.num_envs
        policy, arguments = network_class(settings.network, envs.observation_space)
        share = settings.demonstrations_in_replay if demonstrations is not None else 0.0
        entropy: Any = "auto" if settings.target_entropy is None else settings.target_entropy
        self.model = FastSAC(
            policy,  # type: ignore[arg-type]
            envs,
            learning_rate=settings.learning_rate,
            buffer_size=settings.buffer_size,
            batch_size=settings.batch_size,
            tau=settings.tau,
            gamma=settings.gamma,
            ent_coef=settings.ent_coef,
            target_entropy=entropy,
            replay_buffer_class=ReplayBuffer,
            replay_buffer_kwargs={
                "half": settings.half,
                "seed": seed,
                "demonstrations": demonstrations,
                "demonstration_share": share,
            },
            policy_kwargs=arguments,
            seed=seed,
            device=settings.device,
        )
        self.model.noise = torch.Generator().manual_seed(seed)
        self.model.cloning_weight, self.model.losses = settings.cloning_weight, {}
        self.policy = self.model.policy
        self.replay: ReplayBuffer = self.model.replay_buffer  # type: ignore[assignment]
        self._generator = np.random.default_rng(seed)
        self._owed = 0.0
        self._fits = self._next_fit = 0
        self.updates = 0

    def act(self, observations: Any, *, explore: bool) -> NDArray[np.float32]:
        """Actions within the action space; `explore`: uniform ones. Shape (environments, actions)."""
        space: Any = self.policy.action_space
        if explore:
            self._scaled = self._generator.uniform(-1, 1, (self.n_envs, *space.shape)).astype(np.float32)
        else:
            with torch.inference_mode():
                mean, log_std = action_distribution(self.policy, obs_as_tensor(observations, self.model.device))
            noise = self._generator.standard_normal(mean.shape, np.float32)
            self._scaled = np.tanh(mean.cpu().numpy() + np.exp(log_std.cpu().numpy()) * noise)
        return self.policy.unscale_action(self._scaled)

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
        following = after
        if dones.any():
            ended = np.flatnonzero(dones)
            following = (
                {name: values.copy() for name, values in after.items()} if isinstance(after, dict) else after.copy()
            )
            for index in ended:
                last = infos[index]["terminal_observation"]
                if isinstance(following, dict):
                    for name in following:
                        following[name][index] = last[name]
                else:
                    following[index] = last
        self.replay.add(observations, following, self._scaled, rewards, dones, infos)

    def anneal(self, done: float) -> None:
        """Sets the learning rate of actor and critic for the used share of the budget."""
        rate = self.settings.learning_rate_after(done)
        for optimizer in (self.model.actor.optimizer, self.model.critic.optimizer):
            for group in optimizer.param_groups:
                group["lr"] = rate

    def update(self, *, explore: bool) -> None:
        """Updates as often as the settings say for the decisions since the last call."""
        if explore:
            return
        if self.settings.normalise and self._fits < FITS and self.replay.added >= self._next_fit:
            self._fit_normalisation()
        self._owed += self.settings.gradient_steps * self.n_envs
        steps = int(self._owed)
        self._owed -= steps
        if steps:
            self.model.train(steps, self.settings.batch_size)
            self.updates += steps

    def _fit_normalisation(self) -> None:
        count = min(self.replay.added, self.replay.buffer_size)
        rows, envs = np.divmod(np.arange(count * self.n_envs), self.n_envs)
        every = max(len(rows) // FIT_SAMPLES, 1)
        fit_normalisation(self.policy, self.replay.gather(rows[::every], envs[::every]).observations)
        self._fits, self._next_fit = self._fits + 1, 2 * self.replay.added

    def start_from(self, weights: dict[str, Tensor], further: dict[str, Any]) -> None:
        """Takes over actor, critics, their targets and the normalisation; the entropy's weight where it is learnt.

        Args:
            further: metadata of the policy, with what `further_state` gave.
        """
        self.policy.load_state_dict(weights)
        self._fits = FITS
        weight = further.get(ENTROPY_WEIGHT)
        if self.model.log_ent_coef is not None and self.model.ent_coef_optimizer is not None and weight:
            with torch.no_grad():
                self.model.log_ent_coef.fill_(math.log(weight))

    def further_state(self) -> dict[str, Any]:
        """What a training that starts from this policy needs beside its weights."""
        weight = self.model._entropy_weight
        return {} if weight is None else {ENTROPY_WEIGHT: float(weight)}

    def scalars(self) -> dict[str, float]:
        """Losses of the last update."""
        return {f"train/{name}": float(value) for name, value in self.model.losses.items()}

    def state(self) -> dict[str, Any]:
        """Everything but the replay buffer's large arrays, as plain data; for `restore`."""
        model = self.model
        entropy = model.log_ent_coef if model.ent_coef_optimizer is not None else None
        return {
            "policy": model.policy.state_dict(),
            "actor_optimizer": model.actor.optimizer.state_dict(),
            "critic_optimizer": model.critic.optimizer.state_dict(),
            "log_ent_coef": None if entropy is None else entropy.detach(),
            "ent_coef_optimizer": None if entropy is None else model.ent_coef_optimizer.state_dict(),  # type: ignore[union-attr]
            "noise": model.noise.get_state(),  # type: ignore[union-attr]
            "generator": self._generator.bit_generator.state,
            "owed": self._owed,
            "fits": (self._fits, self._next_fit),
            "updates": self.updates,
            "entropy_weight": model._entropy_weight,
            "replay": self.replay.state(),
        }

    def chunks(self) -> Any:
        """The replay buffer's arrays in pieces: name, version, array."""
        return self.replay.chunks()

    def restore(self, state: dict[str, Any], chunks: dict[str, NDArray[Any]]) -> None:
        """Goes on where a learner with the same settings was saved."""
        model = self.model
        model.policy.load_state_dict(state["policy"])
        model.actor.optimizer.load_state_dict(state["actor_optimizer"])
        model.critic.optimizer.load_state_dict(state["critic_optimizer"])
        if state["log_ent_coef"] is not None and model.log_ent_coef is not None:
            with torch.no_grad():
                model.log_ent_coef.copy_(state["log_ent_coef"])
            model.ent_coef_optimizer.load_state_dict(state["ent_coef_optimizer"])  # type: ignore[union-attr]
        model.noise.set_state(state["noise"])  # type: ignore[union-attr]
        self._generator.bit_generator.state = state["generator"]
        self._owed, self.updates = state["owed"], state["updates"]
        self._fits, self._next_fit = state["fits"]
        weight = state["entropy_weight"]
        model._n_updates, model._entropy_weight = self.updates, None if weight is None else weight.to(model.device)
        self.replay.restore(state["replay"], chunks)
