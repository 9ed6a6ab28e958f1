"""The demo's scene: the policy sees what it was trained on, and what it reads lies in the image."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import enn
from cathsim import load_phantom
from pipeline.anatomies.anatomy_file import AnatomyFile
from pipeline.demo import steering
from pipeline.demo.steering import open_scene
from pipeline.store.errors import ConfigurationError
from pipeline.task import TASK, Task
from tests.pipeline.anatomies.small_ct import ct_of
from tests.pipeline.demo.small_policies import TASK_OF_DEMO, inside, ship, ship_for_two_devices


@pytest.fixture(autouse=True)
def shipped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    return ship(tmp_path / "shipped", monkeypatch)


def test_the_navigator_sees_images_alone() -> None:
    scene = open_scene("navigator", seed=5, target="lcca")
    assert scene.by_images
    assert scene.title == "the navigator steers to the LCCA of random arch 40005"
    observation, info = scene.environment.reset(seed=scene.start_seed)
    assert set(observation) == {"image", "plain", "contrast", "goal_image"}
    before = scene.read_off_image("frontal")
    scene.steer(observation, info)
    after = scene.read_off_image("frontal")
    size = TASK_OF_DEMO.image_size_px
    for read in (before, after):
        assert read.lumen.shape == (size, size)
        assert inside(read.wire)
        assert inside(read.way)
    np.testing.assert_array_equal(before.wire, after.wire)


def test_a_catheter_is_over_the_wire_where_the_take_off_is_steep(shipped: Path) -> None:
    steep, other = {"seed": 247, "target": "lcca"}, {"seed": 203, "target": "lcca"}  # set back by 11.0 and -0.9 mm
    assert open_scene("navigator", **steep).model == "navigator"  # no policy steers one
    ship_for_two_devices(shipped)
    assert open_scene("navigator", **steep, catheter=False).model == "navigator"
    assert open_scene("navigator", **other).model == "navigator"
    scene = open_scene("navigator", **steep)
    assert scene.title == "the navigator_simmons2 steers to the LCCA of random arch 40247"
    observation, info = scene.environment.reset(seed=scene.start_seed)
    assert scene.steer(observation, info).shape == (4,)
    assert inside(scene.read_off_image("frontal").wire)


def test_trials_choose_the_devices_in_an_anatomy_of_ones_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(steering, "load_anatomy", lambda place: load_phantom("type_1"))
    asked, best = [], 1

    def trials(policies: Any, tasks: Any, phantom: Any, target: str, *, usual: int, seed: int) -> int:
        asked.append((phantom.name, target, [(task.wire, task.catheter) for task in tasks], usual))
        return best

    monkeypatch.setattr(steering, "best_in_copies", trials)
    policy, both = enn.load("generalist"), enn.load("generalist")
    both.metadata[TASK] = policy.metadata[TASK] | {"catheter": "jb2"}
    monkeypatch.setattr(enn, "load", {"generalist": policy, "generalist_jb2": both}.__getitem__)
    names = ["generalist", "generalist_jb2"]
    name, _, task = steering._best_model(names, AnatomyFile("own.stl"), "lcca")
    assert (name, task) == ("generalist_jb2", Task(**both.metadata[TASK]))
    devices = [("default", None), ("default", "jb2"), ("radifocus_angled_025", "jb2_4f")]
    assert asked == [("type_1", "lcca", devices, 1)]  # set back by 1.0 mm
    best = 2
    name, _, task = steering._best_model(names, AnatomyFile("own.stl"), "lcca")
    assert task is not None
    assert (name, task.wire, task.catheter) == ("generalist_jb2", *devices[2])
    assert steering._best_model(names, 203, "lsa") == ("generalist", policy, None)  # a random arch: by its shape
    assert len(asked) == 2


def test_from_where_on_the_catheter_is_better_depends_on_policy_and_branch(monkeypatch: pytest.MonkeyPatch) -> None:
    for model, target, back, steep in (
        ("generalist", "lcca", 2.0, True), ("generalist", "lsa", 2.0, True), ("generalist", "lcca", -0.5, False),
        ("generalist", "bca", 2.0, False), ("navigator", "lcca", 2.0, False), ("navigator", "lcca", 5.0, True),
        ("generalist", "bca", 5.0, True),
    ):  # fmt: skip
        monkeypatch.setattr(steering, "set_back_mm", lambda phantom, target, back=back: back)
        assert steering._is_steep(40_000, target, f"{model}_jb2") is steep, (model, target, back)


def test_the_wire_alone_goes_to_targets_in_the_aorta(monkeypatch: pytest.MonkeyPatch) -> None:
    phantom = load_phantom("type_1")
    monkeypatch.setattr(steering, "load_anatomy", lambda place: phantom)
    inside_aorta = tuple(phantom.tree.root.point_at(0.1))
    assert not steering._is_steep(0, inside_aorta, "generalist_jb2")  # type: ignore[arg-type]
    assert steering._is_steep(0, "lcca", "generalist_jb2")  # set back by 1.0 mm


def test_the_generalist_goes_by_the_scan() -> None:
    scene = open_scene("generalist", seed=5)
    assert not scene.by_images
    scene.environment.reset(seed=scene.start_seed)
    wire, way = scene.read_off_scan()
    assert way.shape == (50, 3)
    np.testing.assert_allclose(wire[0], scene.environment.simulation.wire_points()[0])
    assert np.linalg.norm(way[0] - wire[0]) < 5e-3


def test_further_arteries_above_a_random_arch_are_targets() -> None:
    assert open_scene("generalist", target="rcca", catheter=False).target == "rcca"


def test_what_there_is_not_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ConfigurationError, match="'spleen': choose --target from bca, lcca, lsa, rsa, rcca"):
        open_scene("navigator", target="spleen")
    policy = enn.load("navigator")
    policy.metadata.clear()
    monkeypatch.setattr(enn, "load", lambda name: policy)
    with pytest.raises(ConfigurationError, match="'navigator' does not say which task it was trained for"):
        open_scene("navigator")


def test_the_patients_ct_is_what_the_navigator_sees_around_the_vessels(tmp_path: Path) -> None:
    load_phantom("type_1", resolution=2e-3).lumen_mesh.export(tmp_path / "arch.stl")
    own = {"anatomy": str(tmp_path / "arch.stl"), "target": "bca"}
    bath = open_scene("navigator", **own)
    ct = ct_of(bath.environment.phantom, tmp_path / "ct.nii.gz")
    scene = open_scene("navigator", **own, ct=str(ct))
    assert scene.background is not None
    assert scene.background.name == "ct"
    seen, of_bath = (one.environment.reset(seed=one.start_seed)[0] for one in (scene, bath))
    assert np.abs(seen["plain"].astype(float) - of_bath["plain"]).mean() > 10
    assert scene.steer(seen, {}).shape == (2,)
    with pytest.raises(ValueError, match="is no NIfTI file"):
        open_scene("navigator", **own, ct=str(tmp_path / "arch.stl"))
    with pytest.raises(ConfigurationError, match="give --anatomy FILE, too"):
        open_scene("navigator", ct=str(ct))
