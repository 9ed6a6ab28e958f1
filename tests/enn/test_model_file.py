"""Files of models and plain states, damaged ones are refused; shipped policies, their export, and each steers."""

import collections
import importlib.util
import json
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.spaces import Box

import enn
from enn import shipped
from enn.encoder import Encoder, EncoderSettings
from enn.export import OnnxPolicy, export_onnx
from enn.fitting import EpisodeFitProgress, EpisodeFitSettings, fit
from enn.force.prediction import ForceNetwork, ForceNetworkSettings, ForcePredictor
from enn.imitation.cloned_policy import ClonedPolicy, CloningNetwork, CloningNetworkSettings
from enn.imitation.images.lumen_segmentation import LumenSegmenter
from enn.imitation.images.perception import ImagePerception
from enn.imitation.images.policy import ImagePolicy
from enn.imitation.path_following import PathFollower, PathFollowerSettings, build
from enn.imitation.recurrent_policy import RecurrentPolicy, RecurrentPolicySettings
from enn.model_file import decoded, encoded, read_model, write_model
from enn.networks.network import NetworkSettings, build_network
from enn.policy import Policy
from enn.reinforcement.checkpoint import plain, restored
from tests.damaged_files import refusals
from tests.enn.imitation.straight_wire import SIZE, WireEnv, policy_on
from tests.forged_models import require_refusals


def read(path: Path) -> dict:
    return read_model(path, "toy-1", kind="toy", verb="build")


def test_a_failed_write_leaves_the_former_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "toy.pt"
    write_model(path, {"format": "toy-1", "number": 1})

    def full(file: Path, data: bytes) -> None:
        file.open("wb").write(data[:100])
        raise OSError("no room")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(OSError, match="no room"):
        write_model(path, {"format": "toy-1", "number": 2})
    assert read(path)["number"] == 1
    assert [file.name for file in tmp_path.iterdir()] == ["toy.pt"]


def test_what_is_no_model_is_one_sentence(tmp_path: Path) -> None:
    path = tmp_path / "toy.pt"
    with pytest.raises(FileNotFoundError, match=r"there is no toy .*toy\.pt: build one first"):
        read(path)
    path.write_bytes(b"something else")
    with pytest.raises(ValueError, match=r"is damaged or no toy \(it does not begin as one\): give the path of one"):
        read(path)
    path.write_bytes(encoded({"format": "toy-1"})[:-1])
    with pytest.raises(ValueError, match=r"is damaged or no toy \(its digest does not match\): build it again"):
        read(path)
    for other, got in (({"format": "shape-1"}, "'shape-1'"), ({}, "None"), ({"format": 1}, "1")):
        write_model(path, other)
        with pytest.raises(ValueError, match=f"is no toy of format toy-1, but {got}: give the path of one"):
            read(path)
    write_model(path, {"format": "toy-0"})
    with pytest.raises(ValueError, match="is no toy of format toy-1, but 'toy-0': build it again"):
        read(path)


def policy() -> Policy:
    space = gymnasium.spaces.Dict({"tip": Box(-np.inf, np.inf, (3,), np.float32)})
    actions = Box(-1, 1, (2,), np.float32)
    settings = NetworkSettings(hidden=(8, 8))
    return Policy(settings, build_network(settings, space, actions), space, actions)


def encoder() -> Encoder:
    return Encoder(EncoderSettings(keys=("joints",), shapes=((4,),), hidden=8, features=6))


def force_predictor() -> ForcePredictor:
    return ForcePredictor(ForceNetwork(ForceNetworkSettings(image_shape=(0, 40, 40), vector=3, hidden=(8,))))


def cloned_policy() -> ClonedPolicy:
    return ClonedPolicy(CloningNetwork(CloningNetworkSettings(shape=(1, 40, 40), features=8)))


def path_follower() -> PathFollower:
    settings = PathFollowerSettings(hidden=(8,))
    return PathFollower(build(settings, 2), settings)


def recurrent_policy() -> RecurrentPolicy:
    perception = ImagePerception(LumenSegmenter(4, 40)).content()
    return RecurrentPolicy(RecurrentPolicySettings(features=6, hidden=8, hints=2), perception=perception)


LEGAL = ("encoder", None), ("wire", None), ("metadata", {"a": 1}), ("perception", {"a": 1})

MODELS: dict[str, Callable[[], Any]] = {
    make.__name__: make for make in (policy, encoder, force_predictor, cloned_policy, path_follower, recurrent_policy)
}


