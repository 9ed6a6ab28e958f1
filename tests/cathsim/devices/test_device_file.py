"""Devices: files of one's own, the shelf, sizes, pictures; the catheter's stiffness and shape."""

import os
import re
from dataclasses import fields
from pathlib import Path

import mujoco
import numpy as np
import pytest

from cathsim.devices.__main__ import main
from cathsim.devices.catheter import Catheter
from cathsim.devices.device_file import CATHETER, GUIDEWIRE, KEYS, LARGEST, file_kind, read_device
from cathsim.devices.shelf import CATHETERS, SHAPES, load_catheter
from cathsim.guidewire import GUIDEWIRES, TIP_SITE, Guidewire, load_guidewire


def written(folder: Path, text: str) -> Path:
    path = folder / "my.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_keys_name_every_field() -> None:
    for kind, settings in ((GUIDEWIRE, Guidewire), (CATHETER, Catheter)):
        assert sorted(KEYS[kind].values()) == sorted(one.name for one in fields(settings))


@pytest.mark.parametrize(("text", "metres"), [("0.89", 0.89e-3), ("3", 0.003), ("1.27e-1", 1.27e-4)])
def test_lengths_in_mm_are_the_numbers_in_m(text: str, metres: float, tmp_path: Path) -> None:
    path = written(tmp_path, f"kind: guidewire\ndiameter_mm: {text}\n")
    assert read_device(path, GUIDEWIRE).fields["diameter"] == metres


def test_a_device_based_on_a_preset_keeps_the_rest_of_it(tmp_path: Path) -> None:
    path = written(tmp_path, "kind: catheter\nbased_on: simmons2\nfriction: 0.1\nsource: {friction: mine}\n")
    for french in (4, 5, 6):
        assert load_catheter(path, french=french) == load_catheter("simmons2", french=french, friction=0.1)
    assert load_catheter(path) == load_catheter("simmons2", friction=0.1)
    file = read_device(path, CATHETER)
    assert file.source["friction"] == "mine"
    assert "Simmons" in file.source["shape"]


def test_own_sizes_replace_those_of_the_preset_and_own_values_hold_in_all(tmp_path: Path) -> None:
    text = """
kind: catheter
based_on: straight
sizes_french:
  5: {outer_diameter_mm: 1.7, friction: 0.09}
  7: {outer_diameter_mm: 2.3, inner_diameter_mm: 1.6}
default_french: 7
length_mm: 650
"""
    path = written(tmp_path, text)
    assert load_catheter(path).outer_diameter == 0.0023
    five = load_catheter(path, french=5)
    assert (five.outer_diameter, five.friction, five.length) == (0.0017, 0.09, 0.65)
    with pytest.raises(ValueError, match=r"shape\[0\]\[2\] must lie in .* rad, got 90; angles are in radians"):
        load_catheter("vertebral", shape=((0, 0.02, 90, 0),))
    with pytest.raises(ValueError, match="not made in 6F: it has 5F, 7F"):
        load_catheter(path, french=6)
    with pytest.raises(ValueError, match="french must be a whole number, got '5'"):
        load_catheter(path, french="5")  # type: ignore[arg-type]


