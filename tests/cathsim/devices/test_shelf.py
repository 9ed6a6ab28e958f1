"""The shelf: presets in their sizes, shapes as clinicians know them, sources, refusals."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from cathsim.devices.device_file import CATHETER, FOLDERS, GUIDEWIRE, PRESETS
from cathsim.devices.shelf import (
    CATHETERS,
    SHAPES,
    catheter_preset_of,
    catheter_shape,
    load_catheter,
)
from cathsim.guidewire import GUIDEWIRES, Guidewire, load_guidewire

# before presets were files
FORMER = {
    "default": Guidewire(),
    "thesis": Guidewire(links=(0.003,) * 84, diameter=1.0e-3),
    "radifocus_angled": Guidewire(
        shaft_stiffness_nmm2=260.0, tip_stiffness_nmm2=12.0, tip_angle=np.radians(45.0), tip_length=0.012, friction=0.04
    ),
    "nitrex_straight": Guidewire(shaft_stiffness_nmm2=380.0, tip_stiffness_nmm2=20.0, tip_angle=0.0, tip_length=0.0),
}


def tip_direction(name: str) -> float:
    """Angle of the unloaded tip to the shaft, degrees."""
    return float(np.degrees(sum(angle for _, _, angle, _ in load_catheter(name).shape)))


def limbs(name: str) -> tuple[float, float, float]:
    """How far the tip lies below the highest place, the highest place above the bent part's start, and width, mm."""
    catheter = load_catheter(name)
    end = max(bend[1] for bend in catheter.shape)
    points = catheter.centreline(np.linspace(0.0, end, 801)) * 1e3
    top = points[:, 2].max()
    return top - points[0, 2], top, float(np.ptp(points[:, 1]))


def test_every_file_is_a_preset() -> None:
    for kind, names in ((GUIDEWIRE, set(GUIDEWIRES)), (CATHETER, set(SHAPES))):
        assert {path.stem for path in (PRESETS / FOLDERS[kind]).glob("*.yaml")} == names
    assert set(CATHETERS) == set(SHAPES) | {f"{shape}_{french}f" for shape in SHAPES for french in (4, 5, 6)}


@pytest.mark.parametrize("name", FORMER)
def test_former_wires_have_the_same_numbers(name: str) -> None:
    assert GUIDEWIRES[name] == FORMER[name]


@pytest.mark.parametrize(("name", "modulus"), [("amplatz", 9.5), ("stiff", 17.0)])
def test_stiff_wires_have_the_published_flexural_modulus(name: str, modulus: float) -> None:
    wire = load_guidewire(name)
    assert wire.shaft_stiffness_nmm2 == pytest.approx(
        1e3 * modulus * np.pi / 64 * (wire.diameter * 1e3) ** 4, rel=0.002
    )
    assert wire.torsional_stiffness(1.0) == pytest.approx(wire.stiffness(1.0) / 1.29, rel=0.003)


def test_wires_are_ordered_as_their_names_say() -> None:
    stiffness = [load_guidewire(name).stiffness(1.0) for name in ("floppy", "amplatz", "stiff")]
    assert stiffness == sorted(stiffness)


def test_the_thin_wire_is_the_usual_one_of_its_kind_in_another_size() -> None:
    thin, usual = load_guidewire("radifocus_angled_025"), load_guidewire("radifocus_angled")
    assert thin.diameter == pytest.approx(0.025 * 0.0254)
    scale = (thin.diameter / usual.diameter) ** 4
    for distance in (0.0, 0.04, 1.0):  # m from the tip
        assert thin.stiffness(distance) / usual.stiffness(distance) == pytest.approx(scale, rel=0.02)
    assert thin.torsional_stiffness(1.0) == pytest.approx(thin.stiffness(1.0) / 1.33, rel=0.003)
    assert (thin.tip_angle, thin.tip_length, thin.friction) == (usual.tip_angle, usual.tip_length, usual.friction)


