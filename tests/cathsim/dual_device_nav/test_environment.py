"""DualDeviceNav: vessels, entry, devices, targets of the published seeds, view, files, messages."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cathsim import load_phantom
from cathsim.anatomy import Phantom
from cathsim.anatomy.dual_device_nav import read_curve, target_points
from cathsim.dual_device_nav import CATHETER, TEST_SEEDS, WIRE, DualDeviceNavEnv, DualDeviceNavTask
from cathsim.observations.tracking import in_view
from tests.cathsim.dual_device_nav.published_files import folder, needs_files

# mm behind the ostium to the last point in the lumen; README of the files beside the project: 232, 224, 223, 219
LENGTHS = {"lcca": 246, "rcca": 233, "vertebral_left": 203, "vertebral_right": 201}


@pytest.fixture(scope="module")
def phantom() -> Phantom:
    return load_phantom(folder())


@pytest.fixture(scope="module")
def environment() -> DualDeviceNavEnv:
    return DualDeviceNavEnv(folder())


@needs_files
def test_vessels_follow_the_published_centrelines_in_a_lumen_with_its_rings(phantom: Phantom) -> None:
    from skimage.measure import euler_number

    tree = phantom.tree
    for name, length in LENGTHS.items():
        assert 1e3 * (tree[name].length - tree.ostium_arc(name)) == pytest.approx(length, abs=2)
        assert (phantom.grid.sample(tree[name].points) > 0).mean() > 0.98
    chains = [tree.ancestry(name)[1:-1] for name in LENGTHS]
    assert chains == [(), ("bca",), ("lsa",), ("bca", "rsa")]
    assert 600 < 1e3 * phantom.way_length("rcca@200") < 723
    nodes = phantom.grid.inside()
    solid = np.zeros(phantom.grid.shape, bool)
    solid[tuple(nodes.T)] = True
    assert euler_number(solid, 3) <= -3  # four rings, as the published surface has, and where vessels lie close


@needs_files
def test_devices_come_in_where_the_task_has_them(environment: DualDeviceNavEnv) -> None:
    assert (environment.observation_space.shape, environment.action_space.shape) == ((18,), (4,))
    environment.reset(seed=1)
    vessel = environment.simulation.vessel
    assert vessel.entry == pytest.approx([0.065, -0.005, 0.035])
    assert vessel.direction == pytest.approx(np.array([-1, 0, 1]) / math.sqrt(2))
    for _ in range(12):
        *_, info = environment.step(np.array([1.0, 0.0, 1.0, 0.0]))
    assert info["insertion"] == pytest.approx(12 * 0.035 / 7.5, abs=2e-3)
    assert info["tip"][2] > 0.06  # m: up the artery


def test_devices_are_the_published_ones() -> None:
    assert (WIRE.diameter, CATHETER.outer_diameter, CATHETER.inner_diameter) == (0.36e-3, 0.7e-3, 0.57e-3)
    assert (WIRE.working_length, CATHETER.length, WIRE.friction, CATHETER.friction) == (0.9, 0.9, 0.001, 0.001)
    assert WIRE.tip_length == pytest.approx(12.1e-3 * 0.4 * math.pi, rel=1e-3)
    assert WIRE.tip_angle == pytest.approx(0.4 * math.pi)
    task = DualDeviceNavTask()
    assert (task.success_radius, task.success, task.max_steps) == (0.005, "straight", 1000)
    assert task.step_reward(0.1, 0.004, 0.3, success=False) == pytest.approx(0.001 * 4 - 0.005)
    assert len(TEST_SEEDS) == 98


@needs_files
def test_a_seed_draws_the_published_target(environment: DualDeviceNavEnv) -> None:
    drawn = {}
    for seed in (1, 2, 175):
        _, info = environment.reset(seed=seed)
        drawn[seed] = 1e3 * environment.goal
        assert info["distance"] == pytest.approx(np.linalg.norm(info["tip"] - environment.goal))
    assert drawn[1] == pytest.approx([41.895, 19.634, 537.705], abs=2e-3)  # by the published procedure and files
    assert drawn[2] == pytest.approx([-2.628, 29.421, 413.567], abs=2e-3)
    assert drawn[175] == pytest.approx([20.183, -14.417, 592.789], abs=2e-3)
    environment.reset(seed=1)
    assert 1e3 * environment.goal == pytest.approx(drawn[1])
    environment.reset()
    assert np.abs(1e3 * environment.goal - drawn[1]).max() > 1
    branches = {environment.phantom.target(point).branch for point in target_points(environment.phantom)}
    assert branches == {*LENGTHS, "rsa"}  # of which the published RVA has the beginning
    _, info = environment.reset(seed=1, options={"target": "rcca@80"})
    assert environment.task.target == "rcca@80"


def test_the_view_is_tilted_and_turned_as_published() -> None:
    points = np.random.default_rng(0).normal(size=(5, 3))
    published = Rotation.from_euler("xz", [-5, -20], degrees=True).apply(points)  # about the fixed axes, x first
    assert np.allclose(in_view(points, (20.0, 5.0)), published[:, [0, 2]])


def test_files_that_are_missing_are_told_with_what_to_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("CATHSIM_DUALDEVICENAV", raising=False)
    with pytest.raises(ValueError, match="set CATHSIM_DUALDEVICENAV"):
        DualDeviceNavEnv()
    with pytest.raises(ValueError, match="beside a folder Centrelines_comb"):
        DualDeviceNavEnv(tmp_path)
    (tmp_path / "vessel_architecture_collision.obj").touch()
    (tmp_path / "Centrelines_comb").mkdir()
    with pytest.raises(ValueError, match=r"lacks the centrelines .*\(19\), .*- LVA, "):
        DualDeviceNavEnv(tmp_path)
    with pytest.raises(ValueError, match="leave phantom out"):
        DualDeviceNavEnv(phantom="type_1")


@pytest.mark.parametrize("content", ["", "[]", '{"markups": [{"coordinateSystem": "LPS"}]}'])
def test_a_file_without_a_curve_is_refused(tmp_path: Path, content: str) -> None:
    (tmp_path / "a.mrk.json").write_text(content)
    with pytest.raises(ValueError, match="holds no curve with a radius at each point"):
        read_curve(tmp_path / "a.mrk.json")


def test_a_curve_is_read_in_lps(tmp_path: Path) -> None:
    markup = {
        "coordinateSystem": "RAS",
        "controlPoints": [{"position": [1, 2, 3]}, {"position": [4, 5, 7]}],
        "measurements": [{"name": "length"}, {"name": "Radius", "controlPointValues": [0.5, 0.25]}],
    }
    path = tmp_path / "a.mrk.json"
    path.write_text(json.dumps({"markups": [markup]}))
    curve = read_curve(path)
    assert curve.points.tolist() == [[-1, -2, 3], [-4, -5, 7]]
    assert curve.radius.tolist() == [0.5, 0.25]