def test_a_wrong_bit_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "policy.pt"
    policy().save(path)
    messages = refusals(path, lambda: Policy.load(path))
    assert all("policy.pt is damaged or no" in message for message in messages)


def test_weights_that_are_no_numbers_are_neither_written_nor_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    model, path = encoder(), tmp_path / "encoder.pt"
    model.save(path)
    before = path.read_bytes()
    next(model.parameters()).data.view(-1)[0] = float("nan")
    with pytest.raises(ValueError, match=r"encoder\.pt was not written: .*/.* is not finite"):
        model.save(path)
    assert path.read_bytes() == before
    with monkeypatch.context() as patch:
        patch.setattr("enn.model_file._not_finite", lambda content: None)
        model.save(path)
    with pytest.raises(ValueError, match=r"encoder\.pt: .*/.* is not finite"):
        Encoder.load(path)


@pytest.mark.parametrize("kind", MODELS)
def test_a_file_without_its_parts_is_one_sentence(kind: str, tmp_path: Path) -> None:
    model, path = MODELS[kind](), tmp_path / "model.pt"
    model.save(path)
    content = decoded(path.read_bytes())
    for name in content.keys() - {"format"}:
        for change in ({}, {name: None}, {name: [1, 2]}, {name: {"a": 1}}):
            write_model(path, {key: value for key, value in content.items() if key != name} | change)
            if (name, change.get(name, "gone")) in LEGAL:
                type(model).load(path)
                continue
            with pytest.raises(ValueError, match="is of another architecture than this version builds"):
                type(model).load(path)


@pytest.mark.parametrize("kind", MODELS)
def test_a_model_that_asks_for_more_than_it_holds_is_refused_before_it_is_built(kind: str, tmp_path: Path) -> None:
    model, path = MODELS[kind](), tmp_path / "model.pt"
    model.save(path)
    first = kind == "policy"
    count = require_refusals(path, lambda: type(model).load(path), forged=first)
    assert count > (30 if first else 10)


def test_a_policy_of_a_million_actions_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "policy.pt"
    policy().save(path)
    content = decoded(path.read_bytes())
    for name in ("action_space", "network_space"):
        for changed in ({"shape": [10**6]}, {"shape": [10**13]}, {"dtype": "O"}, {"dtype": "S1000000000"}):
            write_model(path, {**content, name: {**content["action_space"], **changed}})
            with pytest.raises(ValueError, match="another architecture"):
                Policy.load(path)


def _same(one: Any, other: Any) -> None:
    assert type(one) is type(other) or isinstance(one, dict)
    if isinstance(one, dict):
        assert list(one) == list(other)
        for name in one:
            _same(one[name], other[name])
    elif isinstance(one, list | tuple):
        for a, b in zip(one, other, strict=True):
            _same(a, b)
    elif isinstance(one, np.ndarray | np.generic):
        assert (one.dtype, one.shape, one.flags.f_contiguous) == (other.dtype, other.shape, other.flags.f_contiguous)
        np.testing.assert_array_equal(one, other)
    elif isinstance(one, torch.Tensor):
        assert one.dtype == other.dtype
        assert torch.equal(one, other)
    else:
        assert one == other or one != one


@pytest.mark.parametrize(
    "state",
    [
        {"python": random.getstate(), "numpy": np.random.get_state(), "torch": torch.get_rng_state()},  # noqa: NPY002
        {"generator": np.random.default_rng(0).bit_generator.state, "old": np.random.MT19937(1).state},
        {"bytes": [b"", b"\x00\xff\x80a"], "numbers": (1, -(2**200), 0.1, float("nan"), float("inf"), True, None, "a")},
        [np.arange(6).reshape(2, 3).T, np.zeros((0, 3)), np.array(3.5), np.array([True]), np.ones(3, np.float16)],
        [np.array([1, 2], np.uint64), np.array([3], np.uint32), np.array([1 + 2j])],
        [np.float32(0.1), np.float64(0.2), np.bool_(True), np.int8(3)],
        {0: {"step": torch.tensor(1.0)}, "groups": [{"lr": 0.1, "params": [0, 1]}], "empty": [{}, [], ()]},
    ],
    ids=["random", "generators", "singles", "arrays", "types", "scalars", "optimiser"],
)
def test_what_comes_back_is_what_went_in(state: Any) -> None:
    _same(state, restored(decoded(encoded(plain(state)))))


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (collections.deque(), "envs/0 is a deque, which a checkpoint cannot hold"),
        (np.array(["a"]), "envs/0 is an array of type <U1"),
        (np.array([object()]), "envs/0 is an array of type object"),
        (np.array([1], ">f4"), "envs/0 is an array of type >f4"),
        ({(1, 2): 3}, "envs/0 is a dictionary with a tuple as a key"),
        (random.Random(0), "envs/0 is a Random"),
    ],
)
def test_what_is_no_data_is_refused_by_its_place(value: Any, message: str) -> None:
    with pytest.raises(TypeError, match=message):
        plain({"envs": [value]})


