"""The data set of torch: items against the logs, windows, padding, transforms, workers, messages."""

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

from cathsim import NavigateEnv
from pipeline.episodes import EpisodeReader
from pipeline.episodes.export.layout import ExportError
from pipeline.recording.dataset import EpisodeDataset
from pipeline.recording.record import record_episode

STEPS = (5, 8)
FIELDS = ("tip", "goal", "distance_m", "action", "reward", "truncated", "image/frontal", "mask/frontal")


def record(folder: Path, **arguments: Any) -> Path:
    for seed, steps in enumerate(STEPS):
        env = NavigateEnv(
            "type_1", "lcca", observation="tip", accuracy="fast", image_size=24, max_steps=steps, **arguments
        )
        drawn = iter(np.random.default_rng(seed).uniform(0, 1, (steps, *env.action_space.shape)))
        record_episode(env, lambda *_, drawn=drawn: next(drawn), folder / f"{seed}.mcap", seed=seed, operator="test")
    return folder


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("logs"))


def test_items_are_those_of_the_logs(logs: Path) -> None:
    data = EpisodeDataset(logs, FIELDS, window=3)
    assert len(data) == 3 + 6
    place = 0
    for number, steps in enumerate(STEPS):
        with EpisodeReader(logs / f"{number}.mcap") as log:
            arrays, mesh = log.load_arrays(), log.phantom_mesh()
        assert mesh is not None
        for first in range(steps - 2):
            item = data[place]
            now, then = slice(first, first + 3), slice(first + 1, first + 4)
            assert (int(item["episode"]), int(item["step"])) == (number, first)
            np.testing.assert_array_equal(item["tip"], arrays["tip"][now].astype(np.float32))
            np.testing.assert_array_equal(item["distance_m"], arrays["extra/distance_m"][now].astype(np.float32))
            np.testing.assert_array_equal(item["action"], arrays["action"][then].astype(np.float32))
            np.testing.assert_array_equal(item["reward"], arrays["reward"][then].astype(np.float32))
            np.testing.assert_array_equal(item["truncated"], arrays["truncated"][then])
            np.testing.assert_allclose(item["goal"][0], mesh.target, rtol=1e-6)
            np.testing.assert_allclose(item["image/frontal"][:, 0] * 255, arrays["image/frontal"][now], atol=1e-4)
            np.testing.assert_array_equal(item["mask/frontal"][:, 0] > 0, arrays["mask/frontal"][now])
            place += 1
    assert torch.equal(data[-1]["tip"], data[len(data) - 1]["tip"])
    with pytest.raises(IndexError, match="there is no window 9: there are 9"):
        data[9]


def test_windows_beyond_the_end_are_padded(logs: Path) -> None:
    data = EpisodeDataset(logs, ("tip", "action"), window=4, stride=2, pad=True)
    assert len(data) == 3 + 4
    last = data[2]
    assert int(last["step"]) == 4
    assert last["pad"].tolist() == [False, True, True, True]
    assert torch.equal(last["action"], last["action"][:1].expand(4, -1))
    assert "pad" not in EpisodeDataset(logs, ("tip",))[0]


def test_pictures_go_through_the_transform(logs: Path) -> None:
    def halved(pictures: torch.Tensor) -> torch.Tensor:
        assert pictures.dtype == torch.uint8
        return pictures[..., ::2, ::2].float()

    data = EpisodeDataset(logs, ("image/frontal",), window=2, image_transform=halved)
    assert data[0]["image/frontal"].shape == (2, 1, 12, 12)


def test_workers_read_the_same(logs: Path) -> None:
    data = EpisodeDataset(logs, ("tip", "action", "image/frontal"), window=2)
    data[0]  # so that a log is open when the workers are forked
    alone = list(DataLoader(data, batch_size=4))
    together = list(DataLoader(data, batch_size=4, num_workers=2))
    assert len(alone) == len(together) == 3
    for one, other in zip(alone, together, strict=True):
        assert one.keys() == other.keys()
        assert all(torch.equal(one[name], other[name]) for name in one)
    again = pickle.loads(pickle.dumps(data))
    assert torch.equal(again[5]["tip"], data[5]["tip"])
    data.close()
    assert torch.equal(again[5]["tip"], data[5]["tip"])


def test_logs_are_opened_again_beyond_the_limit(logs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pipeline.recording.dataset._OPEN_LOGS", 1)
    data = EpisodeDataset(logs, ("tip",))
    order = [0, 12, 1, 11, 0]
    assert [int(data[index]["episode"]) for index in order] == [0, 1, 0, 1, 0]
    assert len(data._readers) == 1


def test_two_devices_and_chosen_episodes(tmp_path: Path) -> None:
    folder = record(tmp_path, catheter="vertebral")
    data = EpisodeDataset(folder, ("feeder", "action", "device_lead"), where=lambda info, outcome: info.seed == 1)
    assert len(data) == 8
    assert data[0]["feeder"].shape == (1, 7)
    assert data[0]["action"].shape == (1, 4)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"fields": ("tip", "colour")}, "have no colour; there are tip, feeder"),
        ({"window": 9}, "no episode has 9 steps, the longest has 8"),
        ({"window": 0}, "window must be a whole number of at least 1, got 0"),
        ({"where": lambda info, outcome: False}, "no episode in .* is taken"),
    ],
)
def test_wrong_arguments_are_refused(logs: Path, arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ExportError, match=message) as caught:
        EpisodeDataset(logs, **arguments)
    assert "\n" not in str(caught.value)
