"""Image policies learn what an expert does, by the true mask or by noisy X-rays, and survive their file; segmenters."""

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

from enn.imitation.images.egocentric import CATHETER_SIZE, VIEW_SIZE
from enn.imitation.images.lumen_segmentation import LumenSegmenter, fit_segmenter, overlap
from enn.imitation.images.perception import XRAY_KEYS, ImagePerception, subtracted
from enn.imitation.images.policy import ImagePolicy
from enn.imitation.images.stereo_view import CATHETER_SIZE as STEREO_CATHETER_SIZE
from enn.imitation.images.stereo_view import STEREO_SIZE
from enn.imitation.images.wire_segmentation import WireSegmenter, dice, fit_wire_segmenter, wire_frames
from enn.imitation.recurrent_policy import RecurrentPolicy, RecurrentPolicySettings
from enn.imitation.sequence_cloning import SequenceCloningSettings, clone_sequences
from tests.enn.imitation.images.two_views import FIELD, projections
from tests.enn.imitation.straight_wire import CLONING, SIZE, Expert, WireEnv, XrayWireEnv, advised, policy_on, vessels

LONG = SequenceCloningSettings(epochs=20, batch_size=8, learning_rate=1e-2)


@pytest.fixture(scope="module")
def segmenter() -> LumenSegmenter:
    images, lumens = vessels(24, 0)
    return fit_segmenter(images, lumens, epochs=12, working_size=SIZE)[0]


def test_segmenter_finds_lumens_it_has_not_seen(segmenter: LumenSegmenter) -> None:
    images, lumens = vessels(8, 1)
    assert overlap(segmenter, images, lumens) > 0.8
    assert overlap(segmenter, 0.5 * images + 60, lumens) > 0.8  # brightness and contrast do not matter


def test_policy_learns_what_the_expert_does_holds_its_actions_and_survives_the_file(
    segmenter: LumenSegmenter, tmp_path: Path
) -> None:
    perception = ImagePerception(segmenter)
    policy = policy_on(perception)
    first = advised(policy, perception, 1.0, 1)
    (loss,) = clone_sequences(policy, first, CLONING)
    assert clone_sequences(policy, first + advised(policy, perception, 0.0, 3), LONG)[-1] < 0.5 * loss
    assert np.mean([one.success for one in advised(policy, perception, 0.0, 4)]) > 0.8
    policy.save(tmp_path / "policy.pt")
    twin, seeing = ImagePolicy.load(tmp_path / "policy.pt")
    steer, other = perception.controller(policy), seeing.controller(twin)
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


def test_a_policy_of_x_ray_images_needs_no_mask(segmenter: LumenSegmenter, tmp_path: Path) -> None:
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
    perception = ImagePerception(segmenter, wire)
    policy = policy_on(perception)
    assert (perception.keys, "mask" in env.observation_space.spaces) == (XRAY_KEYS, False)

    def played(share: float, seed: int) -> list:
        return advised(policy, perception, share, seed, kind=XrayWireEnv)

    clone_sequences(policy, played(1.0, 1) + played(0.0, 3), LONG)
    assert np.mean([one.success for one in played(0.0, 4)]) > 0.8
    policy.save(tmp_path / "policy.pt")
    twin, seeing = ImagePolicy.load(tmp_path / "policy.pt")
    observation, _ = XrayWireEnv().reset(seed=7)
    np.testing.assert_array_equal(perception.controller(policy)(observation), seeing.controller(twin)(observation))
    with pytest.raises(ValueError, match="the policy sees image, plain, contrast, goal_image, but contrast, goal_im"):
        perception.begin({key: observation[key] for key in ("image", "plain")})


