"""The image student: its segmenter, its recurrent network, the lessons it is given, and the file it is kept in."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch

from enn.imitation.advised_episodes import give_lessons
from enn.imitation.egocentric import VIEW_SIZE
from enn.imitation.lumen_segmentation import LumenSegmenter, fit_segmenter, overlap
from enn.imitation.recurrent_policy import IMAGE_KEYS, XRAY_KEYS, ImageStudent, Lesson, StudentSettings
from enn.imitation.wire_segmentation import fit_wire_segmenter
from enn.model_file import write_model

SIZE = 32
SMALL = StudentSettings(hints=3, hidden=24, action_repeat=2, batch_size=8, learning_rate=1e-2)


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


class Expert:
    """Goes forward while the dot is ahead."""

    keys = ("roadmap",)
    action_repeat = 2

    def act_batch(self, observations: dict[str, np.ndarray], deterministic: bool = True) -> np.ndarray:
        ahead = np.clip(5 * observations["roadmap"][:, 0], -1, 1)
        return np.stack((ahead, np.zeros_like(ahead)), axis=1).astype(np.float32)


@pytest.fixture(scope="module")
def segmenter() -> LumenSegmenter:
    images, lumens = vessels(24, 0)
    return fit_segmenter(images, lumens, epochs=12, working_size=SIZE)[0]


def lessons_of(student: ImageStudent, expert_share: float, seed: int, count: int = 12) -> list[Lesson]:
    generator = np.random.default_rng(seed)
    envs = [WireEnv() for _ in range(4)]
    seeds = range(100 * seed, 100 * seed + count)
    return give_lessons(envs, Expert(), student, seeds, expert_share=expert_share, noise=0.1, generator=generator)


def test_segmenter_finds_lumens_it_has_not_seen(segmenter: LumenSegmenter) -> None:
    images, lumens = vessels(8, 1)
    assert overlap(segmenter, images, lumens) > 0.8
    assert overlap(segmenter, 0.5 * images + 60, lumens) > 0.8  # brightness and contrast do not matter


def test_segmenter_is_the_same_from_the_same_seed() -> None:
    images, lumens = vessels(4, 0)
    weights = [fit_segmenter(images, lumens, epochs=1, working_size=SIZE, seed=3)[0].state_dict() for _ in range(2)]
    assert all(torch.equal(weights[0][name], weights[1][name]) for name in weights[0])
    with pytest.raises(ValueError, match="expected images and lumens of one shape"):
        fit_segmenter(images, lumens[:2])


def test_student_learns_what_the_expert_does(segmenter: LumenSegmenter) -> None:
    student = ImageStudent(SMALL, segmenter)
    first = lessons_of(student, 1.0, 1)
    assert all(lesson.success for lesson in first)
    assert not any(lesson.success for lesson in lessons_of(student, 0.0, 2, 8))
    loss = student.fit(first, 1)
    assert student.fit(first + lessons_of(student, 0.0, 3), 20) < 0.5 * loss
    assert np.mean([lesson.success for lesson in lessons_of(student, 0.0, 4, 12)]) > 0.8


def test_lessons_repeat_themselves(segmenter: LumenSegmenter) -> None:
    student = ImageStudent(SMALL, segmenter)
    for one, other in zip(lessons_of(student, 0.5, 5, 6), lessons_of(student, 0.5, 5, 6), strict=True):
        np.testing.assert_array_equal(one.views, other.views)
        np.testing.assert_array_equal(one.actions, other.actions)
        assert one.views.shape == (len(one.hints), VIEW_SIZE)


def test_controller_holds_its_actions_and_survives_the_file(segmenter: LumenSegmenter, tmp_path: Path) -> None:
    student = ImageStudent(SMALL, segmenter)
    student.fit(lessons_of(student, 1.0, 1, 8), 2)
    student.save(tmp_path / "student.pt")
    twin = ImageStudent.load(tmp_path / "student.pt")
    steer, other = student.controller(), twin.controller()
    for episode in range(2):
        steer.reset()
        other.reset()
        env = WireEnv()
        observation, _ = env.reset(seed=episode)
        actions = []
        for _ in range(6):
            actions.append(steer(observation))
            np.testing.assert_array_equal(actions[-1], other(observation, {}))
            observation = env.step(actions[-1])[0]
        np.testing.assert_array_equal(actions[0], actions[1])
        assert (actions[1] != actions[2]).any()


def test_says_what_is_wrong(segmenter: LumenSegmenter, tmp_path: Path) -> None:
    student = ImageStudent(SMALL, segmenter)
    observation, _ = WireEnv().reset(seed=0)
    with pytest.raises(ValueError, match="but goal_image is missing"):
        student.begin({key: observation[key] for key in ("image", "mask")})
    with pytest.raises(ValueError, match="views of 63 and hints of 3 numbers, got 5 and 3"):
        student.fit([Lesson(np.zeros((2, 5)), np.zeros((2, 2)), np.zeros((2, 3)), True)], 1)
    with pytest.raises(ValueError, match="at least one lesson"):
        student.fit([], 1)
    with pytest.raises(ValueError, match="hints must be finite"):
        Lesson(np.zeros((2, 5)), np.zeros((2, 2)), np.full((2, 3), np.nan), True)
    with pytest.raises(ValueError, match="as many views as actions"):
        Lesson(np.zeros((3, 5)), np.zeros((2, 2)), np.zeros((2, 3)), True)
    other = ImageStudent(StudentSettings(hints=3, hidden=24, action_repeat=4), segmenter)
    with pytest.raises(ValueError, match="hold actions equally long, got 2 and 4"):
        lessons_of(other, 1.0, 1)
    (tmp_path / "broken.pt").write_bytes(b"no file of torch")
    with pytest.raises(ValueError, match="is damaged or no student"):
        ImageStudent.load(tmp_path / "broken.pt")
    write_model(tmp_path / "other.pt", {"format": "something else"})
    with pytest.raises(ValueError, match="is no student of format"):
        ImageStudent.load(tmp_path / "other.pt")


class XrayWireEnv(WireEnv):
    """The same wire in noise, without its mask: the student has what was there before instead."""

    observation_space = gymnasium.spaces.Dict(
        {name: gymnasium.spaces.Box(0, 255, (1, SIZE, SIZE), np.uint8) for name in XRAY_KEYS}
        | {"roadmap": gymnasium.spaces.Box(-np.inf, np.inf, (3,), np.float32)}
    )

    def _observe(self) -> dict[str, np.ndarray]:
        told = super()._observe()
        mask = told.pop("mask")
        noise = self.np_random.normal(0.0, 2.0, (3, 1, SIZE, SIZE))
        band = 40.0 * (np.abs(np.arange(SIZE) - self.column) < 4)[None, None] * np.ones((1, SIZE, 1))
        pictures = {"image": 130.0 - 30 * (mask > 0), "plain": np.full(mask.shape, 130.0), "contrast": 150 - band}
        seen = {
            name: np.clip(np.rint(grey + one), 0, 255).astype(np.uint8)
            for (name, grey), one in zip(pictures.items(), noise, strict=True)
        }
        return {**told, **seen}


def test_a_student_of_x_ray_images_needs_no_mask(segmenter: LumenSegmenter, tmp_path: Path) -> None:
    env = XrayWireEnv()
    frames = []
    for seed in range(40):
        observation, _ = env.reset(seed=seed)
        env.tip = float(env.np_random.uniform(2, 29))
        mask = WireEnv._observe(env)["mask"]
        observation = env._observe()
        frames.append((observation["image"][0], observation["plain"][0], mask[0]))
    wire, score = fit_wire_segmenter(*(np.stack(one) for one in zip(*frames, strict=True)), epochs=12)
    assert score > 0.9
    student = ImageStudent(SMALL, segmenter, wire=wire)
    assert (student.keys, "mask" in env.observation_space.spaces) == (XRAY_KEYS, False)

    def lessons(share: float, seed: int) -> list[Lesson]:
        seeds, generator = range(100 * seed, 100 * seed + 12), np.random.default_rng(seed)
        return give_lessons([XrayWireEnv() for _ in range(4)], Expert(), student, seeds, expert_share=share,
                            noise=0.1, generator=generator)  # fmt: skip

    student.fit(lessons(1.0, 1) + lessons(0.0, 3), 20)
    assert np.mean([lesson.success for lesson in lessons(0.0, 4)]) > 0.8
    student.save(tmp_path / "student.pt")
    twin = ImageStudent.load(tmp_path / "student.pt")
    observation, _ = XrayWireEnv().reset(seed=7)
    np.testing.assert_array_equal(student.controller()(observation), twin.controller()(observation))
    with pytest.raises(ValueError, match="the student sees image, plain, contrast, goal_image, but contrast, goal_im"):
        student.begin({key: observation[key] for key in ("image", "plain")})
