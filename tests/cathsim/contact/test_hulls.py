"""Convex hulls for a wall: decomposition and its cache, how they fit, and a wire that is driven among them."""

from __future__ import annotations

import itertools
import logging
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cathsim import Phantom, Simulation
from cathsim.anatomy.surface import open_ends
from cathsim.contact import hulls as hulls_module
from cathsim.contact.hull_vessel import BORE_SIDES, HullVessel, hull_vessel
from cathsim.contact.hulls import Decomposition, Hull, wall_hulls
from cathsim.contact.sdf import SHEATH_NAME
from tests.cathsim.contact.wall_fit import chords, wall_fit

MakeSimulation = Callable[..., Simulation]
QUICK = Decomposition(threshold=0.12, lattice=3e-3, search=15)
STEP = 0.002  # m


def brick(low: tuple[float, ...], high: tuple[float, ...]) -> Hull:
    return hulls_module._convex(np.array(list(itertools.product(*zip(low, high, strict=True)))))


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
    fit = wall_fit(bend, hulls, samples=800)
    assert fit.leak_share < 0.03
    assert not fit.blocked.any()
    assert 1e-4 < np.percentile(fit.intrusion, 99) < 0.12 * 0.5 * np.ptp(bend.bounds, axis=0).max()


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


def test_chords_of_a_brick() -> None:
    hull = brick((0, 0, 0), (1, 2, 3))
    points = np.array([[-1.0, 1, 1], [0.5, 1, 1], [0.5, 5, 1], [-1.0, 0, 0]])
    directions = np.array([[1.0, 0, 0], [0, 0, 1], [1, 0, 0], [np.sqrt(0.5), np.sqrt(0.5), 0]])
    begin, end = chords(hull, points, directions)
    np.testing.assert_allclose(begin[:2], [1, -1], atol=1e-12)
    np.testing.assert_allclose(end[:2], [2, 2], atol=1e-12)
    assert begin[2] > end[2], "beside the brick"
    np.testing.assert_allclose([begin[3], end[3]], np.sqrt(2) * np.array([1, 2]), atol=1e-9)


def test_fit_of_hulls_made_by_hand(bend: Phantom, prisms: list[Hull]) -> None:
    fit = wall_fit(bend, prisms, samples=1500)
    sagitta = 0.007 * (1 - np.cos(np.pi / 16))  # of a prism's flat inner face under the round wall
    assert fit.leak_share == 0
    assert not fit.blocked.any()
    assert fit.intrusion.max() == pytest.approx(sagitta, abs=1.5e-4)
    assert np.nanmax(fit.recess) < 1.5e-4

    half = [hull for hull in prisms if hull.vertices[:, 1].mean() > 0]
    assert wall_fit(bend, half, samples=1500).leak_share == pytest.approx(0.5, abs=0.05)
    plug = brick((-0.01, -0.01, 0.02), (0.02, 0.01, 0.03))
    blocked = wall_fit(bend, [*prisms, plug], samples=1500).blocked
    assert 0.05 < blocked.mean() < 0.4


def test_a_model_has_hulls_lid_and_sheath(bend: Phantom, prisms: list[Hull], make_simulation: MakeSimulation) -> None:
    simulation = make_simulation(phantom=bend, contact=QUICK)
    model = simulation.model
    names = [model.geom(i).name for i in range(model.ngeom)]
    assert sum(name.startswith("hull") for name in names) == len(prisms)
    assert "lid1" in names, "of the far end"
    assert sum(name.startswith("lid0") for name in names) == BORE_SIDES, "around the sheath"
    vessel = simulation.vessel
    assert isinstance(vessel, HullVessel)
    wall = names[1 : 1 + vessel.wall_parts(model)]
    assert len(wall) == len(prisms) + BORE_SIDES + 1
    assert not any(name.startswith(SHEATH_NAME) for name in wall)
    centre, normal, _ = open_ends(bend.tree)[1]
    np.testing.assert_allclose(model.geom("lid1").pos, centre, atol=5e-3)
    assert abs(model.geom("lid1").pos @ normal - centre @ normal) < 5e-3


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


def test_same_bits_and_restored_states(bend: Phantom, prisms: list[Hull], make_simulation: MakeSimulation) -> None:
    first, second = (make_simulation(phantom=bend, contact="hulls") for _ in range(2))
    assert np.array_equal(drive(first, 20), drive(second, 20))
    state = first.state()
    ahead = drive(first, 5)
    first.restore(state)
    assert np.array_equal(drive(first, 5), ahead)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"threshold": 0.001}, "threshold must lie in 0.01 to 1, got 0.001"),
        ({"thickness": 0.02}, r"thickness must lie in 0 \(excluded\) to 0\.005 m, got 0\.02"),
    ],
)
def test_decomposition_refuses(arguments: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Decomposition(**arguments)  # type: ignore[arg-type]


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
