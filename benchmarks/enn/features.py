"""Benchmark of features: cost of the thesis's networks against the desk variant's, and of the encoder with its errors.

    python benchmarks/enn/features.py [--quick] [--phantom type_1] [--samples N]

Prints tables and, as its last line, one JSON object; times are CPU milliseconds of one thread:
    parameters              of the extractor, by variant and modality set
    forward_8_ms            features for 8 environments
    update_ms               one SAC update of stable-baselines3, batch as the variant's (thesis 256, desk 128)
    encoded_update_ms       the same on the encoder's 64 features, batch 128
    samples_ms              one scripted sample, simulator and pictures included
    encoder                 by modality set: cpu_s of the fit, forward_8_ms, tip_frontal_mm (in the plane of the image),
                            tip_mm and points_mm (in space) on roll-outs of another seed
"""

from __future__ import annotations

import argparse
import functools
import json
import os
import statistics
import time
from collections.abc import Callable
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import gymnasium
import numpy as np
import torch
from stable_baselines3 import SAC

from benchmarks.enn.blank_environment import Blank
from enn.encoder import EncoderSettings, encoder_report, fit_encoder, scripted_samples
from enn.networks.features import MultimodalExtractor, modality_keys

SETS = ("I", "V", "V+M", "I+V+M")
BATCH = {"thesis": 256, "desk": 128}
HIDDEN = {"thesis": [256, 256], "desk": [128, 128]}
PICTURE = gymnasium.spaces.Box(0, 255, (1, 80, 80), np.uint8)
SPACE = gymnasium.spaces.Dict(
    {
        "joints": gymnasium.spaces.Box(-np.inf, np.inf, (336,), np.float32),
        "image": PICTURE,
        "mask": PICTURE,
        "features": gymnasium.spaces.Box(-np.inf, np.inf, (64,), np.float32),
    }
)


def navigate(phantom: str) -> gymnasium.Env[Any, Any]:
    """The environment that samples are drawn from: it ends nowhere, and starts with any rotation."""
    return gymnasium.make(
        "cathsim:cathsim/Navigate-v0",
        phantom=phantom,
        target="bca",
        observation=("joints", "image", "mask", "shape", "feeder", "force"),
        success_radius=1e-6,
        max_steps=100_000,
        start_jitter=0.01,
        start_rotation=np.pi,
        accuracy="fast",
        disable_env_checker=True,
    )


def cpu_ms(work: Callable[[], Any], repeats: int) -> float:
    """Median CPU time of a call, ms."""
    work()
    times = []
    for _ in range(repeats):
        start = time.process_time()
        work()
        times.append(1e3 * (time.process_time() - start))
    return statistics.median(times)


def update_ms(keys: tuple[str, ...], variant: str | None, repeats: int) -> float:
    """One SAC update; without a variant the observations are features already."""
    arguments: dict[str, Any] = {"net_arch": HIDDEN[variant or "desk"]}
    if variant is not None:
        arguments["features_extractor_class"] = MultimodalExtractor
        arguments["features_extractor_kwargs"] = {"keys": keys, "variant": variant}
    batch = BATCH[variant or "desk"]
    sizes: dict[str, Any] = {"buffer_size": 300, "batch_size": batch, "learning_starts": 280}
    blank = Blank(gymnasium.spaces.Dict({key: SPACE[key] for key in keys}), actions=2)
    model = SAC("MultiInputPolicy", blank, policy_kwargs=arguments, seed=0, device="cpu", **sizes)
    model.learn(280)
    return cpu_ms(lambda: model.train(1, batch), repeats)


def networks(quick: bool) -> dict[str, Any]:
    """Costs of the extractors trained end to end."""
    results: dict[str, Any] = {"parameters": {}, "forward_8_ms": {}, "update_ms": {}}
    print(f"{'variant':8s} {'set':7s} {'parameters':>11s} {'forward 8, ms':>14s} {'SAC update, ms':>15s}")
    for variant in ("thesis", "desk"):
        for modalities in ("I", "I+V+M") if quick else SETS:
            keys = modality_keys(modalities)
            extractor = MultimodalExtractor(SPACE, keys, variant)
            seen = {key: torch.rand(8, *SPACE[key].shape) for key in keys}  # type: ignore[misc]
            count = sum(parameter.numel() for parameter in extractor.parameters())
            with torch.inference_mode():
                forward = cpu_ms(functools.partial(extractor, seen), 15 if quick else 50)
            update = update_ms(keys, variant, 2 if quick else 8)
            name = f"{variant} {modalities}"
            results["parameters"][name] = count
            results["forward_8_ms"][name], results["update_ms"][name] = round(forward, 3), round(update, 1)
            print(f"{variant:8s} {modalities:7s} {count:11,d} {forward:14.2f} {update:15.1f}", flush=True)
    results["encoded_update_ms"] = round(update_ms(("features",), None, 5 if quick else 20), 2)
    print(f"{'encoder':8s} {'any':7s} {'':11s} {'':14s} {results['encoded_update_ms']:15.1f}\n")
    return results


def encoders(quick: bool, phantom: str, count: int) -> dict[str, Any]:
    """Costs and errors of the frozen encoder."""
    make = functools.partial(navigate, phantom)
    start = time.process_time()
    samples = scripted_samples(make, count, seed=0)
    sample_ms = 1e3 * (time.process_time() - start) / count
    fresh = scripted_samples(make, max(count // 5, 500), seed=1_000_000)
    print(f"{count:,} scripted samples of {phantom}, {sample_ms:.2f} ms each")
    print(f"{'set':7s} {'fit, s':>8s} {'forward 8, ms':>14s} {'tip, image plane':>17s} {'tip':>6s} {'points, mm':>11s}")
    rows: dict[str, Any] = {}
    for modalities in ("I", "V+M") if quick else ("I", "V", "M", "V+M", "I+V+M"):
        settings = EncoderSettings(epochs=3) if quick else None
        encoder, report = fit_encoder(samples, modality_keys(modalities), settings)
        errors = encoder_report(encoder, fresh)
        eight = {key: torch.from_numpy(fresh.observations[key][:8]) for key in encoder.keys}
        with torch.inference_mode():
            forward = cpu_ms(functools.partial(encoder, eight), 50)
        names = ("tip_frontal_mm", "tip_mm", "points_mm")
        rows[modalities] = {"cpu_s": round(report["cpu_s"], 1), "forward_8_ms": round(forward, 3)}
        rows[modalities] |= {name: round(errors[name], 3) for name in names}
        plane, tip, points = (errors[name] for name in names)
        print(
            f"{modalities:7s} {report['cpu_s']:8.1f} {forward:14.2f} {plane:17.2f} {tip:6.2f} {points:11.2f}",
            flush=True,
        )
    return {"samples": count, "samples_ms": round(sample_ms, 3), "encoder": rows}


def main() -> None:
    """Runs both parts."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])  # type: ignore[union-attr]
    parser.add_argument("--quick", action="store_true", help="fewer samples, sets and repeats")
    parser.add_argument("--phantom", default="type_1")
    parser.add_argument("--samples", type=int, default=0, help="of the encoder; by default 30,000, quick 4,000")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    results = networks(arguments.quick)
    count = arguments.samples or (4_000 if arguments.quick else 30_000)
    results |= encoders(arguments.quick, arguments.phantom, count)
    print(json.dumps({"phantom": arguments.phantom, "quick": arguments.quick, **results}))


if __name__ == "__main__":
    main()
