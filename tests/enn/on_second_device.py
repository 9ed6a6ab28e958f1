"""Every network of the package is trained and read on another device than the CPU, and its file opens anywhere."""

import dataclasses
import functools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from enn.encoder import EncoderSettings, fit_encoder, scripted_samples
from enn.fitting import EpisodeFitSettings
from enn.force.prediction import DESK_FORCE, ForcePredictor, fit_force
from enn.force.samples import force_samples
from enn.imitation.behaviour_cloning import DESK_CLONING, clone
from enn.imitation.cloned_policy import ClonedPolicy
from enn.imitation.dagger import DaggerSettings, dagger, record
from enn.imitation.images.lumen_segmentation import fit_segmenter
from enn.imitation.images.perception import ImagePerception
from enn.imitation.images.policy import ImagePolicy
from enn.imitation.path_following import PathFollower, PathFollowerSettings, fit_path_follower
from enn.imitation.sequence_cloning import clone_sequences
from enn.networks.devices import device_of, on_cpu
from enn.networks.encoder_network import Encoder
from enn.policy import Policy
from enn.reinforcement.training.settings import DESK_PPO, THESIS_SAC, TrainingSettings
from enn.reinforcement.training.training import Training
from enn.trajectory import Trajectory
from tests.enn.imitation.drawn_point import DrawnPoint, expert
from tests.enn.imitation.straight_wire import CLONING, WireEnv, advised, policy_on, vessels
from tests.enn.reinforcement.small_training import SMALL, interrupted
from tests.enn.rod import Rod
from tests.second_device import second_device, tolerance


@pytest.fixture(autouse=True)
def float32_on_both(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cpu, "get_capabilities", dict)  # as if the processor had no bfloat16


def test_a_second_device_is_as_strict_as_a_gpu() -> None:
    with second_device() as device:
        network = torch.nn.Linear(3, 2).to(device)
        assert device_of(network) == torch.device(device)
        output = network(torch.ones(1, 3).to(device))
        with pytest.raises(RuntimeError, match="same device"):
            network(torch.ones(1, 3))
        with pytest.raises(TypeError, match="numpy"):
            output.detach().numpy()
        output.sum().backward()
        assert torch.device(device) == network.weight.grad.device
        kept = on_cpu({"weights": network.state_dict(), "rest": [1, (output,)]})
        assert kept["rest"][1][0].device.type == kept["weights"]["weight"].device.type == "cpu"


def _small(preset: TrainingSettings, **changed: Any) -> TrainingSettings:
    return dataclasses.replace(
        preset, decisions=40, learning_starts=32, evaluate_every=40, evaluation_episodes=1, curve_every=40,
        batch_size=8, hidden=(8, 8), **changed,
    )  # fmt: skip


IMAGES = {"extractor": "multimodal", "variant": "desk"}
TRAININGS = {
    "sac": _small(SMALL),
    "sac of images": _small(
        THESIS_SAC, keys=("image", "place"), n_envs=8, gradient_steps=0.25, buffer_size=400, **IMAGES
    ),
    "ppo": _small(DESK_PPO, n_steps=16, action_repeat=1, epochs=1),
}


@pytest.mark.parametrize("name", TRAININGS)
def test_reinforcement_learning(name: str, point_env: Any, tmp_path: Path) -> None:
    keys = ("image", "place") if "images" in name else ("place",)
    with second_device() as device:
        for place, folder in (("cpu", tmp_path / "here"), (device, tmp_path / "there")):
            settings = dataclasses.replace(TRAININGS[name], device=place, checkpoint_seconds=0.0)
            Training(settings, lambda: point_env(keys, max_steps=8), folder, seed=3).run()
    loaded = Policy.load(tmp_path / "there" / "policy.pt")  # outside: a file with tensors from there would not open
    seen = {"place": np.zeros((2, 2), np.float32), "image": np.zeros((2, 1, 36, 36), np.uint8)}
    seen = {key: seen[key] for key in keys}
    here = Policy.load(tmp_path / "here" / "policy.pt").act_batch(seen)
    np.testing.assert_allclose(loaded.act_batch(seen), here, atol=tolerance(1e-4, gpu=0.05))


def test_an_interrupted_training_goes_on_on_another_device(point_env: Any, tmp_path: Path) -> None:
    settings = dataclasses.replace(TRAININGS["sac"], checkpoint_seconds=0.0, evaluate_every=0)
    with second_device() as device:
        interrupted(Training(dataclasses.replace(settings, device=device), point_env, tmp_path / "away", seed=1), 36)
    result = Training(settings, point_env, tmp_path / "away", seed=1).run()
    whole = Training(settings, point_env, tmp_path / "whole", seed=1).run()
    seen = {"place": np.linspace(-1, 1, 8, dtype=np.float32).reshape(4, 2)}
    acted, expected = (one.policy.act_batch(seen) for one in (result, whole))
    np.testing.assert_allclose(acted, expected, atol=tolerance(1e-4, gpu=0.05))


@functools.cache
def _episodes(count: int = 3) -> tuple[Trajectory, ...]:
    return tuple(record(DrawnPoint(), expert, seed=seed, keys=("image", "place")) for seed in range(count))


