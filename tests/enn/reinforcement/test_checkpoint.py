"""Checkpoints: a resumed training is the same, bit for bit; a kill spoils nothing; what does not fit is refused."""

import dataclasses
import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from enn.reinforcement.checkpoint import CheckpointError, CheckpointFolder
from enn.reinforcement.training.result import Progress
from enn.reinforcement.training.settings import DESK_PPO, DESK_SAC, TrainingSettings
from enn.reinforcement.training.training import Training
from tests.enn.conftest import PointEnv
from tests.enn.reinforcement.small_training import Interruption, interrupted, require_same_weights

SMALL: dict[str, Any] = {
    "decisions": 320, "n_envs": 4, "hidden": (16, 16), "batch_size": 32, "learning_starts": 100,
    "evaluate_every": 100, "evaluation_episodes": 3, "curve_every": 50,
}  # fmt: skip
SAC = dataclasses.replace(DESK_SAC, gradient_steps=0.25, buffer_size=1000, **SMALL)
PPO = dataclasses.replace(DESK_PPO, n_steps=32, epochs=2, **SMALL)
OVERLAPPING = dataclasses.replace(SAC, overlap=True, threads=2)


@pytest.mark.parametrize("settings", [SAC, OVERLAPPING, PPO], ids=["sac", "sac_overlap", "ppo"])
def test_interrupted_and_resumed_is_the_same_as_straight(
    settings: TrainingSettings, point_env: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    straight = Training(settings, point_env, None, seed=3).run()
    for stop in (60, 200):
        interrupted(Training(settings, point_env, tmp_path, seed=3), stop)
        assert (tmp_path / "checkpoint" / "index.json").is_file()
        np.random.seed(0)  # noqa: NPY002 - what others draw in between must not matter
        torch.manual_seed(0)
    # what goes on with overlap does so in a process of the environments' own
    monkeypatch.setattr("enn.reinforcement.training.inputs.WORTH_A_PROCESS", 0)
    resumed = Training(settings, point_env, tmp_path, seed=3).run()
    clocks = {"wall_s": 0.0, "cpu_s": 0.0}
    assert [row | clocks for row in straight.curve] == [row | clocks for row in resumed.curve]
    assert straight.evaluation == resumed.evaluation
    require_same_weights(straight.policy, resumed.policy)
    assert not (tmp_path / "checkpoint").exists()
    assert straight.timings["updates"] == resumed.timings["updates"] > 0


def test_a_finished_training_is_read_and_not_run_again(point_env: Any, tmp_path: Path) -> None:
    settings = dataclasses.replace(SAC, decisions=200, evaluate_every=100)
    first = Training(settings, point_env, tmp_path, seed=1).run()

    def must_not_run() -> Any:
        raise AssertionError("made an environment")

    again = Training(settings, must_not_run, tmp_path, seed=1).run()
    assert again.curve == first.curve
    assert again.timings == first.timings
    observation = {"place": np.array([0.3, -0.4], np.float32)}
    np.testing.assert_array_equal(again.policy.act(observation), first.policy.act(observation))
    others: list[tuple[Any, int, str]] = [
        (settings, 2, "seed 1, not 2"),
        (dataclasses.replace(settings, decisions=400), 1, "decisions 200, not 400"),
        (dataclasses.replace(PPO, decisions=200), 1, "algorithm sac, not ppo"),
    ]
    for other, seed, told in others:
        with pytest.raises(CheckpointError, match=rf"holds a finished training of another kind \(.*{told}"):
            Training(other, must_not_run, tmp_path, seed=seed).run()
    record = json.loads((tmp_path / "training.json").read_text())
    del record["settings"]["tau"]  # as of before there was such a setting: it was as the default is
    (tmp_path / "training.json").write_text(json.dumps(record))
    assert Training(settings, must_not_run, tmp_path, seed=1).run().timings == first.timings
    with pytest.raises(CheckpointError, match=r"another kind \(tau 0.005, not 0.01\)"):
        Training(dataclasses.replace(settings, tau=0.01), must_not_run, tmp_path, seed=1).run()
    for name, text in (("training.csv", "decisions\nmany\n"), ("training.json", "[1]"), ("training.json", "{")):
        whole = (tmp_path / name).read_bytes()
        (tmp_path / name).write_text(text)
        with pytest.raises(CheckpointError, match=r"its training\.json or training\.csv is damaged"):
            Training(settings, must_not_run, tmp_path, seed=1).run()
        (tmp_path / name).write_bytes(whole)
    (tmp_path / "training.csv").unlink()
    with pytest.raises(CheckpointError, match=r"its training\.json or training\.csv is damaged"):
        Training(settings, must_not_run, tmp_path, seed=1).run()


ENDLESS: dict[str, Any] = {
    **SMALL,
    "decisions": 10**6,
    "batch_size": 16,
    "learning_starts": 40,
    "gradient_steps": 0.25,
    "evaluate_every": 0,
    "checkpoint_seconds": 0.0,
    "buffer_size": 4000,
}
SCRIPT = f"""
import dataclasses, sys
from pathlib import Path
from enn.reinforcement.training.settings import DESK_SAC
from enn.reinforcement.training.training import Training
from tests.enn.conftest import PointEnv
settings = dataclasses.replace(DESK_SAC, **{ENDLESS!r})
Training(settings, PointEnv, Path(sys.argv[1]), seed=0).run(lambda moment: print(moment.decisions, flush=True))
"""


def test_kill_while_writing_leaves_a_checkpoint_to_go_on_from(point_env: Any, tmp_path: Path) -> None:
    command = [sys.executable, "-c", SCRIPT, str(tmp_path)]
    process = subprocess.Popen(command, cwd=Path(__file__).parents[3], stdout=subprocess.PIPE, text=True)
    deadline, reached = time.monotonic() + 300, 0
    while reached < 80 and time.monotonic() < deadline:
        reached = int(process.stdout.readline() or 0)
    # it writes a checkpoint after every decision, so this most likely hits a write
    process.send_signal(signal.SIGKILL)
    process.wait()
    process.stdout.close()
    seen: list[int] = []

    def progress(moment: Progress) -> None:
        seen.append(moment.decisions)
        raise Interruption

    with pytest.raises(Interruption):
        Training(dataclasses.replace(DESK_SAC, **ENDLESS), point_env, tmp_path, seed=0).run(progress)
    assert seen[0] >= 80


def test_a_write_that_fails_half_way_leaves_the_former_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = CheckpointFolder(tmp_path, {"hidden": (2, 2)})
    folder.write({"step": 1}, [("a.0", 1, np.arange(4))])

    def full(*arguments: Any) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("enn.reinforcement.checkpoint.encoded", full)
        with pytest.raises(OSError, match="No space left"):
            folder.write({"step": 2}, [("a.0", 2, np.arange(5))])
    state, pieces = CheckpointFolder(tmp_path, {"hidden": (2, 2)}).read()
    assert state == {"step": 1}
    np.testing.assert_array_equal(pieces["a.0"], np.arange(4))
    folder.write({"step": 3}, [("a.0", 3, np.arange(6))])
    assert len(list(tmp_path.iterdir())) == 3  # what the failed write left is gone


@pytest.fixture(scope="module")
def begun(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A training that was interrupted at once."""
    folder = tmp_path_factory.mktemp("begun")
    interrupted(Training(SAC, PointEnv, folder, seed=0))
    return folder


@pytest.fixture
def folder(begun: Path, tmp_path: Path) -> Path:
    """A copy of it to be spoilt."""
    return Path(shutil.copytree(begun, tmp_path / "training"))


def test_another_architecture_is_one_clear_sentence(folder: Path, point_env: Any) -> None:
    other = dataclasses.replace(SAC, hidden=(8,))
    with pytest.raises(CheckpointError, match=r"another architecture: its hidden is \[16, 16\], this training's \[8\]"):
        Training(other, point_env, folder, seed=0).run()
    with pytest.raises(CheckpointError, match="another architecture: its observations is"):
        Training(SAC, lambda: point_env(("range",)), folder, seed=0).run()
    with pytest.raises(CheckpointError, match="its seed is 0, this training's 1"):
        Training(SAC, point_env, folder, seed=1).run()


@pytest.mark.parametrize("kind", ["state", "piece", "index"])
def test_a_damaged_checkpoint_is_one_clear_sentence(kind: str, folder: Path, point_env: Any) -> None:
    checkpoint = folder / "checkpoint"
    if kind == "index":
        (checkpoint / "index.json").write_text('{"format": "enn-ch')
    else:
        file = next(checkpoint.glob("state-*.pt" if kind == "state" else "observation_*.npy"))
        data = bytearray(file.read_bytes())
        data[len(data) // 2] ^= 0xFF
        file.write_bytes(data)
    with pytest.raises(CheckpointError, match=r"is damaged.*remove it to train from the start"):
        Training(SAC, point_env, folder, seed=0).run()


def test_a_state_of_another_version_is_one_clear_sentence(folder: Path, point_env: Any) -> None:
    checkpoint = folder / "checkpoint"
    architecture = json.loads((checkpoint / "index.json").read_text())["index"]["architecture"]
    state, _ = CheckpointFolder(checkpoint, architecture).read()
    for change in ({"learner": {}}, {"counters": (1, 2)}, {"envs": None}, {"random": {}}, {"best_policy": 3}):
        CheckpointFolder(checkpoint, architecture).write(state | change)
        with pytest.raises(CheckpointError, match="its state cannot be taken up"):
            Training(SAC, point_env, folder, seed=0).run()
