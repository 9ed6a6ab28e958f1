"""Shipped policies: found by name, refused in one sentence where they cannot be used, and each steers."""

from collections.abc import Callable
from pathlib import Path

import gymnasium
import numpy as np
import pytest

import enn
from enn import shipped
from enn.imitation.images.lumen_segmentation import LumenSegmenter
from enn.imitation.images.perception import ImagePerception
from enn.imitation.images.policy import ImagePolicy
from enn.model_file import decoded, write_model
from enn.policy import Policy
from tests.enn.imitation.straight_wire import SIZE, WireEnv, policy_on
from tests.enn.test_model_file import policy

CARD = "# {}\n\nSteers a\nwire.\n\n| file |\n"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder in the place of the installed weights, with one policy of each kind."""
    monkeypatch.setattr(shipped, "files", lambda package: tmp_path / package)
    weights = tmp_path / "enn.weights"
    policy().save(weights / "teacher.pt")
    policy_on(ImagePerception(LumenSegmenter(4, SIZE))).save(weights / "seer.pt", seed=3)
    for name in ("teacher", "seer"):
        (weights / f"{name}.md").write_text(CARD.format(name))
    return weights


def test_half_precision_acts_nearly_the_same_from_half_the_bytes(folder: Path) -> None:
    whole = policy()
    whole.save(folder / "half.pt", half=True)
    seen = {"tip": np.full(3, 0.3, np.float32)}
    np.testing.assert_allclose(policy_file(folder / "half.pt").act(seen), whole.act(seen), atol=2e-3)
    weights = decoded((folder / "half.pt").read_bytes())["weights"]
    assert {str(value.dtype) for value in weights.values()} == {"torch.float16"}


def test_the_expert_network_reaches_its_target() -> None:
    pytest.importorskip("cathsim")
    steering = enn.load("type_1_lcca")
    env = gymnasium.make("cathsim/Navigate-v0", phantom="type_1", target="lcca", observation=steering.keys)
    controller, (observation, info), ended = steering.controller(), env.reset(seed=3), False
    while not ended:
        observation, _, terminated, truncated, info = env.step(controller(observation, info))
        ended = terminated or truncated
    env.close()
    assert terminated


def policy_file(path: Path) -> Policy:
    return Policy.load(path)


def test_a_policy_of_images_steers(folder: Path) -> None:
    loaded = enn.load("seer")
    assert isinstance(loaded, ImagePolicy)
    assert loaded.metadata == {"seed": 3}
    observation, _ = WireEnv().reset(seed=0)
    controller = loaded.controller()
    assert loaded.keys == ("image", "mask", "goal_image")
    assert controller.view is None
    first = controller(observation)
    assert controller.view is not None
    for _ in range(loaded.action_repeat - 1):
        np.testing.assert_array_equal(controller(observation), first)


def rename_format(path: Path) -> None:
    write_model(path, {**decoded(path.read_bytes()), "format": "enn-policy-0"})


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-5])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (rename_format, r"the model 'teacher' has format enn-policy-0, but enn 0\.1\.0 reads enn-policy-1 and"),
        (cut, "teacher.pt is damaged or no policy"),
    ],
)
def test_a_file_that_cannot_be_used_is_refused(folder: Path, change: Callable[[Path], None], message: str) -> None:
    change(folder / "teacher.pt")
    with pytest.raises(ValueError, match=message):
        enn.load("teacher")


@pytest.mark.parametrize("use", [enn.load, shipped.card])
def test_an_unknown_name_is_refused_with_the_known_ones(folder: Path, use: Callable[[str], object]) -> None:
    with pytest.raises(ValueError, match=r"there is no model '\.\./teacher': choose from seer, teacher"):
        use("../teacher")
