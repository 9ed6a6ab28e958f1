"""Image student: a recurrent network that steers by the egocentric view alone, taught by an expert with a roadmap.

There are two kinds. One is told the wire's pixels and finds the lumen in the episode's first image. The other has X-ray
images alone, and from before the episode a contrast run: an image without wire or contrast medium, and one with
contrast medium in the vessels. It finds wire and lumen by networks of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from enn.devices import device_of
from enn.imitation.egocentric import VIEW_SIZE, EgocentricView, without_wire
from enn.imitation.lumen_segmentation import LumenSegmenter
from enn.imitation.wire_segmentation import WireSegmenter
from enn.model_file import UNFIT, another_architecture, read_model, write_model
from enn.setting_kinds import Count, LearningRate, Units, UnitsOrNone, Weight, settings

FORMAT = "enn-image-student-2"
IMAGE_KEYS = ("image", "mask", "goal_image")  # all that a student sees that is told the wire's pixels
XRAY_KEYS = ("image", "plain", "contrast", "goal_image")  # ... and one that must find wire and vessel itself


@settings
class StudentSettings:
    """The student's network and its training.

    Attributes:
        view: numbers that a look gives.
        hints: numbers of the expert's observation that the network learns to tell along with the action.
        hidden: units of the recurrent layer.
        action_repeat: environment steps a decision.
        hint_weight: of the loss of the hints.
        learning_rate: of Adam at the start of each round; it falls to a tenth.
        batch_size: episodes an update.
    """

    view: Units = VIEW_SIZE
    hints: UnitsOrNone = 64
    hidden: Units = 128
    action_repeat: Count = 4
    hint_weight: Weight = 0.1
    learning_rate: LearningRate = 2e-3
    batch_size: Count = 16


class StudentNetwork(nn.Module):
    """Views of an episode so far to an action: a layer, a gated recurrent unit, a layer; one head more for hints."""

    def __init__(self, settings: StudentSettings) -> None:
        super().__init__()
        width = settings.hidden
        self.mean: Tensor
        self.scale: Tensor
        self.register_buffer("mean", torch.zeros(settings.view))
        self.register_buffer("scale", torch.ones(settings.view))
        self.inner = nn.Sequential(nn.Linear(settings.view, width), nn.ReLU())
        self.memory = nn.GRU(width, width, batch_first=True)
        self.outer = nn.Sequential(nn.Linear(2 * width, width), nn.ReLU())
        self.action, self.hint = nn.Linear(width, 2), nn.Linear(width, max(settings.hints, 1))

    def forward(self, views: Tensor, memory: Tensor | None = None) -> tuple[Tensor, Tensor, Tensor]:
        """Actions and hints for sequences of views, and the memory after them.

        Args:
            views: shape (N, T, view).
            memory: from before, shape (1, N, hidden); None: the episodes begin.

        Returns:
            Actions (N, T, 2) in -1 to 1; hints (N, T, hints); memory (1, N, hidden).
        """
        seen = self.inner(((views - self.mean) * self.scale).clamp(-5.0, 5.0))
        remembered, memory = self.memory(seen, memory)
        thought = self.outer(torch.cat((seen, remembered), -1))
        return torch.tanh(self.action(thought)), self.hint(thought), memory


@dataclass(frozen=True, eq=False)
class Lesson:
    """One episode: what the student saw, and what the expert would have done.

    Attributes:
        views: shape (T, view).
        actions: the expert's. Shape (T, 2).
        hints: the expert's observations. Shape (T, hints).
        success: whether the target was reached.
    """

    views: NDArray[np.float32]
    actions: NDArray[np.float32]
    hints: NDArray[np.float32]
    success: bool

    def __post_init__(self) -> None:
        """Checks that the lengths agree and all is finite."""
        lengths = {len(self.views), len(self.actions), len(self.hints)}
        if len(lengths) != 1 or lengths == {0}:
            raise ValueError(f"a lesson needs as many views as actions and hints, got lengths {sorted(lengths)}")
        for name in ("views", "actions", "hints"):
            if not np.isfinite(getattr(self, name)).all():
                raise ValueError(f"a lesson's {name} must be finite: leave this episode out")


class ImageStudent:
    """Network and segmenters together: from images to actions.

    Args:
        settings: of the network.
        segmenter: finds the lumen in an episode's first image, or in that of a contrast run.
        seed: of the network's weights.
        device: of all networks.
        wire: finds the wire in every image; None: the mask is observed.
    """

    def __init__(
        self,
        settings: StudentSettings,
        segmenter: LumenSegmenter,
        seed: int = 0,
        device: torch.device | str = "cpu",
        wire: WireSegmenter | None = None,
    ) -> None:
        self.settings, self.segmenter = settings, segmenter.to(device)
        self.wire = None if wire is None else wire.to(device)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.network = StudentNetwork(settings).to(device)

    @property
    def action_repeat(self) -> int:
        """Environment steps a decision."""
        return self.settings.action_repeat

    @property
    def keys(self) -> tuple[str, ...]:
        """Names of the observations that it sees."""
        return IMAGE_KEYS if self.wire is None else XRAY_KEYS

    def mask(self, observation: Mapping[str, NDArray[Any]]) -> NDArray[np.uint8]:
        """The wire's pixels, not 0, as observed or found. Shape (1, size, size)."""
        if self.wire is None:
            return observation["mask"]
        return self.wire.mask(observation["image"][0], observation["plain"][0])[None]

    def begin(self, observation: Mapping[str, NDArray[Any]]) -> EgocentricView:
        """The view of an episode, from its first observation.

        Raises:
            ValueError: an image is missing.
        """
        missing = [key for key in self.keys if key not in observation]
        if missing:
            raise ValueError(
                f"the student sees {', '.join(self.keys)}, but {', '.join(missing)} is missing: make the environment "
                "with these observations"
            )
        image, mask, dot = observation["image"], self.mask(observation), observation["goal_image"]
        view = EgocentricView()
        if self.wire is None:
            view.start(image, mask, dot, self.segmenter.lumen(without_wire(image[0], mask[0] > 0)))
        else:
            lumen = self.segmenter.lumen(observation["contrast"][0])
            view.start(image, mask, dot, lumen, empty=observation["plain"])
        return view

    @torch.inference_mode()
    def act(self, views: NDArray[np.float32], memory: Tensor | None) -> tuple[NDArray[np.float32], Tensor]:
        """Actions for one look of N episodes and the memory after it. Shapes (N, view) to (N, 2), (1, N, hidden)."""
        actions, _, memory = self.network(torch.as_tensor(views)[:, None].to(device_of(self.network)), memory)
        return actions[:, 0].cpu().numpy(), memory

    def controller(self) -> StudentController:
        """The student over episodes; call `reset()` at the start of each."""
        return StudentController(self)

    def fit(
        self,
        lessons: Sequence[Lesson],
        epochs: int,
        *,
        seed: int = 0,
        progress: Callable[[int, float], None] | None = None,
    ) -> float:
        """Trains on lessons, going on from the weights that there are.

        Args:
            lessons: episodes.
            epochs: passes over them.
            seed: of their order.
            progress: called with each epoch's number and mean loss.

        Returns:
            The mean loss of the last epoch.

        Raises:
            ValueError: no lessons, or of other sizes than the network's.
        """
        settings, network = self.settings, self.network
        if not lessons:
            raise ValueError("a student needs at least one lesson")
        if lessons[0].views.shape[1] != settings.view or lessons[0].hints.shape[1] != settings.hints:
            raise ValueError(
                f"the student takes views of {settings.view} and hints of {settings.hints} numbers, got "
                f"{lessons[0].views.shape[1]} and {lessons[0].hints.shape[1]}"
            )
        if not bool((network.mean != 0).any()):  # the scale is that of the first lessons
            every = np.concatenate([lesson.views for lesson in lessons])
            network.mean.copy_(torch.as_tensor(every.mean(0)))
            network.scale.copy_(torch.as_tensor(1.0 / (every.std(0) + 0.05)))
        generator = np.random.default_rng(seed)
        optimiser = torch.optim.Adam(network.parameters(), settings.learning_rate, fused=True)
        batches = -(-len(lessons) // settings.batch_size)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(
            optimiser, epochs * batches, eta_min=settings.learning_rate / 10
        )
        network.train()
        mean = float("nan")
        for epoch in range(epochs):
            # episodes of like length go together, so that little is computed in vain
            order = sorted(generator.permutation(len(lessons)), key=lambda i: len(lessons[i].views) // 8)
            parts = np.array_split(np.array(order), batches)
            total = 0.0
            for k in generator.permutation(batches):
                loss = self._loss([lessons[i] for i in parts[k]])
                optimiser.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(network.parameters(), 1.0)
                optimiser.step()
                schedule.step()
                total += float(loss.detach()) / batches
            mean = total
            if progress is not None:
                progress(epoch, mean)
        network.eval()
        return mean

    def _loss(self, lessons: Sequence[Lesson]) -> Tensor:
        pad = nn.utils.rnn.pad_sequence
        views, wanted, hints, counted = (
            pad([torch.as_tensor(part) for part in parts], batch_first=True).to(device_of(self.network))
            for parts in (
                [lesson.views for lesson in lessons],
                [lesson.actions for lesson in lessons],
                [lesson.hints for lesson in lessons],
                [np.ones(len(lesson.views), np.float32) for lesson in lessons],
            )
        )
        actions, told, _ = self.network(views)
        error = functional.smooth_l1_loss(actions, wanted, reduction="none", beta=0.3).sum(-1)
        if self.settings.hints:
            error = error + self.settings.hint_weight * (told - hints.clamp(-3, 3)).square().mean(-1)
        return (error * counted).sum() / counted.sum()

    def save(self, path: Path | str) -> None:
        """Writes settings and weights into one file, atomically."""
        content = {
            "format": FORMAT,
            "settings": asdict(self.settings),
            "weights": self.network.state_dict(),
            "segmenter": {
                "settings": [self.segmenter.width, self.segmenter.working_size],
                "weights": self.segmenter.state_dict(),
            },
            "wire": None if self.wire is None else {"width": self.wire.width, "weights": self.wire.state_dict()},
        }
        write_model(Path(path), content)

    @classmethod
    def load(cls, path: Path | str, device: torch.device | str = "cpu") -> ImageStudent:
        """Reads a student onto a device.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: the file is damaged, holds something else, or is of another architecture.
        """
        content = read_model(Path(path), FORMAT, kind="student", verb="train")
        try:
            segmenter = LumenSegmenter(*content["segmenter"]["settings"])
            segmenter.load_state_dict(content["segmenter"]["weights"])
            wire = None
            if content["wire"] is not None:
                wire = WireSegmenter(content["wire"]["width"])
                wire.load_state_dict(content["wire"]["weights"])
            student = cls(StudentSettings(**content["settings"]), segmenter, device=device, wire=wire)
            student.network.load_state_dict(content["weights"])
        except UNFIT as error:
            raise another_architecture(Path(path), error, verb="train") from error
        segmenter.eval()
        student.network.eval()
        return student


class StudentController:
    """The student over an episode: holds each action for its action repeat."""

    def __init__(self, student: ImageStudent) -> None:
        self.student = student
        self.reset()

    def reset(self) -> None:
        """Starts an episode: the next observation is its first."""
        self._view: EgocentricView | None = None
        self._memory: Tensor | None = None
        self._action = np.zeros(2, np.float32)
        self._left = 0

    def __call__(
        self, observation: Mapping[str, NDArray[Any]], info: Mapping[str, Any] | None = None
    ) -> NDArray[np.float32]:
        """The action of this step. Shape (2,)."""
        if self._view is None:
            self._view = self.student.begin(observation)
        if self._left == 0:
            seen = self._view.look(observation["image"], self.student.mask(observation), self._action)
            actions, self._memory = self.student.act(seen[None], self._memory)
            self._action = actions[0]
            self._left = self.student.action_repeat
        self._left -= 1
        return self._action