@pytest.mark.parametrize("shape", SHAPES)
def test_sizes_differ_in_section_and_share_the_shape(shape: str) -> None:
    four, five, six = (load_catheter(shape, french=french) for french in (4, 5, 6))
    assert load_catheter(shape) == five == CATHETERS[f"{shape}_5f"] == load_catheter(f"{shape}_5f")
    assert four.shape == five.shape == six.shape
    for french, catheter in ((4, four), (5, five), (6, six)):
        assert catheter.outer_diameter == pytest.approx(french / 3 * 1e-3, abs=5e-6)
        # moduli over the wall's section are those of 5F
        section = np.pi / 64 * (catheter.outer_diameter**4 - catheter.inner_diameter**4) * 1e12
        assert catheter.shaft_stiffness_nmm2 / section == pytest.approx(1071, rel=0.01)
        assert catheter.tip_stiffness_nmm2 / section == pytest.approx(286, rel=0.01)
        assert catheter.torsional_stiffness_nmm2 / catheter.shaft_stiffness_nmm2 == pytest.approx(1.34, rel=0.01)
        hollow = (catheter.inner_diameter / catheter.outer_diameter) ** 2
        assert catheter.density == pytest.approx(1300 * (1 - hollow) + 1000 * hollow, rel=0.005)


def test_every_wire_passes_every_catheter() -> None:
    thickest = max(wire.diameter for wire in GUIDEWIRES.values())
    assert thickest < min(catheter.inner_diameter for catheter in CATHETERS.values())


def test_shapes_are_those_that_clinicians_know() -> None:
    assert tip_direction("straight") == 0
    assert 40 <= tip_direction("vertebral") <= 45
    assert load_catheter("vertebral").shape[0][1] <= 0.020
    for simmons in ("simmons1", "simmons2"):
        assert 120 < tip_direction(simmons) < 180  # the tip points back
    back1, _, width1 = limbs("simmons1")
    back2, top2, width2 = limbs("simmons2")
    assert back2 > 1.5 * back1 > 20  # the return limb of the second is longer
    assert back2 < top2
    assert width2 > 1.3 * width1
    # a bend forwards on a wide curve the other way; the JB2 is hooked more
    for name in ("headhunter", "jb2"):
        first, second = load_catheter(name).shape
        assert first[2] > 0 > second[2]
        assert second[1] - second[0] > 1.5 * (first[1] - first[0])
    assert tip_direction("jb2") > tip_direction("headhunter") > 0
    pigtail = load_catheter("pigtail")
    assert tip_direction("pigtail") > 300
    loop = pigtail.centreline(np.linspace(0.0, 0.034, 341)) * 1e3
    assert 8 < np.ptp(loop[:, 2]) + 1e3 * pigtail.outer_diameter < 15


def test_a_name_tells_the_shape_whatever_the_size() -> None:
    assert [catheter_shape(name) for name in ("jb2", "jb2_4f", "simmons2_6f")] == ["jb2", "jb2", "simmons2"]
    assert catheter_shape("mine/own_4f.yaml") == "mine/own_4f.yaml"
    with pytest.raises(ValueError, match="unknown catheter 'hook'"):
        catheter_shape("hook")


def test_a_preset_is_known_again() -> None:
    for name, catheter in CATHETERS.items():
        assert catheter_preset_of(catheter) == name.removesuffix("_5f")
    assert catheter_preset_of(load_catheter("jb2", friction=0.0123)) is None


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"name": "cobra"}, "unknown catheter 'cobra'; there are straight, vertebral.*, or a path of a .yaml file"),
        ({"name": "cobra_5f"}, "unknown catheter 'cobra_5f'"),
        ({"name": "default"}, "unknown catheter 'default'"),
        ({"name": "simmons2_9f"}, "'simmons2' is not made in 9F: it has 4F, 5F, 6F"),
        ({"name": "simmons2", "french": 9}, "'simmons2' is not made in 9F"),
        ({"name": "simmons2", "french": True}, "french must be a whole number, got True"),
        ({"name": "simmons2", "length": True}, "length must be a number .m., got True"),
        ({"name": "simmons2_6f", "french": 5}, "is of 6F, but french=5 is asked for"),
        ({"name": "simmons2", "stiffness": 3.0}, "a catheter has no stiffness; its parameters are outer_diameter"),
        ({"name": "simmons2", "inner_diameter": 2e-3}, "must be smaller than its outer one"),
        ({"name": "simmons2", "friction": np.nan}, "friction must be a finite number"),
    ],
)
def test_what_is_not_on_the_shelf_is_refused(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        load_catheter(**arguments)
    assert "\n" not in str(caught.value)
