"""The picture of the devices, and the command that lists and draws them."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from cathsim.devices.__main__ import main
from cathsim.devices.picture import draw_devices, drawn_shape
from cathsim.devices.shelf import SHAPES, load_catheter
from cathsim.guidewire import GUIDEWIRES, load_guidewire

pytest.importorskip("matplotlib")


def test_shapes_are_drawn_in_millimetres_of_arc() -> None:
    line = drawn_shape(load_catheter("simmons2"))
    np.testing.assert_allclose(np.linalg.norm(np.diff(line, axis=0), axis=1), 2.5e-4)
    np.testing.assert_allclose(line[-1], 0, atol=1e-12)
    hook = drawn_shape(load_guidewire("default"))
    assert hook[0, 0] > 0.01  # a positive bend to the right
    assert np.all(drawn_shape(load_catheter("straight"))[:, 0] == 0)


def test_bands_have_the_devices_true_width_on_one_scale() -> None:
    axes = draw_devices({"thin": load_guidewire("default"), "6F": load_catheter("straight_6f")}).axes[0]
    assert axes.get_aspect() == 1
    widths = [np.ptp(np.asarray(patch.get_xy())[:, 0]) for patch in axes.patches]
    assert widths[1:3] == pytest.approx([2.00, 1.40])
    first = np.asarray(axes.patches[0].get_xy())
    half = len(first) // 2
    across = np.linalg.norm(first[:half] - first[half : 2 * half][::-1], axis=1)
    np.testing.assert_allclose(across, 0.89, rtol=1e-6)


def test_the_command_lists_and_draws_all_devices(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / "new" / "shelf.png"
    assert main(["--output", str(output), "--sources"]) == 0
    assert output.read_bytes().startswith(b"\x89PNG")
    listed = capsys.readouterr().out
    for name in (*GUIDEWIRES, *SHAPES):
        assert re.search(rf"^{name} ", listed, re.MULTILINE)
    assert "10.1583/11-3592.1" in listed


def test_the_command_takes_names_sizes_and_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    wire, catheter = tmp_path / "wire.yaml", tmp_path / "catheter.yml"
    wire.write_text("kind: guidewire\ndiameter_mm: 0.97\n", encoding="utf-8")
    catheter.write_text("kind: catheter\nbased_on: jb2\n", encoding="utf-8")
    assert main(["jb2", str(wire), str(catheter), "--french", "6"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[1] for line in lines[1:]] == ["2.00", "0.97", "2.00"]


@pytest.mark.parametrize("arguments", [["cobra"], ["no.yaml"], ["jb2", "--french", "9"], ["jb2", "--output", "x.abc"]])
def test_the_command_refuses_in_one_sentence(
    arguments: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    said = capsys.readouterr().err
    assert said.startswith("error: ")
    assert said.count("\n") == 1