class StoppedError(Exception):
    """A fit was stopped."""


def test_a_wrong_bit_in_the_checkpoint_of_a_fit_is_refused(tmp_path: Path) -> None:
    settings = EpisodeFitSettings(epochs=5, batch_size=4, checkpoint_seconds=1e6)

    def attempt(moments: int) -> None:
        torch.manual_seed(0)
        layer = torch.nn.Linear(1, 1)

        def loss(samples: Any, training: bool, generator: Any) -> torch.Tensor:
            return (layer(torch.as_tensor(samples).float()[:, None]) ** 2).mean()

        def progress(moment: EpisodeFitProgress) -> None:
            if moment.epoch >= moments:
                raise StoppedError

        fit(layer, loss, np.arange(8) // 2, settings, folder=tmp_path, progress=progress)

    with pytest.raises(StoppedError):
        attempt(1)
    path = tmp_path / "fit.pt"
    intact = path.read_bytes()

    def load() -> None:
        if path.read_bytes() != intact:
            attempt(2)

    assert all("remove it to start again" in message for message in refusals(path, load))


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
    np.testing.assert_allclose(Policy.load(folder / "half.pt").act(seen), whole.act(seen), atol=2e-3)
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


@pytest.mark.parametrize("use", [enn.load, shipped.card])
def test_an_unknown_name_is_refused_with_the_known_ones(folder: Path, use: Callable[[str], object]) -> None:
    with pytest.raises(ValueError, match=r"there is no model '\.\./teacher': choose from seer, teacher"):
        use("../teacher")


@pytest.mark.skipif(
    any(importlib.util.find_spec(name) is None for name in ("onnx", "onnxruntime", "onnxscript")),
    reason="the extra enn[onnx] is not installed",
)
def test_its_actions_are_those_of_the_policy_in_another_range_too(tmp_path: Path) -> None:
    import onnx
    import onnxruntime

    policy = enn.load("type_1_bca")
    policy.action_space = Box(-2.0, 2.0, policy.action_space.shape, np.float32)
    policy._low, policy._high = policy.action_space.low, policy.action_space.high
    file = export_onnx(policy, tmp_path / "new" / "torque_1.5")
    assert list((tmp_path / "new").iterdir()) == [file]
    assert file.name == "torque_1.5.onnx"
    session = onnxruntime.InferenceSession(str(file), providers=["CPUExecutionProvider"])
    assert tuple(one.name for one in session.get_inputs()) == policy.keys
    told = session.get_modelmeta().custom_metadata_map
    assert told["action_repeat"] == str(policy.action_repeat)
    assert (json.loads(told["action_low"]), json.loads(told["action_high"])) == ([-2, -2], [2, 2])
    wanted = []
    for seed in range(5):
        policy.observation_space.seed(seed)
        observation = policy.observation_space.sample()
        [action] = session.run(None, {key: observation[key][None] for key in policy.keys})
        wanted.append(policy.act(observation))
        assert np.abs(action[0] - wanted[-1]).max() < 1e-4
        np.testing.assert_allclose(OnnxPolicy(file).act(observation), wanted[-1], atol=1e-4)
    assert np.abs(wanted).max() > 1
    with pytest.raises(ValueError, match="action is not finite"):
        OnnxPolicy(file).act({key: np.full_like(value, np.nan) if value.dtype.kind == "f" else value
                              for key, value in observation.items()})  # fmt: skip
    wrong = {
        "action_repeat": ("0", "x"),
        "action_low": ("[NaN, -2]", "[3, 3]"),
        "action_high": ("[" * 5000, "[2, 2, 2]"),
    }
    for key, value in ((key, value) for key, values in wrong.items() for value in values):
        model = onnx.load(file)
        next(one for one in model.metadata_props if one.key == key).value = value
        onnx.save(model, tmp_path / "other.onnx")
        with pytest.raises(ValueError, match=r"other\.onnx says in its metadata .* expected a count of at least 1"):
            OnnxPolicy(tmp_path / "other.onnx")