def test_subtracted_images_lose_what_stands_still(segmenter: LumenSegmenter) -> None:
    generator = np.random.default_rng(0)
    background = generator.uniform(60, 200, (SIZE, SIZE))
    vessel = np.ones((SIZE, SIZE))
    vessel[10:20] = 0.6
    plain, contrast = background.astype(np.uint8), (vessel * background).astype(np.uint8)
    left = subtracted(plain, contrast)
    assert left[10:20].std() < 2.0
    assert left[20:].std() < 0.01
    assert left[10:20].mean() < 0.7 * left[20:].mean()
    seen = {"plain": plain[None], "contrast": contrast[None]}
    empty = np.zeros((1, SIZE, SIZE), np.uint8)
    wire = WireSegmenter(4)
    for subtracts, image in ((True, left), (False, contrast)):
        perception = ImagePerception.of(ImagePerception(segmenter, wire, subtracts=subtracts).content())
        np.testing.assert_allclose(perception.lumen(seen, empty), segmenter.lumen(image), atol=1e-6)


def test_with_a_catheter_there_are_four_actions_and_a_network_more(segmenter: LumenSegmenter, tmp_path: Path) -> None:
    wire, tube = WireSegmenter(4), WireSegmenter(4)
    perception, bare = ImagePerception(segmenter, wire, catheter=tube), ImagePerception(segmenter, wire)
    seen, _ = XrayWireEnv().reset(seed=3)
    action = np.array([0.5, 0.0, -0.5, 0.25], np.float32)
    features = perception([perception.begin(seen)], [seen], [action])[0]
    assert perception.size == len(features) == VIEW_SIZE + CATHETER_SIZE + 2
    np.testing.assert_array_equal(features[:VIEW_SIZE], bare([bare.begin(seen)], [seen], [action])[0])
    np.testing.assert_array_equal(features[-2:], action[2:])
    settings = RecurrentPolicySettings(features=perception.size, hidden=8, actions=4)
    RecurrentPolicy(settings, perception=perception.content()).save(tmp_path / "policy.pt")
    steer = ImagePolicy.load(tmp_path / "policy.pt").controller()
    assert steer(seen).shape == (4,)


def test_two_calibrated_cameras_also_show_what_lies_in_space(segmenter: LumenSegmenter, tmp_path: Path) -> None:
    cameras, wire, tube = ("frontal", "lao_45"), WireSegmenter(4), WireSegmenter(4)
    bare = ImagePerception(segmenter, wire, cameras=cameras, catheter=tube, field=FIELD)
    perception = ImagePerception(
        segmenter, wire, cameras=cameras, catheter=tube, field=FIELD, projections=projections()
    )
    (first, _), (other, _) = XrayWireEnv().reset(seed=1), XrayWireEnv().reset(seed=2)
    seen = {key: np.concatenate((first[key], other[key])) for key in perception.keys}
    action = np.array([0.5, 0.0, -0.5, 0.25], np.float32)
    features, without = (one([one.begin(seen)], [seen], [action])[0] for one in (perception, bare))
    assert perception.size == len(features) == bare.size + STEREO_SIZE + STEREO_CATHETER_SIZE
    np.testing.assert_array_equal(features[: len(without) - 2], without[:-2])
    np.testing.assert_array_equal(features[-2:], without[-2:])
    settings = RecurrentPolicySettings(features=perception.size, hidden=8, actions=4)
    RecurrentPolicy(settings, perception=perception.content()).save(tmp_path / "policy.pt")
    again = ImagePolicy.load(tmp_path / "policy.pt").perception
    np.testing.assert_array_equal(again.voxels.geometry.projections, projections())
    with pytest.raises(ValueError, match="projections: expected two cameras with a field of view"):
        ImagePerception(segmenter, wire, cameras=cameras, projections=projections())


def test_each_camera_has_a_view_of_its_own(segmenter: LumenSegmenter) -> None:
    two, one = ImagePerception(segmenter, cameras=("frontal", "lateral")), ImagePerception(segmenter)
    (first, _), (other, _) = WireEnv().reset(seed=1), WireEnv().reset(seed=2)
    both = {key: np.concatenate((first[key], other[key])) for key in one.keys}
    action = np.array([0.5, 0.0], np.float32)
    parts = [one([one.begin(seen)], [seen], [action])[0] for seen in (first, other)]
    np.testing.assert_array_equal(two([two.begin(both)], [both], [action])[0], np.concatenate(parts))
    assert two.size == len(parts[0]) + len(parts[1])
    assert ImagePerception.of(two.content()).cameras == ("frontal", "lateral")
    assert ImagePerception.of(ImagePerception(segmenter, field=0.18).content()).field == 0.18
    with pytest.raises(ValueError, match="the policy sees the views frontal, lateral, got 1 of them"):
        two.begin(first)