def test_a_wire_of_ones_own_is_loaded(tmp_path: Path) -> None:
    text = "kind: guidewire\nbased_on: amplatz\nlinks: [{count: 40, length_mm: 5}]\nworking_length_mm: 1800\n"
    wire = load_guidewire(written(tmp_path, text), friction=0.2)
    assert (wire.links, wire.working_length, wire.friction) == ((0.005,) * 40, 1.8, 0.2)
    assert wire.shaft_stiffness_nmm2 == load_guidewire("amplatz").shaft_stiffness_nmm2
    assert file_kind(tmp_path / "my.yaml") == GUIDEWIRE


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("diameter_mm: 35", "diameter_mm must be from 0.1 to 5, got 35"),
        ("shaft_stiffness_nmm2: 1e9", "shaft_stiffness_nmm2 must be from 0.001 to 1e+06, got 1000000000.0"),
        ("tip_stiffness_nmm2: 9000", "tip_stiffness_nmm2 must be at most 10 times shaft_stiffness_nmm2, 400, got 9000"),
        ("tip_angle_deg: 400", "tip_angle_deg must be from -360 to 360, got 400"),
        ("tip_length_mm: 500", "tip_length_mm must be at most the length of the links, 264, got 500"),
    ],
)
def test_what_no_device_has_is_refused_in_the_units_of_the_file(text: str, message: str, tmp_path: Path) -> None:
    path = written(tmp_path, f"kind: guidewire\nbased_on: default\n{text}\n")
    with pytest.raises(ValueError, match=re.escape(f"{path}: {message}")):
        load_guidewire(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("kind: catheter\nlenght_mm: 900\n", "has no 'lenght_mm'; its keys are .*length_mm"),
        ("kind: guidewire\n", "describes a guidewire, but a catheter is expected"),
        ("kind: stent\n", "must say 'kind: guidewire' or 'kind: catheter', got 'stent'"),
        ("", "must hold keys and values"),
        ("kind: [catheter\n", "is no YAML file"),
        ("kind: catheter\nlength: !!python/object/apply:os.getcwd []\n", "is no YAML file"),
        ("kind: catheter\nouter_diameter_mm: .nan\n", "outer_diameter_mm must be a finite number, got nan"),
        ("kind: catheter\nfriction: low\n", "friction must be a number, got 'low'"),
        ("kind: catheter\ntaper_mm: 10\n", "taper_mm must be a list, got 10"),
        ("kind: catheter\ntaper_mm: [10, 20, 30]\n", "taper_mm has 3 entries, 2 at most"),
        ("kind: catheter\nfriction: 0x" + "f" * 9000 + "\n", "friction must be a finite number, got inf"),
        ("kind: catheter\ndescription: 0x" + "f" * 9000 + "\n", "description must be a text, got a long number"),
        ("kind: catheter\nfriction: " + "x" * 9000 + "\n", "friction must be a number, got 'xxx"),
        ("kind: catheter\nshape: [{from_mm: 0, to_mm: 10, angle_deg: 9, radius_mm: 3}]\n", "a bend is given as"),
        ("kind: catheter\nshape: [{from_mm: 0, to_mm: 2, angle_deg: 90}]\n", "has a radius of"),
        ("kind: catheter\nbased_on: simmons9\n", "based_on must be a preset of a catheter, .*simmons1.*'simmons9'"),
        ("kind: catheter\nsource: {shape: 3}\n", "the source of shape must be a text, got 3"),
        ("kind: catheter\nsizes_french: {5: {size_mm: 3}}\ndefault_french: 5\n", "a catheter's size has no 'size_mm'"),
        ("kind: catheter\nsizes_french: {5: {friction: 0.1}}\n", "default_french must be one of its sizes, 5"),
        ("kind: catheter\nsizes_french: {5F: {friction: 0.1}}\n", "whole number of French, 1 to 34, got '5F'"),
        ("kind: catheter\nfriction: 0.1\nfriction: 0.2\n", "the key 'friction' is there twice"),
        ("kind: catheter\nshape: [{from_mm: 0, to_mm: 9, to_mm: 10, angle_deg: 9}]\n", "'to_mm' is there twice"),
        ("kind: catheter\nsource: &a {shape: *a}\n", "the source of shape must be a text"),
        ("kind: guidewire\nsizes_french: {5: {friction: 0.1}}\n", "a guidewire has no 'sizes_french'"),
        ("kind: guidewire\nlinks: [16, 16]\n", "links are given as {count: 10, length_mm: 16}"),
        ("kind: guidewire\nlinks: [{count: 1.5, length_mm: 16}]\n", "count of links must be a whole number"),
        ("kind: guidewire\nlinks: [{count: 1500, length_mm: 1}, {count: 1500, length_mm: 1}]\n", "2000 links, got"),
    ],
)
def test_what_is_no_device_is_refused_in_one_sentence(text: str, message: str, tmp_path: Path) -> None:
    path = written(tmp_path, text)
    load = load_guidewire if "guidewire has" in message or "links" in message else load_catheter
    with pytest.raises(ValueError, match=message) as caught:
        load(path)
    sentence = str(caught.value)
    assert "\n" not in sentence
    assert len(sentence) < 800


