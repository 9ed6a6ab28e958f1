"""Files of models and plain states; damaged ones are refused."""

import collections
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch

from enn.encoder import Encoder, EncoderSettings
from enn.fitting import EpisodeFitProgress, EpisodeFitSettings, FitError, fit
from enn.force.prediction import ForceNetwork, ForceNetworkSettings, ForcePredictor
from enn.imitation.cloned_policy import ClonedPolicy, CloningNetwork, CloningNetworkSettings
from enn.imitation.images.lumen_segmentation import LumenSegmenter
from enn.imitation.images.perception import ImagePerception
from enn.imitation.path_following import PathFollower, PathFollowerSettings, build
from enn.imitation.recurrent_policy import RecurrentPolicy, RecurrentPolicySettings
from enn.model_file import another_architecture, decoded, encoded, read_model, write_model
from enn.networks.network import NetworkSettings, build_network
from enn.policy import Policy
from enn.reinforcement.checkpoint import plain, restored
from tests.damaged_files import refusals
from tests.forged_models import require_refusals


def read(path: Path) -> dict:
    return read_model(path, "toy-1", kind="toy", verb="build")


def test_what_was_written_is_read(tmp_path: Path) -> None:
    path = tmp_path / "new" / "toy.pt"
    write_model(path, {"format": "toy-1", "sizes": (2, 3), "weights": {"a": torch.arange(3)}})
    content = read(path)
    assert content["sizes"] == (2, 3)
    assert content["weights"]["a"].tolist() == [0, 1, 2]
    assert [file.name for file in path.parent.iterdir()] == ["toy.pt"]


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
    with pytest.raises(ValueError, match=r"is damaged or no toy \(its digest does not match\): build it again"):
        read(path)
    write_model(path, {"format": "toy-0"})
    with pytest.raises(ValueError, match="is no toy of format toy-1, but 'toy-0': build it again"):
        read(path)
    assert "x.pt is of another architecture than this version builds (sizes differ): fit it again" in str(
        another_architecture(Path("x.pt"), RuntimeError("sizes\n  differ"), verb="fit")
    )


Box = gymnasium.spaces.Box


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


@pytest.mark.parametrize("kind", MODELS)
def test_a_wrong_bit_is_refused(kind: str, tmp_path: Path) -> None:
    model = MODELS[kind]()
    path = tmp_path / "policy.pt"
    model.save(path)
    messages = refusals(path, lambda: type(model).load(path))
    assert all("policy.pt is damaged or no" in message and message.endswith("it again") for message in messages)


@pytest.mark.parametrize("value", [float("nan")])
@pytest.mark.parametrize("kind", MODELS)
def test_weights_that_are_no_numbers_are_neither_written_nor_read(
    kind: str, value: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = MODELS[kind]()
    path = tmp_path / "policy.pt"
    model.save(path)
    before = path.read_bytes()
    module = next(part for part in (model, *vars(model).values()) if isinstance(part, torch.nn.Module))
    next(weight for name, weight in module.named_parameters() if "critic" not in name).data.view(-1)[0] = value
    with pytest.raises(ValueError, match=r"policy\.pt was not written: .*/.* is not finite; train it again"):
        model.save(path)
    assert path.read_bytes() == before
    with monkeypatch.context() as patch:
        patch.setattr("enn.model_file._not_finite", lambda content: None)
        model.save(path)
    with pytest.raises(ValueError, match=r"policy\.pt: .*/.* is not finite: \w+ it again"):
        type(model).load(path)


@pytest.mark.parametrize("kind", MODELS)
def test_a_file_without_its_parts_is_one_sentence(kind: str, tmp_path: Path) -> None:
    model, path = MODELS[kind](), tmp_path / "model.pt"
    model.save(path)
    content = decoded(path.read_bytes())
    for name in content.keys() - {"format"}:
        for change in ({}, {name: None}, {name: [1, 2]}, {name: {"a": 1}}, {name: "text"}):
            write_model(path, {key: value for key, value in content.items() if key != name} | change)
            if (name, change.get(name, "gone")) in LEGAL:
                type(model).load(path)
                continue
            with pytest.raises(ValueError, match="is of another architecture than this version builds"):
                type(model).load(path)


def test_a_wrong_bit_in_the_checkpoint_of_a_fit_is_refused(tmp_path: Path) -> None:
    def attempt(stop: bool) -> None:
        torch.manual_seed(0)
        layer = torch.nn.Linear(1, 1)

        def loss(samples: Any, training: bool, generator: Any) -> torch.Tensor:
            return (layer(torch.as_tensor(samples).float()[:, None]) ** 2).mean()

        def progress(moment: EpisodeFitProgress) -> None:
            if stop or moment.epoch > 1:
                raise KeyboardInterrupt

        settings = EpisodeFitSettings(epochs=5, batch_size=4, checkpoint_seconds=1e6)
        fit(layer, loss, np.arange(8) // 2, settings, folder=tmp_path, progress=progress)

    with pytest.raises(KeyboardInterrupt):
        attempt(stop=True)
    path = tmp_path / "fit.pt"
    intact = path.read_bytes()

    def load() -> None:
        if path.read_bytes() == intact:
            return
        with pytest.raises(FitError) as refused:
            attempt(stop=False)
        raise ValueError(str(refused.value))

    assert all("remove it to start again" in message for message in refusals(path, load))


@pytest.mark.parametrize("make", [policy, encoder, force_predictor, cloned_policy, path_follower, recurrent_policy])
def test_a_model_that_asks_for_more_than_it_holds_is_refused_before_it_is_built(make: Any, tmp_path: Path) -> None:
    path = tmp_path / "model.pt"
    model = make()
    model.save(path)
    first = make is policy
    count = require_refusals(path, lambda: type(model).load(path), forged=first)
    assert count > (30 if first else 10)


def test_a_policy_of_a_million_actions_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "policy.pt"
    policy().save(path)
    content = decoded(path.read_bytes())
    for name, space in (("action_space", content["action_space"]), ("network_space", {"tip": None})):
        del space
        for changed in ({"shape": [10**6]}, {"shape": [10**13]}, {"dtype": "O"}, {"dtype": "S1000000000"}):
            forged = {**content, name: {**content["action_space"], **changed}}
            write_model(path, forged)
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
