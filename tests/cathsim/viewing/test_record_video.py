"""Gymnasium's `RecordVideo` writes films of the environments."""

from __future__ import annotations

from pathlib import Path

import gymnasium
import imageio.v3 as imageio

import cathsim  # noqa: F401


def test_record_video_writes_an_episode(tmp_path: Path) -> None:
    base = gymnasium.make("cathsim/Navigate-v0", phantom="type_1", render_mode="fluoroscopy", max_steps=10)
    env = gymnasium.wrappers.RecordVideo(base, str(tmp_path), name_prefix="wire")
    env.reset(seed=0)
    ended, steps = False, 0
    while not ended:
        _, _, terminated, truncated, _ = env.step([1.0, 0.0])
        ended, steps = terminated or truncated, steps + 1
    env.close()
    frames = imageio.imread(tmp_path / "wire-episode-0.mp4")
    assert len(frames) in (steps, steps + 1)
    assert frames[0].std() > 1
