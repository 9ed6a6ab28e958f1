"""Convex hulls for a wall: decomposition and its cache, how they fit, and a wire that is driven among them."""

import logging
import sys
from pathlib import Path

import numpy as np
import pytest

from cathsim import Phantom, Simulation
from cathsim.anatomy.surface import open_ends
from cathsim.contact import hulls as hulls_module
from cathsim.contact.hull_vessel import hull_vessel
from cathsim.contact.hulls import Decomposition, Hull, wall_hulls
from tests.cathsim.makers import MakeSimulation

QUICK = Decomposition(threshold=0.12, lattice=3e-3, search=15)
STEP = 0.002  # m


def drive(simulation: Simulation, steps: int) -> np.ndarray:
    """Insertion with some rotation: tips and forces, shape (steps, 6)."""
    rows = []
    for step in range(steps):
        simulation.advance(STEP, 0.1 if step % 3 else -0.1)
        rows.append(np.concatenate((simulation.tip, simulation.force())))
    return np.array(rows)


def test_coacd_cuts_a_wall_and_leaves_the_lumen_open(bend: Phantom, tmp_path: Path) -> None:
    pytest.importorskip("coacd", reason="the extra 'hulls' is not installed")
    hulls = wall_hulls(bend, QUICK, cache_dir=tmp_path)
    assert len(hulls) > 5
    middle = bend.tree.root.points[5:-5]
    for hull in hulls:
        normals, offsets = hull.planes()
        assert (hull.vertices @ normals.T - offsets).max() < 1e-7, "convex"
        assert ((middle @ normals.T - offsets).max(axis=1) > 0).all(), "the lumen's middle is free"
    mesh = bend.lumen_mesh
    ends = [np.linalg.norm(mesh.triangles_center - centre, axis=1) < 0.012 for centre, _, _ in open_ends(bend.tree)]
    wall = np.flatnonzero(~np.any(ends, axis=0))[::7]
    planes = [hull.planes() for hull in hulls]
    for outwards, least, most in ((1.5e-3, 0.97, 1.0), (-4e-3, 0.0, 0.01)):  # m: closed, and free inside
        points = mesh.triangles_center[wall] + outwards * mesh.face_normals[wall]
        held = np.any([(points @ normals.T <= offsets).all(axis=1) for normals, offsets in planes], axis=0)
        assert least <= held.mean() <= most


def test_hulls_come_from_the_cache_and_damage_is_mended(
    bend: Phantom, prisms: list[Hull], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    made = wall_hulls(bend, QUICK, cache_dir=tmp_path)
    assert len(made) == len(prisms)
    (file,) = (tmp_path / "hulls").iterdir()

    counted: list[Decomposition] = []

    def again(phantom: Phantom, settings: Decomposition) -> list[Hull]:
        counted.append(settings)
        return prisms[:10]

    monkeypatch.setattr(hulls_module, "decompose", again)
    read = wall_hulls(bend, QUICK, cache_dir=tmp_path)
    assert not counted
    for one, other in zip(made, read, strict=True):
        assert np.array_equal(one.vertices, other.vertices)
        assert np.array_equal(one.faces, other.faces)
    assert len(wall_hulls(bend, Decomposition(threshold=0.3), cache_dir=tmp_path)) == 10, "other settings, other hulls"
    assert counted == [Decomposition(threshold=0.3)]

    file.write_bytes(file.read_bytes()[:100])
    with caplog.at_level(logging.WARNING):
        assert len(wall_hulls(bend, QUICK, cache_dir=tmp_path)) == 10
    assert "damaged" in caplog.text
    assert len(wall_hulls(bend, QUICK, cache_dir=tmp_path)) == 10
    assert len(counted) == 2
    assert not list((tmp_path / "hulls").glob(".building-*"))


def test_wire_is_led_round_the_bend_as_by_the_grid(
    bend: Phantom, prisms: list[Hull], make_simulation: MakeSimulation
) -> None:
    tips = {}
    for contact in ("sdf", "hulls"):
        simulation = make_simulation(
            "nitrex_straight", "accurate", phantom=bend, contact=contact, measure_penetration=True
        )
        trace = drive(simulation, 22)
        tips[contact] = trace[:, :3]
        assert simulation.valid
        assert simulation.depths.max() < 5e-4
        contacts = simulation.contacts()
        assert len(contacts.points) > 0
        assert np.allclose(contacts.forces.sum(axis=0), simulation.force())
        _, inward = simulation.vessel.distance(contacts.points)
        pushes = (contacts.forces * inward).sum(axis=1)
        assert pushes.max() > 1e-3, "the wall pushes into the lumen"
        assert pushes.min() >= 0
    assert np.linalg.norm(tips["hulls"][-1] - tips["hulls"][0]) > 0.035
    assert np.abs(tips["hulls"] - tips["sdf"]).max() < 1e-3


def test_the_lid_keeps_the_wire_in(bend: Phantom, prisms: list[Hull], make_simulation: MakeSimulation) -> None:
    simulation = make_simulation("nitrex_straight", "accurate", phantom=bend, contact="hulls")
    drive(simulation, 40)
    assert simulation.valid
    assert simulation.vessel.distance(simulation.tip)[0] > -2e-3


def test_unknown_contact_and_missing_coacd(
    bend: Phantom, make_simulation: MakeSimulation, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    with pytest.raises(ValueError, match="unknown contact 'mesh'; there are sdf, hulls, or a Decomposition"):
        make_simulation(contact="mesh")
    monkeypatch.setitem(sys.modules, "coacd", None)
    with pytest.raises(ImportError, match=r"needs CoACD .*: pip install 'endonav-cathsim\[hulls\]'"):
        wall_hulls(bend, QUICK, cache_dir=tmp_path)
    with pytest.raises(ValueError, match="unknown entry 'radial'"):
        hull_vessel(bend, "radial", QUICK)
