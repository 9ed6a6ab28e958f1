"""Checkpoints: a resumed training is the same, bit for bit; a kill spoils nothing; what does not fit is refused."""

import dataclasses
import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from enn.model_file import encoded
from enn.reinforcement import checkpoint
from enn.reinforcement.checkpoint import CheckpointError, CheckpointFolder
from enn.reinforcement.training import (
    DESK_PPO,
    DESK_SAC,
    Progress,
    Training,
    TrainingResult,
    TrainingSettings,
)

SMALL: dict[str, Any] = {
    "decisions": 320, "n_envs": 4, "hidden": (16, 16), "batch_size": 32, "learning_starts": 100,
    "evaluate_every": 100, "evaluation_episodes": 3, "curve_every": 50,
}  # fmt: skip
SAC = dataclasses.replace(DESK_SAC, gradient_steps=0.25, buffer_size=1000, **SMALL)
PPO = dataclasses.replace(DESK_PPO, n_steps=32, epochs=2, **SMALL)


class _Interruption(Exception):
    pass


def _interrupt_at(decisions: int) -> Any:
    def progress(moment: Progress) -> None:
        if moment.decisions >= decisions:
            raise _Interruption

    return progress


def _same(first: TrainingResult, second: TrainingResult) -> None:
    clocks = ("wall_s", "cpu_s")
    for one, other in zip(first.curve, second.curve, strict=True):
        assert {k: v for k, v in one.items() if k not in clocks} == {k: v for k, v in other.items() if k not in clocks}
    assert first.evaluation == second.evaluation
    theirs = second.policy.module.state_dict()
    for name, value in first.policy.module.state_dict().items():
        assert torch.equal(value, theirs[name]), name


OVERLAPPING = dataclasses.replace(SAC, overlap=True, threads=2)


