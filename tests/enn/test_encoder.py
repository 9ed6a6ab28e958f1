"""Encoder: what it reads off scripted samples, freezing, the file, and refusals."""

from __future__ import annotations

import dataclasses
import io
import json
from pathlib import Path

import numpy as np
import pytest
import torch

from enn.encoder import (
    Encoder,
    EncoderSettings,
    Samples,
    encoder_report,
    fit_encoder,
    scripted_samples,
)
from enn.exploration import ARC_LENGTHS_MM
from tests.enn.rod import QUICK, Rod, SleevedRod, fitted


def tensors(samples: Samples, rows: int = 6) -> dict[str, torch.Tensor]:
    return {key: torch.from_numpy(values[:rows]) for key, values in samples.observations.items()}


@pytest.mark.parametrize(
    ("keys", "limit_mm"), [(("image",), 2.5), (("mask",), 2.5), (("image", "mask"), 2.5), (("joints",), 2.0)]
)
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


def test_the_same_seed_gives_the_same_encoder_whatever_was_drawn_before(samples: Samples) -> None:
    settings = dataclasses.replace(QUICK, epochs=1)
    first, _ = fit_encoder(samples, ("image",), settings)
    torch.rand(5)
    second, _ = fit_encoder(samples, ("image",), settings)
    other, _ = fit_encoder(samples, ("image",), dataclasses.replace(settings, seed=1))
    pairs = zip(first.state_dict().values(), second.state_dict().values(), strict=True)
    assert all(torch.equal(a, b) for a, b in pairs)
    assert not torch.equal(first(tensors(samples)), other(tensors(samples)))


def test_settings_and_weights_make_the_same_encoder(samples: Samples) -> None:
    encoder, _ = fitted("image", "mask")
    file = io.BytesIO()
    torch.save(encoder.state_dict(), file)
    settings = json.loads(json.dumps(dataclasses.asdict(encoder.settings)))
    loaded = Encoder(EncoderSettings(**settings)).eval()
    loaded.load_state_dict(torch.load(io.BytesIO(file.getvalue()), weights_only=True))
    assert loaded.keys == encoder.keys
    assert torch.equal(loaded(tensors(samples)), encoder(tensors(samples)))


def test_progress_counts_up_to_the_end(samples: Samples) -> None:
    seen: list[float] = []
    fit_encoder(samples, ("joints",), dataclasses.replace(QUICK, epochs=3), lambda share, _: seen.append(share))
    assert seen == pytest.approx([1 / 3, 2 / 3, 1])
    drawn: list[int] = []
    scripted_samples(Rod, 50, 0, progress=lambda done, total: drawn.append(done))
    assert drawn[-1] == 50


def test_vectors_are_looked_at_more_often_than_pictures(samples: Samples) -> None:
    some = samples.take(np.arange(120))
    quick = dataclasses.replace(QUICK, epochs=0)
    assert [fit_encoder(some, (key,), quick)[1]["epochs"] for key in ("mask", "joints")] == [10, 30]


@pytest.mark.parametrize("channels", [(), (4, 8)])
def test_convolutions_are_a_choice(samples: Samples, channels: tuple[int, ...]) -> None:
    settings = dataclasses.replace(QUICK, channels=channels, epochs=1)
    encoder, _ = fit_encoder(samples, ("image", "mask"), settings)
    convolutions = [module for module in encoder.modules() if isinstance(module, torch.nn.Conv2d)]
    assert [layer.out_channels for layer in convolutions] == list(channels)
    assert encoder(tensors(samples)).shape == (6, 12)


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
    with pytest.raises(ValueError, match="held_out must be less than 1, got 1"):
        EncoderSettings(held_out=1)


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