def test_files_that_cannot_be_read_are_named(tmp_path: Path) -> None:
    for load in (load_catheter, load_guidewire):
        with pytest.raises(ValueError, match=r"there is no device's file .*missing.yaml"):
            load(str(tmp_path / "missing.yaml"))
    os.mkfifo(tmp_path / "pipe.yaml")
    (tmp_path / "folder.yaml").mkdir()
    (tmp_path / "bytes.yaml").write_bytes(b"kind: \xff\xfe\x00")
    (tmp_path / "large.yaml").write_text("#" * (LARGEST + 1), encoding="utf-8")
    (tmp_path / "deep.yaml").write_text("[" * 15_000, encoding="utf-8")
    for name, reason in (
        ("pipe", "is no regular file"),
        ("folder", "cannot be read: Is a directory"),
        ("bytes", "is no YAML file"),
        ("large", "has more than 20000 bytes"),
        ("deep", "is no YAML file: RecursionError"),
    ):
        with pytest.raises(ValueError, match=rf"{name}\.yaml.* {reason}"):
            load_catheter(tmp_path / f"{name}.yaml")


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


def test_former_wires_have_the_same_numbers() -> None:
    assert {name: GUIDEWIRES[name] for name in FORMER} == FORMER


@pytest.mark.parametrize(("name", "modulus"), [("amplatz", 9.5), ("stiff", 17.0)])
def test_stiff_wires_have_the_published_flexural_modulus(name: str, modulus: float) -> None:
    wire = load_guidewire(name)
    assert wire.shaft_stiffness_nmm2 == pytest.approx(
        1e3 * modulus * np.pi / 64 * (wire.diameter * 1e3) ** 4, rel=0.002
    )
    assert wire.torsional_stiffness(1.0) == pytest.approx(wire.stiffness(1.0) / 1.29, rel=0.003)


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


def test_the_command_lists_and_draws_all_devices(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("matplotlib")
    output = tmp_path / "new" / "shelf.png"
    assert main(["--output", str(output), "--sources"]) == 0
    assert output.read_bytes().startswith(b"\x89PNG")
    listed = capsys.readouterr().out
    for name in (*GUIDEWIRES, *SHAPES):
        assert re.search(rf"^{name} ", listed, re.MULTILINE)
    assert "10.1583/11-3592.1" in listed


def test_the_command_takes_names_sizes_and_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("matplotlib")
    wire, catheter = tmp_path / "wire.yaml", tmp_path / "catheter.yml"
    wire.write_text("kind: guidewire\ndiameter_mm: 0.97\n", encoding="utf-8")
    catheter.write_text("kind: catheter\nbased_on: jb2\n", encoding="utf-8")
    assert main(["jb2", str(wire), str(catheter), "--french", "6"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[1] for line in lines[1:]] == ["2.00", "0.97", "2.00"]


def test_the_command_refuses_in_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for arguments in (["cobra"], ["jb2", "--french", "9"], ["jb2", "--output", str(tmp_path / "x.abc")]):
        assert main(arguments) == 2
        said = capsys.readouterr().err
        assert said.startswith("error: ")
        assert said.count("\n") == 1


@pytest.mark.parametrize("kind", [Catheter, Guidewire])
def test_stiffness_is_that_of_tip_and_shaft_and_geometric_between(kind: type[Catheter] | type[Guidewire]) -> None:
    tapered = {"shaft_stiffness_nmm2": 300.0, "tip_stiffness_nmm2": 75.0, "taper": (0.01, 0.04)}
    device = kind(**tapered, torsional_stiffness_nmm2=90.0)
    places = np.array([0.0, 0.01, 0.025, 0.04, 0.9])
    np.testing.assert_allclose(device.stiffness(places) * 1e6, [75, 75, 150, 300, 300])
    assert type(device.stiffness(0.025)) is float
    np.testing.assert_allclose(device.torsional_stiffness(places), 0.3 * device.stiffness(places))


def test_centreline_of_a_bend_agrees_with_the_guidewires_hinges() -> None:
    """The angle that turns a guidewire's tip turns a catheter's in the same direction, also about y."""
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    wire = Guidewire(links=(0.002,) * 30, tip_angle=np.radians(60.0), tip_length=0.02)
    wire.add_to(spec.worldbody.add_body(name="clamp"), clamped=True)
    model = spec.compile()
    data = mujoco.MjData(model)
    for part, plane in (("x", 0.0), ("y", np.pi / 2)):
        data.qpos[:] = 0
        for joint in range(model.njnt):
            if model.joint(joint).name.endswith(part):
                data.qpos[joint] = model.qpos_spring[joint if part == "x" else joint - 1]
        mujoco.mj_kinematics(model, data)
        catheter = Catheter(length=0.06, shape=((0.001, 0.021, np.radians(60.0), plane),))
        tip = catheter.centreline(np.linspace(0.0, 0.06, 601))[0]
        np.testing.assert_allclose(data.site(TIP_SITE).xpos, tip, atol=4e-4)
