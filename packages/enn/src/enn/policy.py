"""Policy: what a training leaves behind, from raw observations to actions, and the one file that it is kept in."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.policies import BasePolicy
from torch import Tensor

from enn.bounded_content import built_from
from enn.model_file import UNFIT, another_architecture, read_model, write_model
from enn.networks.network import NetworkSettings, action_distribution, actor_features, build_network
from enn.networks.observation_spaces import require_keys

if TYPE_CHECKING:
    from enn.encoder import Encoder

FORMAT = "enn-policy-1"
_LARGEST_SPACE = 1 << 24  # numbers of an observation or action: an image of 4,096 x 4,096 px
Observation = Mapping[str, NDArray[Any]] | NDArray[Any]


class Policy:
    """A trained policy: optional frozen encoder, network, and how its actions are to be repeated.

    Args:
        module: the network, an actor (and critic) of stable-baselines3.
        encoder: turns observations into features before the network, or None.
        action_repeat: environment steps that each action is meant for.
        metadata: whatever else is worth keeping: seed, decisions, phantom, target.
        critics: whether the network's critics are trained too, so that a training can go on from them.

    Raises:
        ValueError: an action repeat below 1.
    """

    def __init__(
        self,
        network: NetworkSettings,
        module: BasePolicy,
        observation_space: gymnasium.Space[Any],
        action_space: gymnasium.spaces.Box,
        *,
        encoder: Encoder | None = None,
        action_repeat: int = 1,
        metadata: dict[str, Any] | None = None,
        critics: bool = True,
    ) -> None:
        if not isinstance(action_repeat, int) or action_repeat < 1:
            raise ValueError(f"action_repeat must be a whole number of at least 1, got {action_repeat!r}")
        self.network, self.module, self.encoder = network, module, encoder
        self.observation_space, self.action_space = observation_space, action_space
        self.action_repeat = action_repeat
        self.metadata, self.critics = dict(metadata or {}), critics
        self.module.set_training_mode(False)
        if encoder is not None:
            encoder.eval().to(module.device)
            self.keys: tuple[str, ...] = encoder.keys
        elif isinstance(observation_space, gymnasium.spaces.Dict):
            self.keys = network.keys or tuple(observation_space)
        else:
            self.keys = ()
        self._low, self._high = action_space.low, action_space.high

    def act(
        self, observation: Observation, deterministic: bool = True, generator: np.random.Generator | None = None
    ) -> NDArray[np.float32]:
        """The action for one observation.

        Args:
            observation: as the environment gives it; names that the policy does not see are ignored.

        Returns:
            Within the action space. Shape (actions,).
        """
        if isinstance(observation, Mapping):
            batch = {key: np.asarray(observation[key])[None] for key in self.keys or observation if key in observation}
            return self.act_batch(batch, deterministic, generator)[0]
        return self.act_batch(np.asarray(observation)[None], deterministic, generator)[0]

    def act_batch(
        self, observations: Observation, deterministic: bool = True, generator: np.random.Generator | None = None
    ) -> NDArray[np.float32]:
        """Actions for observations with a leading N. Shape (N, actions).

        Raises:
            ValueError: an observation is missing, has another shape or type than in training, or is not finite; a
                draw without a generator.
        """
        with torch.inference_mode():
            mean, log_std = action_distribution(self.module, self._encoded(self._tensors(observations)))
            raw = mean.cpu().numpy()
            if not deterministic:
                if generator is None:
                    raise ValueError("a stochastic action needs a seeded numpy Generator")
                noise = generator.standard_normal(raw.shape, np.float32)
                raw = raw + np.exp(log_std.cpu().numpy()) * noise
        if self.network.algorithm == "sac":
            raw = (self._low + 0.5 * (np.tanh(raw) + 1.0) * (self._high - self._low)).astype(np.float32)
        return np.asarray(raw.clip(self._low, self._high), np.float32)

    def mean_action(self, observations: dict[str, Tensor] | Tensor) -> Tensor:
        """As the deterministic `act_batch`, of tensors on the policy's device, which are not checked."""
        raw, _ = action_distribution(self.module, self._encoded(observations))
        low, high = (torch.as_tensor(bound, device=raw.device) for bound in (self._low, self._high))
        if self.network.algorithm == "sac":
            raw = low + 0.5 * (torch.tanh(raw) + 1.0) * (high - low)
        return raw.clamp(low, high)

    def features(self, observations: Observation) -> NDArray[np.float32]:
        """The features Z that the decision rests on, for observations with a leading N. Shape (N, features)."""
        with torch.inference_mode():
            return actor_features(self.module, self._encoded(self._tensors(observations))).cpu().numpy()

    def controller(self, deterministic: bool = True, seed: int = 0) -> PolicyController:
        """The policy over an episode, with its action repeat; call `reset()` at the start of each."""
        return PolicyController(self, deterministic, seed)

    def _encoded(self, tensors: dict[str, Tensor] | Tensor) -> dict[str, Tensor] | Tensor:
        if self.encoder is None or not isinstance(tensors, dict):
            return tensors
        return {"features": self.encoder({key: tensors[key] for key in self.encoder.keys})}

    def _tensors(self, observations: Observation) -> dict[str, Tensor] | Tensor:
        space = self.observation_space
        if not isinstance(space, gymnasium.spaces.Dict):
            if isinstance(observations, Mapping):
                raise ValueError(
                    f"the policy sees one array of shape {space.shape}, got the observations {', '.join(observations)}"
                )
            return self._tensor("the observation", observations, space)
        if not isinstance(observations, Mapping):
            raise ValueError(f"the policy sees {', '.join(self.keys)} by name, got one array {np.shape(observations)}")
        require_keys(self.keys, observations)
        return {key: self._tensor(f"'{key}'", observations[key], space[key]) for key in self.keys}

    def _tensor(self, name: str, values: NDArray[Any], space: gymnasium.Space[Any]) -> Tensor:
        if values.shape[1:] != space.shape:
            kind = "image size" if len(space.shape or ()) == 3 else "wire or environment"
            raise ValueError(
                f"the policy was trained with {name} of shape {space.shape}, got {values.shape[1:]}: another {kind}"
            )
        learnt = np.dtype(space.dtype)
        if values.dtype != learnt and (learnt.kind != "f" or values.dtype.kind not in "fiu"):
            raise ValueError(f"the policy was trained with {name} of type {learnt}, got {values.dtype}: convert it")
        if values.dtype.kind == "f" and not np.isfinite(values).all():
            raise ValueError(f"{name} is not finite: look at what makes the observations")
        return torch.as_tensor(values.astype(learnt, copy=False)).to(self.module.device)

    def save(self, path: Path | str, *, critics: bool = False, half: bool = False, half_critics: bool = False) -> None:
        """Writes settings, spaces and weights into one file, atomically.

        Args:
            critics: with SAC's critics and their targets, which a training needs to start from the file
                (`enn.Training(initial=…)`); acting does not need them.
            half: weights in half precision, as some are shipped: half the size.
            half_critics: those of the critics alone, so that it acts as before.

        Raises:
            ValueError: critics are asked for and this policy has none.
        """
        if critics and not self.critics:
            raise ValueError("this policy has no critics: it was read from a file without them")
        weights = self.module.state_dict().items()

        def kept(value: Tensor, shorter: bool = half) -> Tensor:
            return value.half() if shorter and value.is_floating_point() else value

        content = {
            "format": FORMAT,
            "network": asdict(self.network),
            "weights": {
                key: kept(value.cpu(), half or (half_critics and not acts))
                for key, value in weights
                if (acts := _acts(self.network, key)) or critics
            },
            "observation_space": _describe(self.observation_space),
            "network_space": _describe(self.module.observation_space),
            "action_space": _describe(self.action_space),
            "encoder": None
            if self.encoder is None
            else {
                "settings": asdict(self.encoder.settings),
                "weights": {key: kept(value) for key, value in self.encoder.state_dict().items()},
            },
            "action_repeat": self.action_repeat,
            "metadata": self.metadata,
        }
        write_model(Path(path), content)

    @classmethod
    def load(cls, path: Path | str, device: torch.device | str = "cpu") -> Policy:
        """Reads a policy onto a device.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: the file is damaged, holds something else, or its weights do not fit its own settings.
        """
        path = Path(path)
        content = read_model(path, FORMAT, kind="policy", verb="train")
        encoder = None
        try:
            observation_space, action_space = _space(content["observation_space"]), _space(content["action_space"])
            network = _network_of(content)
            if content["encoder"] is not None:
                from enn.encoder import Encoder, EncoderSettings

                with built_from(content):
                    encoder = Encoder(EncoderSettings(**content["encoder"]["settings"]))
                encoder.load_state_dict(content["encoder"]["weights"])
                encoder.to(device)
            with built_from(content):
                module = build_network(network, _space(content["network_space"]), action_space)
            module.to(device)
            known = module.state_dict().keys()
            critics = content["weights"].keys() == known
            expected = known if critics else {key for key in known if _acts(network, key)}
            if expected != content["weights"].keys():
                odd = sorted(expected ^ content["weights"].keys())
                raise RuntimeError(f"weights {', '.join(odd[:3])} are missing or unexpected")
            module.load_state_dict(content["weights"], strict=False)
            return cls(
                network,
                module,
                observation_space,
                action_space,
                encoder=encoder,
                action_repeat=content["action_repeat"],
                metadata=dict(content["metadata"]),
                critics=critics,
            )
        except UNFIT as error:
            raise another_architecture(path, error, verb="train") from error


