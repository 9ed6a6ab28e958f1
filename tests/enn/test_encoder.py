"""The encoder of the simulation's state, and the samples that it is fitted to."""

from pathlib import Path

import numpy as np
import pytest
import torch

from enn.encoder import Encoder, EncoderSettings, Samples, encoder_report, fit_encoder, scripted_samples
from enn.exploration import ARC_LENGTHS_MM, Frontier, Moves, PairMoves, moves_of
from tests.enn.rod import QUICK, Rod, SleevedRod, fitted


def tensors(samples: Samples, rows: int = 6) -> dict[str, torch.Tensor]:
    return {key: torch.from_numpy(values[:rows]) for key, values in samples.observations.items()}


@pytest.mark.parametrize(("keys", "limit_mm"), [(("image",), 2.5), (("image", "mask"), 2.5), (("joints",), 2.0)])
def test_the_tip_is_read_off_every_modality(keys: tuple[str, ...], limit_mm: float) -> None:
    encoder, report = fitted(*keys)
    fresh = scripted_samples(Rod, 400, seed=7)
    spread = np.linalg.norm(fresh.points_mm[:, 0] - fresh.points_mm[:, 0].mean(0), axis=1).mean()
    assert spread > 8  # so that a blind guess would be far off
    assert encoder_report(encoder, fresh)["tip_mm"] < limit_mm
    assert report["tip_frontal_mm"] <= report["tip_mm"] < limit_mm
    assert report["samples"] == 1000


def test_features_are_normalised_frozen_and_read_nothing_else(samples: Samples) -> None:
    encoder, _ = fitted("image", "mask")
    features = encoder(tensors(samples, 1000))
    assert features.shape == (1000, 12)
    assert features.mean(0).abs().max() < 0.2
    assert (features.std(0) - 1).abs().max() < 0.2
    assert not features.requires_grad
    assert not encoder.training
    seen = tensors(samples)
    assert torch.equal(encoder(seen), encoder({key: seen[key] for key in ("image", "mask")}))
    assert not torch.equal(encoder(seen), encoder(seen | {"mask": seen["mask"] * 0}))


def test_a_turn_of_the_feeder_changes_no_feature(samples: Samples) -> None:
    encoder, _ = fitted("joints")
    turned = tensors(samples)
    turned["joints"] = turned["joints"].clone()
    turned["joints"][:, 1] += 2 * np.pi * 50
    assert torch.allclose(encoder(turned), encoder(tensors(samples)), atol=1e-3)


def test_bad_samples_are_refused(samples: Samples) -> None:
    with pytest.raises(ValueError, match="wants 'internal', but the samples have image, joints, mask"):
        fit_encoder(samples, ("internal",), QUICK)
    broken = samples.take(np.arange(200))  # a copy
    broken.observations["joints"][3, 0] = np.nan
    with pytest.raises(ValueError, match="'joints' of the samples has numbers that are not finite"):
        fit_encoder(broken, ("joints",), QUICK)
    with pytest.raises(ValueError, match="at least two roll-outs, got 1"):
        fit_encoder(samples.take(samples.episode == 0), ("mask",), QUICK)
    with pytest.raises(ValueError, match="needs the keys and shapes"):
        Encoder(EncoderSettings())


def test_an_encoder_of_two_devices_reads_both_feeders(tmp_path: Path) -> None:
    drawn = scripted_samples(SleevedRod, 400, seed=0, seen=("feeder",))
    encoder, report = fit_encoder(drawn, ("joints", "feeder"), QUICK)
    assert encoder.head.out_features == 3 * len(ARC_LENGTHS_MM) + 3 + 7 + 3
    assert np.isfinite(report["tip_mm"])
    encoder.save(tmp_path / "encoder.pt")
    again = Encoder.load(tmp_path / "encoder.pt")
    seen = {key: torch.from_numpy(drawn.observations[key][:6]) for key in again.keys}
    assert torch.equal(again(seen), encoder(seen))
    assert again.wire_points_mm(seen).shape == (6, len(ARC_LENGTHS_MM), 3)


def test_samples_hold_observations_and_the_truth(samples: Samples) -> None:
    assert len(samples) == 1000
    assert set(samples.observations) == {"image", "mask", "joints"}
    assert samples.observations["image"].dtype == np.uint8
    reach = np.linalg.norm(samples.points_mm[:, 0], axis=1)
    assert np.allclose(reach, 10 + samples.feeder[:, 0], atol=1e-3)  # mm: the rod's tip
    assert np.allclose(samples.points_mm[:, 1], samples.points_mm[:, 0] - 4 * samples.direction, atol=1e-3)
    assert np.allclose(np.linalg.norm(samples.direction, axis=1), 1, atol=1e-5)
    assert len(np.unique(samples.episode)) > 20


def test_the_frontier_prefers_rare_places() -> None:
    frontier = Frontier(np.random.default_rng(0))
    assert frontier.draw() is None
    for _ in range(500):
        frontier.add(np.zeros(1), np.zeros(3))
    frontier.add(np.ones(1), np.array((0.05, 0, 0)))
    assert len(frontier) == 2
    assert np.mean([frontier.draw()[0] for _ in range(200)]) > 0.9  # type: ignore[index]


def test_two_devices_move_alone_apart_and_together() -> None:
    moves = moves_of(4, np.random.default_rng(0))
    assert isinstance(moves, PairMoves)
    moves.start()
    drawn = np.array([moves.action() for _ in range(2000)])
    assert drawn.dtype == np.float32
    assert np.abs(drawn).max() <= 1.0
    wire, catheter = (np.abs(drawn[:, part]).sum(axis=1) > 0 for part in (slice(2), slice(2, 4)))
    together = (drawn[:, 0] == drawn[:, 2]) & wire & catheter
    for kind in (wire & ~catheter, catheter & ~wire, together, wire & catheter & ~together):
        assert 0.05 < kind.mean() < 0.6
    assert isinstance(moves_of(2, np.random.default_rng(0)), Moves)
    assert isinstance(moves_of(21, np.random.default_rng(0)), Moves)