def test_cloning_and_dagger(tmp_path: Path) -> None:
    fit = EpisodeFitSettings(epochs=1, batch_size=32, validation_share=0.4)
    settings = dataclasses.replace(DESK_CLONING, fit=fit, shift_px=2)
    episodes, outcomes = _episodes(), {}
    features = [episode.observations["place"] for episode in episodes]
    images = {"image": episodes[0].observations["image"][:3]}
    with second_device() as device:
        for place in ("cpu", device):
            student, _ = clone(episodes, settings, expert_features=features, seed=1, device=place)
            assert device_of(student.network) == torch.device(place)
            outcomes[place] = student.act_batch(images, False, np.random.default_rng(0)), student.features(images)
        student.save(tmp_path / "student.pt")
        read = ClonedPolicy.load(tmp_path / "student.pt", device)
        assert device_of(read.network) == torch.device(device)
        taught, _, _ = dagger(DrawnPoint, expert, episodes, DaggerSettings(1, 1), settings, student=read, device=device)
        assert device_of(taught.network) == torch.device(device)
    for here, there in zip(*outcomes.values(), strict=True):
        np.testing.assert_allclose(here, there, atol=1e-5)
    acted = ClonedPolicy.load(tmp_path / "student.pt").act_batch(images, False, np.random.default_rng(0))
    np.testing.assert_allclose(acted, outcomes["cpu"][0], atol=1e-5)


def test_force(tmp_path: Path) -> None:
    episodes = list(_episodes())
    features = [episode.observations["place"] for episode in episodes]
    samples = force_samples(episodes, features=features)
    settings = dataclasses.replace(DESK_FORCE, fit=EpisodeFitSettings(epochs=1, batch_size=32, validation_share=0.0))
    outcomes = {}
    with second_device() as device:
        for place in ("cpu", device):
            predictor, _ = fit_force(samples, settings, seed=2, device=place)
            assert device_of(predictor.network) == torch.device(place)
            outcomes[place] = predictor.predict(samples.images)
        predictor.save(tmp_path / "force.pt")
        again = ForcePredictor.load(tmp_path / "force.pt", device).predict(samples.images)
    for other in (outcomes[device], again, ForcePredictor.load(tmp_path / "force.pt").predict(samples.images)):
        np.testing.assert_allclose(outcomes["cpu"], other, atol=1e-5)


def test_path_follower(tmp_path: Path) -> None:
    settings = PathFollowerSettings(fit=EpisodeFitSettings(epochs=1, batch_size=32), hidden=(16,))
    episodes = list(_episodes())
    paths = [np.array([[0.0, 0, 0], [10, 5, 0], [20, 0, 0]])] * len(episodes)
    seen, outcomes = np.ones((3, settings.size), np.float32), {}
    with second_device() as device:
        for place in ("cpu", device):
            follower, _ = fit_path_follower(episodes, paths, settings, device=place)
            assert device_of(follower.network) == torch.device(place)
            outcomes[place] = follower.act(seen)
        follower.save(tmp_path / "follower.pt")
        again = PathFollower.load(tmp_path / "follower.pt", device).act(seen)
    for other in (outcomes[device], again, PathFollower.load(tmp_path / "follower.pt").act(seen)):
        np.testing.assert_allclose(outcomes["cpu"], other, atol=1e-5)


def test_encoder_and_what_learns_through_it(tmp_path: Path) -> None:
    samples = scripted_samples(Rod, 150, seed=0)
    settings = EncoderSettings(epochs=1, hidden=16, features=8)
    training = dataclasses.replace(TRAININGS["sac"], evaluate_every=0)
    outcomes, seen = {}, {}
    with second_device() as device:
        for place in ("cpu", device):
            encoder, report = fit_encoder(samples, ("image", "joints"), settings, device=place)
            assert device_of(encoder) == torch.device(place)
            outcomes[place] = report["tip_mm"]
            encoder.save(tmp_path / "encoder.pt")
            trained = dataclasses.replace(training, device=place, start_state_buffer_share=0.0)
            read = Encoder.load(tmp_path / "encoder.pt")  # the training brings it to its own device
            policy = Training(trained, Rod, tmp_path / place[:3], seed=0, encoder=read).run().policy
            seen[place] = policy.act_batch({key: samples.observations[key][:2] for key in policy.keys})
    assert outcomes["cpu"] == pytest.approx(outcomes[device], rel=1e-4)
    np.testing.assert_allclose(seen["cpu"], seen[device], atol=1e-3)
    loaded = Policy.load(tmp_path / device[:3] / "policy.pt")
    acted = loaded.act_batch({key: samples.observations[key][:2] for key in loaded.keys})
    np.testing.assert_allclose(acted, seen[device], atol=1e-4)


def test_segmenter_and_image_policy(tmp_path: Path) -> None:
    images, lumens = vessels(4, 0)
    results = {}
    with second_device() as device:
        for place in ("cpu", device):
            segmenter, _ = fit_segmenter(images, lumens, epochs=1, working_size=images.shape[-1], device=place)
            assert device_of(segmenter) == torch.device(place)
            perception = ImagePerception(segmenter, device=place)
            policy = policy_on(perception, place)
            episodes = advised(policy, perception, 0.5, 1, 3)
            loss = clone_sequences(policy, episodes, dataclasses.replace(CLONING, epochs=1))[-1]
            policy.save(tmp_path / f"{place[:3]}.pt")
            results[place] = loss, policy.act(episodes[0].features[:1])[0]
        env = WireEnv()
        observation, _ = env.reset(seed=0)
        policy, perception = ImagePolicy.load(tmp_path / "cpu.pt", device)
        perception.controller(policy)(observation)
    assert results["cpu"][0] == pytest.approx(results[device][0], rel=1e-3)
    np.testing.assert_allclose(results["cpu"][1], results[device][1], atol=1e-4)
    ImagePolicy.load(tmp_path / f"{device[:3]}.pt")
