"""Portable MJCF: opened and stepped by MuJoCo in a process that cannot import this package."""

import json
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest

from cathsim import Phantom, export, load_catheter, load_guidewire
from cathsim.contact.hulls import Hull
from cathsim.devices.pair import DevicePair
from cathsim.export import EXPORT_NUMERICS, export_mjcf
from tests.cathsim.makers import MakeSimulation

STEPS = 24  # control steps, insertion of 2 mm each

ALONE = """
import json, sys
sys.modules["cathsim"] = None
import mujoco
model = mujoco.MjModel.from_xml_path("MODEL")
data = mujoco.MjData(model)
deepest = 0.0
for _ in range(150):
    mujoco.mj_step(model, data)
for step in range(STEPS * 50):
    data.ctrl[0] = 0.002 * (step + 1) / 50
    mujoco.mj_step(model, data)
    if data.ncon:
        deepest = min(deepest, float(data.contact.dist.min()))
assert not [name for name in sys.modules if name.startswith("cathsim.")]
print(json.dumps({
    "tip": data.site("tip").xpos.tolist(), "advance": data.qpos[0], "deepest": deepest, "contacts": data.ncon,
    "warnings": sum(int(w.number) for w in data.warning),
}))
"""


@pytest.fixture
def exported(bend: Phantom, prisms: list[Hull], tmp_path: Path) -> Path:
    return export_mjcf(tmp_path / "bend", bend, load_guidewire("nitrex_straight"))


def test_mujoco_alone_feeds_the_wire_as_the_simulation_does(
    exported: Path, bend: Phantom, make_simulation: MakeSimulation, run_python: Callable[[str], str]
) -> None:
    alone = json.loads(run_python(ALONE.replace("MODEL", str(exported)).replace("STEPS", str(STEPS))))
    assert alone["warnings"] == 0
    assert alone["contacts"] > 0
    assert alone["advance"] == pytest.approx(0.002 * STEPS, abs=1e-3)
    assert alone["deepest"] > -1e-3
    simulation = make_simulation("nitrex_straight", numerics=EXPORT_NUMERICS, phantom=bend, contact="hulls")
    for _ in range(STEPS):
        simulation.advance(0.002, 0.0)
    assert np.linalg.norm(simulation.tip - alone["tip"]) < 1e-3
    assert simulation.vessel.distance(simulation.tip)[0] > 0


def test_files_hold_the_hulls_where_they_were(exported: Path, prisms: list[Hull]) -> None:
    model = mujoco.MjModel.from_xml_path(str(exported))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert model.nuser_geom == 0
    assert "vessel" not in [model.geom(i).name for i in range(model.ngeom)]
    assert len(list(exported.parent.glob("meshes/hull*.stl"))) == len(prisms)
    for index in (0, len(prisms) // 2, len(prisms) - 1):
        geom, mesh = model.geom(f"hull{index}"), model.mesh(f"hull{index}")
        start, count = int(mesh.vertadr[0]), int(mesh.vertnum[0])
        rotation, place = data.geom_xmat[geom.id].reshape(3, 3), data.geom_xpos[geom.id]
        vertices = model.mesh_vert[start : start + count] @ rotation.T + place
        expected = prisms[index].vertices
        assert np.allclose([vertices.min(0), vertices.max(0)], [expected.min(0), expected.max(0)], atol=1e-6)
    lumen = model.geom("lumen")
    assert lumen.contype[0] == lumen.conaffinity[0] == 0


def test_export_refuses(bend: Phantom, prisms: list[Hull], tmp_path: Path) -> None:
    wire = load_guidewire("default")
    vertebral = load_catheter("vertebral")
    for device, more, message in (
        (wire, {"contact": "sdf"}, "contact='sdf' is native code"),
        (wire, {"contact": "flex"}, "unknown contact 'flex'"),
        (wire, {"entry": "radial"}, "unknown entry 'radial'"),
        (vertebral, {}, "does not travel in an MJCF file"),
        (DevicePair(None, vertebral), {}, "does not travel in an MJCF file"),
    ):
        with pytest.raises(ValueError, match=message):
            export_mjcf(tmp_path / "new", bend, device, **more)
    assert not (tmp_path / "new").exists()
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(ValueError, match="is there and is no earlier export"):
        export_mjcf(tmp_path, bend, wire)
    assert (tmp_path / "notes.txt").read_text() == "mine"
    project = tmp_path / "project"
    (project / "meshes").mkdir(parents=True)
    for name in ("model.xml", "meshes/lumen.stl", "meshes/own.stl"):
        (project / name).write_text("mine")
    with pytest.raises(ValueError, match="is there and is no earlier export"):
        export_mjcf(project, bend, wire)
    assert (project / "model.xml").read_text() == "mine"


def test_a_folder_that_cannot_be_made_is_told_before_the_wall_is_cut(
    bend: Phantom, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr("cathsim.export.hull_vessel")
    (tmp_path / "file").touch()
    with pytest.raises(OSError, match="file"):
        export_mjcf(tmp_path / "file" / "new", bend, load_guidewire("default"))


def test_command_line(
    bend: Phantom,
    prisms: list[Hull],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(export, "load_phantom", lambda name: bend)
    assert export.main([str(tmp_path / "out"), "--phantom", "type_1", "--wire", "default"]) == 0
    path = Path(capsys.readouterr().out.strip())
    assert path == tmp_path / "out" / "model.xml"
    assert mujoco.MjModel.from_xml_path(str(path)).nu == 2
    assert export.main([str(tmp_path / "out3"), "--threshold", "7"]) == 2
    assert "threshold must lie in" in capsys.readouterr().err
