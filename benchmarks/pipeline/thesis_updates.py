"""CPU time of what the thesis's trainings consist of: updates of SAC and PPO, and images through the networks and back.

    python benchmarks/pipeline/thesis_updates.py [--quick] [--repeats N]

Networks, batches and image sizes of `budget=thesis`, observations and images random, one thread. The estimate of
`python -m pipeline.chain --estimate` is made from these (`jobs` in `conf/budget/thesis.yaml`). Prints tables and, in
its last line, a JSON object: by row update_ms (median of the repeats) and the seconds per decision that it comes to; by
network the seconds of an image (shape networks: of a clip of three), forward, backward, without augmentation.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import time
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import gymnasium
import numpy as np
import torch
from stable_baselines3 import PPO, SAC

from benchmarks.enn.blank_environment import Blank
from enn.networks.features import MultimodalExtractor, modality_keys
from enn.reinforcement.training.settings import THESIS_PPO, THESIS_SAC
from guide3d.learning.build import SEGMENTER_SIZES, SEGMENTERS, SHAPE_SIZES, build_segmenter, build_shape_network
from guide3d.learning.recipes import segmentation_recipe
from splineformer.build import build, size_of

NETWORKS = ("unet", "transunet", "swinunet", "shape", "published", "ordered")
PPO_EPOCHS = 10  # of stable-baselines3
# row: keys of the observation, side of the images, algorithm
ROWS: dict[str, tuple[tuple[str, ...], int, str]] = {
    **{f"enn {name}": (modality_keys(name), 80, "sac") for name in ("I", "V", "V+M", "I+V", "I+V+M")},
    **{
        f"baselines {algorithm}_{key}": ((key,), 128, algorithm)
        for algorithm in ("sac", "ppo")
        for key in ("internal", "image", "sequential")
    },
}
NUMBERS = {"joints": 336, "internal": 2352}
CHANNELS = {"image": 1, "mask": 1, "sequential": 3}
ACTIONS = {"enn": 2, "baselines": 21}


def spaces_of(keys: tuple[str, ...], image_px: int) -> gymnasium.spaces.Dict:
    """Observations of these names as the thesis has them."""
    return gymnasium.spaces.Dict(
        {
            key: gymnasium.spaces.Box(-np.inf, np.inf, (NUMBERS[key],), np.float32)
            if key in NUMBERS
            else gymnasium.spaces.Box(0, 255, (CHANNELS[key], image_px, image_px), np.uint8)
            for key in keys
        }
    )


def update_ms(row: str, repeats: int) -> tuple[float, float]:
    """Median CPU time of an update, ms, and how many updates a decision needs."""
    keys, image_px, algorithm = ROWS[row]
    environment = Blank(spaces_of(keys, image_px), ACTIONS[row.partition(" ")[0]])
    preset = THESIS_SAC if algorithm == "sac" else THESIS_PPO
    arguments: dict[str, Any] = {
        "net_arch": list(preset.hidden),
        "features_extractor_class": MultimodalExtractor,
        "features_extractor_kwargs": {"keys": keys, "variant": "thesis"},
    }
    batch = preset.batch_size
    if algorithm == "sac":
        sac = SAC("MultiInputPolicy", environment, policy_kwargs=arguments, seed=0, device="cpu", buffer_size=300,
                  batch_size=batch, learning_starts=280)  # fmt: skip
        sac.learn(280)
        return measured(lambda: sac.train(1, batch), repeats), 1.0
    ppo = PPO("MultiInputPolicy", environment, policy_kwargs=arguments, seed=0, device="cpu", n_steps=batch,
              batch_size=batch, n_epochs=1)  # fmt: skip
    ppo.learn(batch)  # fills the roll-out with one batch
    return measured(ppo.train, repeats), PPO_EPOCHS / batch


def network_s(name: str, repeats: int) -> float:
    """Median CPU time of an image through a network and back, s."""
    network, inputs = built(name)
    network.train()

    def both_ways() -> None:
        network.zero_grad()
        torch.stack([found.float().square().mean() for found in tensors(network(*inputs))]).sum().backward()

    return measured(both_ways, repeats) / 1e3


def built(name: str) -> tuple[torch.nn.Module, tuple[torch.Tensor, ...]]:
    """A network at the thesis's size, and random inputs for one image."""
    if name in ("published", "ordered"):
        settings = size_of(name, "thesis")
        image = 255 * torch.rand(1, 1, settings.image_px, settings.image_px)
        return build(settings), (image, torch.rand(1, settings.limit - 1, 3)) if name == "published" else (image,)
    if name in SEGMENTERS:
        side = segmentation_recipe(name, "thesis").crop_px
        return build_segmenter(name, side, **SEGMENTER_SIZES[name]["thesis"]), (torch.rand(1, 1, side, side),)
    size = SHAPE_SIZES["thesis"]
    return build_shape_network(size, None, 60), (255 * torch.rand(1, size.frames, size.image_px, size.image_px),)


def tensors(found: Any) -> list[torch.Tensor]:
    """The tensors that a network's output holds and that gradients pass."""
    if isinstance(found, torch.Tensor):
        return [found] if found.requires_grad else []
    parts = vars(found).values() if hasattr(found, "__dict__") else found if isinstance(found, tuple | list) else ()
    return [tensor for part in parts for tensor in tensors(part)]


def measured(work: Any, repeats: int) -> float:
    """Median CPU time of a call after the first, ms."""
    work()
    times = []
    for _ in range(repeats):
        start = time.process_time()
        work()
        times.append(1e3 * (time.process_time() - start))
    return statistics.median(times)


def main() -> None:
    """Measures every row."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--quick", action="store_true", help="two rows, one repeat")
    parser.add_argument("--repeats", type=int, default=3)
    asked = parser.parse_args()
    torch.set_num_threads(1)
    rows = ("enn I", "enn V") if asked.quick else tuple(ROWS)
    results = {}
    print(f"{'row':26s} {'update, ms':>10s} {'s a decision':>13s}")
    for row in rows:
        update, updates = update_ms(row, 1 if asked.quick else asked.repeats)
        results[row] = {"update_ms": round(update, 1), "s_a_decision": round(update * updates / 1e3, 5)}
        print(f"{row:26s} {update:10.1f} {results[row]['s_a_decision']:13.5f}", flush=True)
    print(f"\n{'network':26s} {'s an image':>10s}")
    for network in ("shape",) if asked.quick else NETWORKS:
        seconds = network_s(network, 1 if asked.quick else asked.repeats)
        results[network] = {"s_an_image": round(seconds, 3)}
        print(f"{network:26s} {seconds:10.3f}", flush=True)
    print(json.dumps(results))


if __name__ == "__main__":
    main()