@pytest.mark.parametrize("settings", [SAC, OVERLAPPING, PPO], ids=["sac", "sac_overlap", "ppo"])
def test_interrupted_and_resumed_is_the_same_as_straight(
    settings: TrainingSettings, point_env: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("enn.reinforcement.training.training.TICK", 0.0)
    monkeypatch.setattr("enn.reinforcement.training.inputs.WORTH_A_PROCESS", 0)
    straight = Training(settings, point_env, None, seed=3).run()
    for stop in (200,) if settings is OVERLAPPING else (60, 200):  # its environments have a process each time
        with pytest.raises(_Interruption):
            Training(settings, point_env, tmp_path, seed=3).run(_interrupt_at(stop))
        assert (tmp_path / "checkpoint" / "index.json").is_file()
        np.random.seed(0)  # noqa: NPY002 - what others draw in between must not matter
        torch.manual_seed(0)
    resumed = Training(settings, point_env, tmp_path, seed=3).run()
    _same(straight, resumed)
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
    (tmp_path / "training.csv").unlink()
    with pytest.raises(CheckpointError, match=r"its training\.json or training\.csv is damaged"):
        Training(settings, must_not_run, tmp_path, seed=1).run()


SCRIPT = """
import dataclasses, importlib.util, sys
from pathlib import Path
spec = importlib.util.spec_from_file_location("toy", sys.argv[1])
toy = importlib.util.module_from_spec(spec)
spec.loader.exec_module(toy)
from enn.reinforcement.training import DESK_SAC, Training
settings = dataclasses.replace(DESK_SAC, decisions=10**6, n_envs=4, hidden=(16, 16), batch_size=16, learning_starts=40,
                               gradient_steps=0.25, evaluate_every=0, checkpoint_seconds=0.0, buffer_size=4000)
Training(settings, toy.PointEnv, Path(sys.argv[2]), seed=0).run(lambda moment: print(moment.decisions, flush=True))
"""


def test_kill_while_writing_leaves_a_checkpoint_to_go_on_from(point_env: Any, tmp_path: Path) -> None:
    conftest = Path(__file__).parents[1] / "conftest.py"
    command = [sys.executable, "-c", SCRIPT, str(conftest), str(tmp_path)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env={**os.environ, "OMP_NUM_THREADS": "1"})
    deadline, reached = time.monotonic() + 300, 0
    while reached < 80 and time.monotonic() < deadline:
        reached = int(process.stdout.readline() or 0)
    # it writes a checkpoint after every decision, so this most likely hits a write
    process.send_signal(signal.SIGKILL)
    process.wait()
    process.stdout.close()
    settings = dataclasses.replace(
        DESK_SAC,
        decisions=10**6,
        n_envs=4,
        hidden=(16, 16),
        batch_size=16,
        learning_starts=40,
        gradient_steps=0.25,
        evaluate_every=0,
        checkpoint_seconds=0.0,
        buffer_size=4000,
    )
    seen: list[int] = []

    def progress(moment: Progress) -> None:
        seen.append(moment.decisions)
        raise _Interruption

    with pytest.raises(_Interruption):
        Training(settings, point_env, tmp_path, seed=0).run(progress)
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


def _interrupted(settings: TrainingSettings, point_env: Any, folder: Path) -> None:
    def stop(moment: Progress) -> None:
        raise _Interruption

    with pytest.raises(_Interruption):
        Training(settings, point_env, folder, seed=0).run(stop)


def test_another_architecture_is_one_clear_sentence(point_env: Any, tmp_path: Path) -> None:
    _interrupted(SAC, point_env, tmp_path)
    other = dataclasses.replace(SAC, hidden=(8,))
    with pytest.raises(CheckpointError, match=r"another architecture: its hidden is \[16, 16\], this training's \[8\]"):
        Training(other, point_env, tmp_path, seed=0).run()
    with pytest.raises(CheckpointError, match="another architecture: its observations is"):
        Training(SAC, lambda: point_env(("range",)), tmp_path, seed=0).run()
    with pytest.raises(CheckpointError, match="its seed is 0, this training's 1"):
        Training(SAC, point_env, tmp_path, seed=1).run()


@pytest.mark.parametrize("kind", ["state", "piece", "index", "format"])
def test_a_damaged_checkpoint_is_one_clear_sentence(kind: str, point_env: Any, tmp_path: Path) -> None:
    _interrupted(SAC, point_env, tmp_path)
    folder = tmp_path / "checkpoint"
    if kind == "index":
        (folder / "index.json").write_text('{"format": "enn-ch')
    elif kind == "format":
        (folder / "index.json").write_text('{"format": "enn-checkpoint-1", "number": 3}')
    else:
        file = next(folder.glob("state-*.pt" if kind == "state" else "observation_*.npy"))
        data = bytearray(file.read_bytes())
        data[len(data) // 2] ^= 0xFF
        file.write_bytes(data)
    expected = "is of an older format, enn-checkpoint-1" if kind == "format" else "is damaged"
    with pytest.raises(CheckpointError, match=f"{expected}.*remove it to train from the start"):
        Training(SAC, point_env, tmp_path, seed=0).run()


def _index_with(change: Callable[[dict[str, Any]], Any], folder: Path) -> None:
    """Changes the index of a checkpoint, and gives it the digest that belongs to the changed one."""
    index = json.loads((folder / "index.json").read_text())["index"]
    index = change(index) or index
    (folder / "index.json").write_text(json.dumps({"sha256": checkpoint._digest(index), "index": index}))


def test_a_wrong_bit_anywhere_is_refused(point_env: Any, tmp_path: Path) -> None:
    _interrupted(SAC, point_env, tmp_path)
    folder = tmp_path / "checkpoint"
    architecture = json.loads((folder / "index.json").read_text())["index"]["architecture"]
    before = CheckpointFolder(folder, architecture).read()
    generator = np.random.default_rng(0)
    for file in sorted(folder.iterdir()):
        whole = file.read_bytes()
        for bit in generator.integers(0, 8 * len(whole), 15).tolist():
            data = bytearray(whole)
            data[bit // 8] ^= 1 << bit % 8
            file.write_bytes(data)
            # an exponent's e is one bit from E: the same index in other letters
            if file.name == "index.json" and json.loads(whole) == _json_or_none(data):
                continue
            with pytest.raises(CheckpointError, match="remove"):
                CheckpointFolder(folder, architecture).read()
        file.write_bytes(whole)
    assert CheckpointFolder(folder, architecture).read()[0]["curve"] == before[0]["curve"]


def _json_or_none(data: bytes) -> Any:
    try:
        return json.loads(data)
    except ValueError:
        return None


def test_a_state_of_another_version_is_one_clear_sentence(point_env: Any, tmp_path: Path) -> None:
    _interrupted(SAC, point_env, tmp_path)
    folder = tmp_path / "checkpoint"
    architecture = json.loads((folder / "index.json").read_text())["index"]["architecture"]
    state, _ = CheckpointFolder(folder, architecture).read()
    for change in ({"learner": {}}, {"counters": (1, 2)}, {"envs": None}, {"random": {}}, {"best_policy": 3}):
        CheckpointFolder(folder, architecture).write(state | change)
        with pytest.raises(CheckpointError, match=r"its state cannot be taken up: .*: remove it to train from the"):
            Training(SAC, point_env, tmp_path, seed=0).run()


def test_reading_a_checkpoint_runs_no_code(tmp_path: Path) -> None:
    class Runs:
        def __reduce__(self) -> tuple[Any, ...]:
            return Path.touch, (tmp_path / "ran",)

    folder = CheckpointFolder(tmp_path / "checkpoint", {})
    folder.write({"step": 1})
    file = next((tmp_path / "checkpoint").glob("state-*.pt"))
    file.write_bytes(encoded({"state": Runs(), "kinds": {}}))
    _index_with(
        lambda index: index["state"].update(sha256=hashlib.sha256(file.read_bytes()).hexdigest()), folder.folder
    )
    with pytest.raises(CheckpointError, match="is damaged"):
        folder.read()
    assert not (tmp_path / "ran").exists()


def test_a_damaged_record_of_a_finished_training_is_one_clear_sentence(point_env: Any, tmp_path: Path) -> None:
    settings = dataclasses.replace(SAC, decisions=120, evaluate_every=0)
    Training(settings, point_env, tmp_path, seed=1).run()
    for name, text in (("training.csv", "decisions\nmany\n"), ("training.json", "[1]"), ("training.json", "{")):
        (tmp_path / name).write_text(text)
        with pytest.raises(CheckpointError, match=r"is finished, but its training\.json or training\.csv is damaged"):
            Training(settings, point_env, tmp_path, seed=1).run()