class Acts(Protocol):
    """What a `PolicyController` needs of a policy."""

    action_repeat: int

    def act(
        self, observation: Observation, deterministic: bool = True, generator: np.random.Generator | None = None
    ) -> NDArray[np.float32]:
        """The action for one observation. Shape (actions,)."""


class PolicyController:
    """A policy over an episode: holds each action for the policy's action repeat."""

    def __init__(self, policy: Acts, deterministic: bool = True, seed: int = 0) -> None:
        self.policy, self.deterministic = policy, deterministic
        self._generator = np.random.default_rng(seed)
        self._left = 0
        self._action: NDArray[np.float32]

    def reset(self) -> None:
        """Starts an episode: the next call decides again."""
        self._left = 0

    def __call__(self, observation: Observation, info: Mapping[str, Any] | None = None) -> NDArray[np.float32]:
        """The action of this step. Shape (actions,)."""
        if self._left == 0:
            self._action = self.policy.act(observation, self.deterministic, self._generator)
            self._left = self.policy.action_repeat
        self._left -= 1
        return self._action


def _network_of(content: dict[str, Any]) -> NetworkSettings:
    """The network of a file; earlier files have choices in it that there are no more."""
    sizes = dict(content["network"])
    former = {name: sizes.pop(name, ()) for name in ("critic_keys", "shared")}
    former["passthrough"] = content.get("passthrough", ())
    if any(former.values()):
        raise ValueError(f"networks with {' or '.join(name for name, value in former.items() if value)} are gone")
    return NetworkSettings(**sizes)