IMAGE_SIZE = 64


def wires(count: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Noisy images of bent lines that come in from below, the same without them, and where they are."""
    generator = np.random.default_rng(seed)
    images, plains, masks = [], [], []
    rows = np.arange(IMAGE_SIZE)[:, None]
    for column, slope, bend, top in generator.uniform((16, -0.3, -0.004, 8), (48, 0.3, 0.004, 40), (count, 4)):
        from_below = IMAGE_SIZE - 1 - rows
        middle = column + slope * from_below + bend * from_below**2
        mask = (np.abs(np.arange(IMAGE_SIZE) - middle) < 0.8) & (rows > top)
        grey = 120 + 20 * np.sin(np.arange(IMAGE_SIZE) / 9)[None, :] + np.zeros((IMAGE_SIZE, 1))
        noise = generator.normal(0.0, 2.0, (2, IMAGE_SIZE, IMAGE_SIZE))
        plains.append(np.clip(np.rint(grey + noise[0]), 0, 255).astype(np.uint8))
        images.append(np.clip(np.rint(grey - 14 * mask + noise[1]), 0, 255).astype(np.uint8))
        masks.append(mask.astype(np.uint8))
    return np.stack(images), np.stack(plains), np.stack(masks)


@pytest.fixture(scope="module")
def network() -> WireSegmenter:
    return fit_wire_segmenter(*wires(40, 0), epochs=24)[0]


def test_it_finds_wires_it_has_not_seen(network: WireSegmenter) -> None:
    images, plains, masks = wires(20, 1)
    assert dice(network, images, plains, masks) > 0.85
    assert network.mask(plains[0], plains[1]).sum() < 3 * 255  # no wire, no mask
    assert set(np.unique(network.mask(images[0], plains[0]))) == {0, 255}


def test_a_gap_is_closed(network: WireSegmenter) -> None:
    images, plains, masks = wires(1, 2)
    row = int(np.flatnonzero(masks[0].any(axis=1)).mean())
    images[0, row : row + 2] = plains[0, row : row + 2]
    assert (network.mask(images[0], plains[0])[row : row + 2].max(axis=1) == 255).all()


class DrawnWires(gymnasium.Env):
    """A wire that is there from the start, in the image and the mask of a case; an episode takes 24 steps."""

    action_space = gymnasium.spaces.Box(-1, 1, (2,), np.float32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.steps = 0
        image, plain, mask = wires(1, (options or {})["case"])
        noise = self.np_random.integers(0, 2, image.shape, np.uint8)
        self.seen = {"image": image + noise, "plain": plain, "mask": mask, "roadmap": np.zeros(3, np.float32)}
        return self.seen, {}

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.steps += 1
        return self.seen, 0.0, False, self.steps >= 24, {}


def test_frames_come_from_every_case_and_repeat_themselves() -> None:
    frames, again = (wire_frames(DrawnWires(), Expert(), (3, 5), np.random.default_rng(4)) for _ in range(2))
    for one, other in zip(frames, again, strict=True):
        assert one.shape == (6, IMAGE_SIZE, IMAGE_SIZE)
        np.testing.assert_array_equal(one, other)
    for place, case in ((0, 3), (3, 5)):
        np.testing.assert_array_equal(frames[2][place], wires(1, case)[2][0])


def test_a_faint_wire_is_found_in_the_dark_where_there_is_little_noise(network: WireSegmenter) -> None:
    images, plains, masks = wires(20, 3)
    faint, dark = (np.rint(0.4 * one.astype(float)).astype(np.uint8) for one in (images, plains))
    assert dice(network, faint, dark, masks) > 0.85
    assert network.mask(dark[0], dark[1]).sum() < 3 * 255  # no wire, no mask
