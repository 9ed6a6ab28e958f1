"""A wire of pixels that is to reach a dot, as images or X-ray images, with an expert and a perception, for tests."""

from collections.abc import Iterator, Sequence
from typing import Any

import gymnasium
import numpy as np

from enn.imitation.advised_episodes import EpisodeStart, play_advised
from enn.imitation.images.egocentric import VIEW_SIZE
from enn.imitation.images.lumen_segmentation import LumenSegmenter
from enn.imitation.images.perception import IMAGE_KEYS, XRAY_KEYS, ImagePerception
from enn.imitation.recurrent_policy import RecurrentPolicy, RecurrentPolicySettings
from enn.imitation.sequence_cloning import AdvisedEpisode, SequenceCloningSettings

SIZE = 32
SMALL = RecurrentPolicySettings(features=VIEW_SIZE, hints=3, hidden=24, action_repeat=2)
CLONING = SequenceCloningSettings(epochs=1, batch_size=8, learning_rate=1e-2)


def vessels(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Images of a dark band in a slope of grey, and where the band is."""
    generator = np.random.default_rng(seed)
    rows, columns = np.mgrid[:SIZE, :SIZE]
    lumens = np.stack(
        [np.abs(columns - c - t * (rows - 16)) < 4 for c, t in generator.uniform((8, -0.5), (24, 0.5), (count, 2))]
    )
    return 150 + 2.0 * rows - 40.0 * lumens, lumens.astype(np.float32)


class WireEnv(gymnasium.Env):
    """A straight wire of pixels that comes in from below and is to reach the dot's row."""

    action_space = gymnasium.spaces.Box(-1, 1, (2,), np.float32)
    observation_space = gymnasium.spaces.Dict(
        {name: gymnasium.spaces.Box(0, 255, (1, SIZE, SIZE), np.uint8) for name in IMAGE_KEYS}
        | {"roadmap": gymnasium.spaces.Box(-np.inf, np.inf, (3,), np.float32)}
    )

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.column, self.goal = (int(k) for k in self.np_random.integers((8, 6), (24, 18)))
        self.tip, self.steps = 27.0, 0
        return self._observe(), {}

    def _observe(self) -> dict[str, np.ndarray]:
        mask = np.zeros((1, SIZE, SIZE), np.uint8)
        mask[0, round(self.tip) :, self.column] = 255
        rows, columns = np.mgrid[:SIZE, :SIZE]
        dot = (np.hypot(rows - self.goal, columns - self.column) < 2).astype(np.uint8)[None] * 255
        image = np.where(mask > 0, 20, 150 - 40 * (np.abs(columns - self.column) < 4)).astype(np.uint8)
        far = np.array([(self.tip - self.goal) / 10, self.tip / SIZE, 1.0], np.float32)
        return {"image": image, "mask": mask, "goal_image": dot, "roadmap": far}

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.tip = float(np.clip(self.tip - 1.5 * action[0], 1, 29))
        self.steps += 1
        success = abs(self.tip - self.goal) < 1.0
        return self._observe(), 0.0, success, not success and self.steps >= 30, {"success": success}


class XrayWireEnv(WireEnv):
    """The same wire in noise, without its mask: there is what was there before instead."""

    observation_space = gymnasium.spaces.Dict(
        {name: gymnasium.spaces.Box(0, 255, (1, SIZE, SIZE), np.uint8) for name in XRAY_KEYS}
        | {"roadmap": gymnasium.spaces.Box(-np.inf, np.inf, (3,), np.float32)}
    )

    def _observe(self) -> dict[str, np.ndarray]:
        observation = super()._observe()
        mask = observation.pop("mask")
        noise = self.np_random.normal(0.0, 2.0, (3, 1, SIZE, SIZE))
        band = 40.0 * (np.abs(np.arange(SIZE) - self.column) < 4)[None, None] * np.ones((1, SIZE, 1))
        pictures = {"image": 130.0 - 30 * (mask > 0), "plain": np.full(mask.shape, 130.0), "contrast": 150 - band}
        seen = {
            name: np.clip(np.rint(grey + one), 0, 255).astype(np.uint8)
            for (name, grey), one in zip(pictures.items(), noise, strict=True)
        }
        return {**observation, **seen}


class Expert:
    """Goes forward while the dot is ahead."""

    keys = ("roadmap",)
    action_repeat = 2
    action_space = WireEnv.action_space

    def act_batch(self, observations: dict[str, np.ndarray], deterministic: bool = True) -> np.ndarray:
        ahead = np.clip(5 * observations["roadmap"][:, 0], -1, 1)
        return np.stack((ahead, np.zeros_like(ahead)), axis=1).astype(np.float32)


def policy_on(perception: ImagePerception, device: str = "cpu") -> RecurrentPolicy:
    return RecurrentPolicy(SMALL, 0, device, perception.content())


def starts(envs: Sequence[gymnasium.Env], perception: ImagePerception, seeds: Sequence[int]) -> Iterator[EpisodeStart]:
    free = list(envs)
    for seed in seeds:
        env = free.pop(0)
        yield EpisodeStart(env, seed, perception.begin, lambda own=env: free.append(own), target="dot")


def advised(
    policy: RecurrentPolicy,
    perception: ImagePerception,
    teacher_share: float,
    seed: int,
    count: int = 12,
    kind: type[WireEnv] = WireEnv,
) -> list[AdvisedEpisode]:
    """Episodes with the expert's advice, four at a time."""
    return play_advised(
        starts([kind() for _ in range(4)], perception, range(100 * seed, 100 * seed + count)), Expert(), policy,
        perception, teacher_share=teacher_share, noise=0.1, generator=np.random.default_rng(seed), hint_key="roadmap",
        side_by_side=4,
    )  # fmt: skip


def untrained() -> ImagePerception:
    """A perception whose segmenter knows nothing."""
    return ImagePerception(LumenSegmenter(4, SIZE))
