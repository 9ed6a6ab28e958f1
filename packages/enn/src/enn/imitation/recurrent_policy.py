"""Recurrent policy: from the features of an episode so far to an action, whatever perceives the images.

A perception makes the features. Image policies have the one of `enn.imitation.images.perception`, navigators that of
`splineformer.navigation`; both meet `Perception`, a protocol of arrays.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Protocol

import numpy as np
import torch
from annotated_types import Interval
from numpy.typing import NDArray
from torch import Tensor, nn

from enn.bounded_content import built_from
from enn.model_file import UNFIT, another_architecture, read_model, write_model
from enn.networks.devices import device_of
from enn.setting_kinds import Count, Units, UnitsOrNone, settings

FORMAT = "enn-recurrent-policy-1"
_CLIP = 5.0  # standard deviations

Observation = Mapping[str, NDArray[Any]]
Begin = Callable[[Observation], Any]  # an episode's first observation -> its view, which a perception understands


class Perception(Protocol):
    """Turns what is seen of several episodes into features, all at once.

    A view is what a perception keeps of an episode between its decisions; whoever starts the episode makes it.
    """

    def __call__(
        self, views: Sequence[Any], observations: Sequence[Observation], actions: Sequence[NDArray[np.float32]]
    ) -> NDArray[np.float32]:
        """Features of N episodes' moment; called once a decision.

        Args:
            actions: those of each, (actions,), carried out since the last decision; zeros at first.

        Returns:
            (N, features).
        """


@settings
class RecurrentPolicySettings:
    """The policy's network.

    Attributes:
        features: numbers that a decision rests on.
        encoder_blocks: first index and length of each block of features that is the output of an image encoder; one
            layer reduces all of them.
        block_units: that a block is reduced to.
        dropout: of the reduced blocks, in training.
        hidden: units of the recurrent layer.
        hints: numbers of the teacher's own observation that the network learns to predict along with the action.
        action_repeat: environment steps for which an action is held.
        actions: translation and rotation as shares of the most in a step, of the wire and of a catheter over it.
    """

    features: Units
    encoder_blocks: tuple[tuple[int, int], ...] = ()
    block_units: Units = 16
    dropout: Annotated[float, Interval(ge=0, lt=1)] = 0.2
    hidden: Units = 128
    hints: UnitsOrNone = 0
    action_repeat: Count = 4
    actions: Units = 2

    def __post_init__(self) -> None:
        """Refuses blocks of different lengths, blocks that overlap, and blocks outside the features."""
        edges = [0, *itertools.chain.from_iterable((k, k + n) for k, n in self.encoder_blocks), self.features]
        if edges != sorted(edges) or len({length for _, length in self.encoder_blocks}) > 1:
            raise ValueError(f"encoder_blocks: expected blocks of one length, in order, in {self.features} features")


class RecurrentNetwork(nn.Module):
    """Features of an episode so far to an action: blocks reduced, a layer, a gated recurrent unit, a layer."""

    def __init__(self, settings: RecurrentPolicySettings) -> None:
        super().__init__()
        self.settings = s = settings
        self.mean: Tensor
        self.scale: Tensor
        self.register_buffer("mean", torch.zeros(s.features))
        self.register_buffer("scale", torch.zeros(s.features))  # all zero: not yet fitted
        narrow = s.features
        if s.encoder_blocks:
            length = s.encoder_blocks[0][1]
            self.reduce = nn.Sequential(nn.Linear(length, s.block_units), nn.Tanh(), nn.Dropout(s.dropout))
            narrow -= len(s.encoder_blocks) * (length - s.block_units)
        self.inner = nn.Sequential(nn.Linear(narrow, s.hidden), nn.ReLU())
        self.recurrent = nn.GRU(s.hidden, s.hidden, batch_first=True)
        self.outer = nn.Sequential(nn.Linear(2 * s.hidden, s.hidden), nn.ReLU())
        self.action, self.hint = nn.Linear(s.hidden, s.actions), nn.Linear(s.hidden, max(s.hints, 1))

    def forward(self, features: Tensor, state: Tensor | None = None) -> tuple[Tensor, Tensor, Tensor]:
        """Actions and hints for sequences of features, and the recurrent state after them.

        Args:
            features: (N, T, features).
            state: (1, N, hidden) from before; None: the episodes begin.

        Returns:
            (N, T, actions) in -1 to 1, (N, T, hints), (1, N, hidden).
        """
        even = ((features - self.mean) * self.scale).clamp(-_CLIP, _CLIP)
        parts, place = [], 0
        for first, length in self.settings.encoder_blocks:
            parts += [even[..., place:first], self.reduce(even[..., first : first + length])]
            place = first + length
        inner = self.inner(torch.cat([*parts, even[..., place:]], -1))
        outputs, state = self.recurrent(inner, state)
        outer = self.outer(torch.cat((inner, outputs), -1))
        return torch.tanh(self.action(outer)), self.hint(outer), state


class RecurrentPolicy:
    """A network and what its perception is made from.

    Args:
        perception: what the file keeps for the perception: numbers, strings, lists, dictionaries and tensors.
    """

    def __init__(
        self,
        settings: RecurrentPolicySettings,
        seed: int = 0,
        device: torch.device | str = "cpu",
        perception: dict[str, Any] | None = None,
    ) -> None:
        self.settings, self.perception = settings, perception or {}
        self.metadata: dict[str, Any] = {}
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.network = RecurrentNetwork(settings).eval().to(device)

    @property
    def device(self) -> torch.device:
        """Where the network computes."""
        return device_of(self.network)

    @torch.inference_mode()
    def act(self, features: NDArray[np.float32], state: Tensor | None = None) -> tuple[NDArray[np.float32], Tensor]:
        """Actions of N episodes' decision and the state after it: (N, features) to (N, actions), (1, N, hidden)."""
        actions, _, state = self.network(torch.as_tensor(features)[:, None].to(self.device), state)
        return actions[:, 0].cpu().numpy(), state

    def save(self, path: Path | str, **metadata: Any) -> None:
        """Writes network, perception and metadata into one file, atomically."""
        content = {"settings": asdict(self.settings), "weights": self.network.state_dict()}
        write_model(Path(path), {"format": FORMAT, **content, "perception": self.perception, "metadata": metadata})

    @classmethod
    def load(cls, path: Path | str, device: torch.device | str = "cpu") -> RecurrentPolicy:
        """Reads a policy onto a device.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: the file is damaged, holds something else, or is of another architecture.
        """
        content = read_model(Path(path), FORMAT, kind="recurrent policy", verb="train")
        try:
            with built_from(content):
                policy = cls(RecurrentPolicySettings(**content["settings"]), 0, device, dict(content["perception"]))
            policy.network.load_state_dict(content["weights"])
            policy.metadata = dict(content["metadata"])
        except UNFIT as error:
            raise another_architecture(Path(path), error, verb="train") from error
        return policy


class RecurrentController:
    """A policy over episodes, holding each action for its action repeat; call `reset()` at the start of each.

    Args:
        perception: makes its features; asked only when the policy decides.
        begin: makes an episode's view from its first observation.
    """

    def __init__(self, policy: RecurrentPolicy, perception: Perception, begin: Begin) -> None:
        self.policy, self.perception, self._begin = policy, perception, begin
        self.reset()

    def reset(self) -> None:
        """Starts an episode: the next observation is its first."""
        self._view: Any = None
        self._state: Tensor | None = None
        self._action = np.zeros(self.policy.settings.actions, np.float32)
        self._left = 0

    @property
    def view(self) -> Any:
        """What the perception keeps of the episode; None before the first decision."""
        return self._view

    def __call__(self, observation: Observation, info: Mapping[str, Any] | None = None) -> NDArray[np.float32]:
        """The (actions,) of this step."""
        if self._view is None:
            self._view = self._begin(observation)
        if self._left == 0:
            features = self.perception([self._view], [observation], [self._action])
            actions, self._state = self.policy.act(features, self._state)
            self._action = actions[0]
            self._left = self.policy.settings.action_repeat
        self._left -= 1
        return self._action
