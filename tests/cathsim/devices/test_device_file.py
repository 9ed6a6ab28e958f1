"""Devices in YAML files: units, inheritance, sizes, and one sentence for what cannot be read."""

from __future__ import annotations

import os
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from cathsim.devices.catheter import Catheter
from cathsim.devices.device_file import CATHETER, GUIDEWIRE, KEYS, LARGEST, file_kind, read_device
from cathsim.devices.shelf import load_catheter
from cathsim.guidewire import Guidewire, load_guidewire


def written(folder: Path, text: str) -> Path:
    path = folder / "my.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_keys_name_every_field() -> None:
    for kind, settings in ((GUIDEWIRE, Guidewire), (CATHETER, Catheter)):
        assert sorted(KEYS[kind].values()) == sorted(one.name for one in fields(settings))


@pytest.mark.parametrize(
    ("text", "metres"), [("0.89", 0.89e-3), ("1.67", 1.67e-3), ("3", 0.003), ("0.1", 0.0001), ("1.27e-1", 1.27e-4)]
)
def test_lengths_in_mm_are_the_numbers_in_m(text: str, metres: float, tmp_path: Path) -> None:
    path = written(tmp_path, f"kind: guidewire\ndiameter_mm: {text}\n")
    assert read_device(path, GUIDEWIRE).fields["diameter"] == metres


def test_angles_in_degrees_are_numpys_radians(tmp_path: Path) -> None:
    path = written(tmp_path, "kind: catheter\nshape:\n - {from_mm: 1, to_mm: 20, angle_deg: 45, plane_deg: 90}\n")
    assert read_device(path, CATHETER).fields["shape"] == ((0.001, 0.02, np.radians(45.0), np.radians(90.0)),)
    assert load_catheter(path) == Catheter(shape=((0.001, 0.02, np.radians(45.0), np.radians(90.0)),))


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
        ("kind: catheter\nlenght_mm: 900\n", "has no 'lenght_mm'; its keys are .*length_mm"),
        ("kind: catheter\ndiameter_mm: 900\n", "a catheter has no 'diameter_mm'"),
        ("kind: guidewire\n", "describes a guidewire, but a catheter is expected"),
        ("kind: stent\n", "must say 'kind: guidewire' or 'kind: catheter', got 'stent'"),
        ("outer_diameter_mm: 1.67\n", "must say 'kind: guidewire' or 'kind: catheter', got None"),
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
        ("kind: catheter\nouter_diameter_mm: 1.67e6\n", "outer_diameter must lie in 0 .* m, got 1670.0"),
        ("kind: catheter\nlength_mm: 1" + "0" * 400 + "\n", "length_mm must be a finite number, got inf"),
        ("kind: catheter\nbased_on: simmons9\n", "based_on must be a preset of a catheter, .*simmons1.*'simmons9'"),
        ("kind: catheter\nsource: {shape: 3}\n", "the source of shape must be a text, got 3"),
        ("kind: catheter\nsizes_french: {5: {size_mm: 3}}\ndefault_french: 5\n", "a catheter's size has no 'size_mm'"),
        (
            "kind: catheter\nsizes_french: {5: {friction: 0.1}}\n",
            "default_french must be one of its sizes, 5, got None",
        ),
        ("kind: catheter\nsizes_french: {5F: {friction: 0.1}}\n", "whole number of French, 1 to 34, got '5F'"),
        ("kind: catheter\nfriction: 0.1\nfriction: 0.2\n", "the key 'friction' is there twice"),
        ("kind: catheter\nshape: [{from_mm: 0, to_mm: 9, to_mm: 10, angle_deg: 9}]\n", "'to_mm' is there twice"),
        ("kind: catheter\nsource: &a {shape: *a}\n", "the source of shape must be a text"),
    ],
)
def test_what_is_no_catheter_is_refused_in_one_sentence(text: str, message: str, tmp_path: Path) -> None:
    path = written(tmp_path, text)
    with pytest.raises(ValueError, match=message) as caught:
        load_catheter(path)
    sentence = str(caught.value)
    assert "\n" not in sentence
    assert sentence.count(str(path)) == 1
    assert len(sentence) < 800


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("kind: catheter\n", "describes a catheter, but a guidewire is expected"),
        ("kind: guidewire\nsizes_french: {5: {friction: 0.1}}\n", "a guidewire has no 'sizes_french'"),
        ("kind: guidewire\nlinks: [16, 16]\n", "links are given as {count: 10, length_mm: 16}"),
        ("kind: guidewire\nlinks: [{count: 1.5, length_mm: 16}]\n", "count of links must be a whole number"),
        (
            "kind: guidewire\nlinks: [{count: 1500, length_mm: 1}, {count: 1500, length_mm: 1}]\n",
            "2000 links, got 3000",
        ),
    ],
)
def test_what_is_no_guidewire_is_refused_in_one_sentence(text: str, message: str, tmp_path: Path) -> None:
    path = written(tmp_path, text)
    with pytest.raises(ValueError, match=message) as caught:
        load_guidewire(path)
    assert "\n" not in str(caught.value)


def test_files_that_cannot_be_read_are_named(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"there is no device's file .*missing.yaml"):
        load_catheter(tmp_path / "missing.yaml")
    with pytest.raises(ValueError, match=r"there is no device's file .*missing.yaml"):
        load_guidewire(str(tmp_path / "missing.yaml"))
    os.mkfifo(tmp_path / "pipe.yaml")
    with pytest.raises(ValueError, match=r"pipe\.yaml is no regular file"):
        load_catheter(tmp_path / "pipe.yaml")
    (tmp_path / "folder.yaml").mkdir()
    with pytest.raises(ValueError, match="cannot be read: Is a directory"):
        load_catheter(tmp_path / "folder.yaml")
    (tmp_path / "bytes.yaml").write_bytes(b"kind: \xff\xfe\x00")
    with pytest.raises(ValueError, match="is no YAML file"):
        load_catheter(tmp_path / "bytes.yaml")
    (tmp_path / "large.yaml").write_text("#" * (LARGEST + 1), encoding="utf-8")
    with pytest.raises(ValueError, match="has more than 20000 bytes"):
        load_catheter(tmp_path / "large.yaml")
    (tmp_path / "deep.yaml").write_text("[" * 15_000, encoding="utf-8")
    with pytest.raises(ValueError, match=r"deep\.yaml is no YAML file: RecursionError"):
        load_catheter(tmp_path / "deep.yaml")
