"""Reads an exported data set with LeRobot itself and compares it with what the logs hold; run where LeRobot is.

    python lerobot_reading.py DATASET EXPECTED.npz

EXPECTED holds, for each column, the values of all steps, and for each camera the pictures.
"""

import json
import sys
from pathlib import Path

import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.datasets.utils import dataset_to_policy_features
from torch.utils.data import DataLoader


def main(folder: Path, expected_path: Path) -> None:
    expected = dict(np.load(expected_path))
    images = sorted(name for name in expected if name.startswith("observation.images."))
    dataset = LeRobotDataset("local/test", root=folder, video_backend="pyav")
    steps = len(expected["action"])
    assert len(dataset) == dataset.num_frames == steps
    assert dataset.num_episodes == expected["episode_index"].max() + 1
    assert sorted(dataset.meta.video_keys) == images
    worst = 0.0
    for index in range(steps):
        item = dataset[index]
        for name, values in expected.items():
            if name == "task":
                assert item["task"] == str(values[index])
            elif name in images:
                seen = item[name].numpy() * 255.0
                assert seen.shape == (3, *values[index].shape)
                worst = max(worst, float(np.abs(seen - values[index]).max()))
            else:
                found = item[name].numpy()
                assert found.shape == np.shape(values[index]), (name, found.shape, np.shape(values[index]))
                np.testing.assert_allclose(found, values[index], rtol=1e-6, atol=1e-9, err_msg=name)
    for name, found in dataset.meta.stats.items():
        if name in expected and name not in images:
            np.testing.assert_allclose(found["mean"], np.atleast_1d(expected[name].mean(axis=0)), rtol=1e-4, atol=1e-6)
            np.testing.assert_allclose(found["std"], np.atleast_1d(expected[name].std(axis=0)), rtol=1e-3, atol=1e-6)
    for name in images:
        assert np.shape(dataset.meta.stats[name]["mean"]) == (3, 1, 1)
        np.testing.assert_allclose(dataset.meta.stats[name]["mean"], expected[name].mean() / 255.0, rtol=1e-5)
    policy = dataset_to_policy_features(dataset.features)
    assert set(policy) == {"action", "observation.state", "observation.environment_state", *images}
    window = LeRobotDataset(
        "local/test",
        root=folder,
        video_backend="pyav",
        delta_timestamps={"action": [i / dataset.fps for i in range(4)]},
    )
    batch = next(iter(DataLoader(window, batch_size=3, shuffle=False)))
    np.testing.assert_allclose(batch["action"][0].numpy(), expected["action"][:4], rtol=1e-6)
    last = int((expected["episode_index"] == 0).sum()) - 1
    assert window[last]["action_is_pad"].tolist() == [False, True, True, True]
    one = LeRobotDataset("local/test", root=folder, episodes=[1], video_backend="pyav")
    assert len(one) == int((expected["episode_index"] == 1).sum())
    assert float(one[0]["timestamp"]) == 0.0
    print(json.dumps({"steps": steps, "fps": dataset.fps, "worst_grey": worst, "batch": list(batch)}))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
