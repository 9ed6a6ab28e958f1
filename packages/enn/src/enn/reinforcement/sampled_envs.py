"""Sampled environments as stable-baselines3 takes them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import gymnasium
from stable_baselines3.common.vec_env import VecEnv

from enn.reinforcement.sampling import Sampling


class SampledEnvs(Sampling, VecEnv):
    """`Sampling` in this process, for stable-baselines3."""

    def __init__(self, factories: Sequence[Callable[[], gymnasium.Env[Any, Any]]], **settings: Any) -> None:
        Sampling.__init__(self, factories, **settings)
        VecEnv.__init__(self, self.num_envs, self.observation_space, self.action_space)

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute of each environment."""
        return super().get_attr(attr_name, list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Sets an attribute of each environment."""
        super().set_attr(attr_name, value, list(self._get_indices(indices)))

    def env_method(self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any) -> list[Any]:
        """Calls a method of each environment."""
        return super().env_method(method_name, *method_args, indices=[*self._get_indices(indices)], **method_kwargs)

    def env_is_wrapped(
        self, wrapper_class: type[gymnasium.Wrapper[Any, Any, Any, Any]], indices: Any = None
    ) -> list[bool]:
        """Whether each environment is wrapped so; Monitor is not needed, episodes are counted here."""
        return [False for _ in self._get_indices(indices)]
