"""The board: a row of any policy's file, in the fixed episodes of a published task; what cannot play is refused."""

import importlib.util
import json
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch

from cathsim import arch_variety
from enn.export import OnnxPolicy, export_onnx
from enn.networks.network import NetworkSettings, build_network
from enn.policy import Policy
from pipeline.protocol.board import boards, seated
from pipeline.protocol.command import main
from tests.cathsim.dual_device_nav.published_files import folder, needs_files

needs_onnx = pytest.mark.skipif(
    any(importlib.util.find_spec(name) is None for name in ("onnx", "onnxruntime", "onnxscript")),
    reason="the extra enn[onnx] is not installed",
)


def random_policy(path: Path, points: int = 16, actions: int = 2) -> Path:
    """A policy with fresh weights, which sees `tracking`."""
    seen = gymnasium.spaces.Box(-np.inf, np.inf, (points,), np.float32)
    moved = gymnasium.spaces.Box(-1.0, 1.0, (actions,), np.float32)
    torch.manual_seed(0)
    settings = NetworkSettings(hidden=(8,))
    Policy(settings, build_network(settings, seen, moved), seen, moved, action_repeat=2).save(path)
    return path


def row_of(file: Path, *words: str) -> dict[str, Any]:
    row = file.parent / "made" / "row.json"
    assert main(["--policy", str(file), "--row", str(row), *words]) == 0
    read: dict[str, Any] = json.loads(row.read_text())
    return read


def test_a_random_policy_gets_a_row_that_is_the_same_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(arch_variety, "ArchVarietyEnv", partial(arch_variety.ArchVarietyEnv, max_steps=40))
    file = random_policy(tmp_path / "mine.pt")
    row = row_of(file, "--episodes", "2")
    assert capsys.readouterr().out.startswith("| mine.pt | 0 of 2 | 0 % (0 to ")
    assert (row["board"], row["whole"], row["policy"]["file"]) == ("arch_variety", False, "mine.pt")
    assert [case["anatomy"] for case in row["cases"]] == ["I_10060", "II_10060"]
    assert all(not case["success"] and case["steps"] == 40 for case in row["cases"])
    assert row["summary"]["success_pct"]["mean"] == 0
    assert row_of(file, "--episodes", "1")["cases"] == row["cases"][:1]


@pytest.mark.parametrize(("board", "count"), [("arch_variety", 240), ("dual_device_nav", 98), ("random_trees", 100)])
def test_all_episodes_are_other_ones(board: str, count: int) -> None:
    episodes = boards()[board].episodes
    assert len({(*one.labels.values(), one.seed) for one in episodes}) == len(episodes) == count


@pytest.mark.parametrize(
    ("name", "prefix", "places", "steps"),
    [("arch_variety", "arch_variety_", (7, -1), 450), ("random_trees", "", (-1,), 1000)],
)
def test_the_anatomies_are_those_that_a_row_names(name: str, prefix: str, places: tuple[int, ...], steps: int) -> None:
    board = boards()[name]
    environment = board.make("tracking", None, 64)
    for episode in (board.episodes[place] for place in places):
        environment.reset(seed=episode.seed, options=episode.options)
        assert environment.unwrapped.phantom.name == f"{prefix}{episode.labels['anatomy']}"
        assert environment.unwrapped.task.max_steps == steps


@needs_onnx
def test_an_onnx_model_plays_as_its_policy_does(tmp_path: Path) -> None:
    policy = Policy.load(random_policy(tmp_path / "mine.pt"))
    model = OnnxPolicy(export_onnx(policy, tmp_path / "mine"))
    ours, theirs = policy.controller(), model.controller()
    for seen in np.random.default_rng(0).normal(size=(6, 16)).astype(np.float32):
        assert np.abs(ours(seen) - theirs(seen)).max() < 1e-5
    sits_down(tmp_path / "mine.onnx", "arch_variety")


def sits_down(file: Path, name: str) -> Any:
    """The bare environment in which a policy took its first step."""
    board = boards()[name]
    policy, environment, bare = seated(file, board)
    observation, info = environment.reset(seed=board.episodes[0].seed, options=board.episodes[0].options)
    environment.step(policy.controller()(observation, info))
    return bare


@needs_files
def test_it_sits_down_in_dual_device_nav(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CATHSIM_DUALDEVICENAV", folder())
    bare = sits_down(random_policy(tmp_path / "mine.pt", 18, 4), "dual_device_nav")
    assert bare.phantom.target(bare.task.target).branch in ("lcca", "rcca", "vertebral_left", "vertebral_right")


def test_what_cannot_play_is_refused_in_a_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def told(*words: object) -> str:
        assert main(list(map(str, words))) == 2
        return capsys.readouterr().err

    file = random_policy(tmp_path / "mine.pt")
    (tmp_path / "sb3.zip").write_bytes(b"PK")
    assert "there is no policy" in told("--policy", tmp_path / "none.pt")
    assert "export it to ONNX" in told("--policy", tmp_path / "sb3.zip")
    assert "there is no board 'basic_wire': choose" in told("--policy", file, "--board", "basic_wire")
    assert "leave claims out" in told("random_roadmap", "--policy", file)
    assert "--episodes is 1 at least" in told("--policy", file, "--episodes", "0")
    assert "--row is a folder" in told("--policy", file, "--row", tmp_path)
    assert "--row is in no folder" in told("--policy", file, "--row", Path(__file__) / "row.json")
    four = random_policy(tmp_path / "four.pt", 18, 4)
    assert "shape (4,), ArchVariety takes (2,)" in told("--policy", four, "--episodes", "1")
    (tmp_path / "text.onnx").write_text("no model")
    if importlib.util.find_spec("onnxruntime") is not None:
        assert "no ONNX model" in told("--policy", tmp_path / "text.onnx")