def _acts(network: NetworkSettings, key: str) -> bool:
    return network.algorithm != "sac" or key.startswith("actor.")


def _describe(space: gymnasium.Space[Any]) -> dict[str, Any]:
    if isinstance(space, gymnasium.spaces.Dict):
        return {"dict": {name: _describe(one) for name, one in space.spaces.items()}}
    if not isinstance(space, gymnasium.spaces.Box):
        raise ValueError(f"a policy needs Box or Dict spaces, got {space}")
    bounds = [
        [float(array.flat[0])] if (array == array.flat[0]).all() else array.ravel().tolist()
        for array in (space.low, space.high)
    ]
    return {"shape": list(space.shape), "dtype": str(space.dtype), "low": bounds[0], "high": bounds[1]}


def _space(description: dict[str, Any]) -> Any:
    if "dict" in description:
        # the order of the names is the order of the network's inputs
        return gymnasium.spaces.Dict([(name, _space(one)) for name, one in description["dict"].items()])
    shape, dtype = tuple(description["shape"]), np.dtype(description["dtype"])
    if math.prod(shape) > _LARGEST_SPACE or dtype.kind not in "biuf":
        raise ValueError(f"no space has the shape {shape} and type {dtype}")
    low, high = (
        np.broadcast_to(
            np.array(description[k]) if len(description[k]) == 1 else np.reshape(description[k], shape), shape
        ).astype(dtype)
        for k in ("low", "high")
    )
    return gymnasium.spaces.Box(low, high, shape, dtype.type)
