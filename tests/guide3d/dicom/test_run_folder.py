"""Folders of X-ray frames: which belong together, in which order, and what is said of the others."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("pydicom", reason="the extra guide3d[dicom] is not installed")

from guide3d.dicom.__main__ import main
from guide3d.dicom.run_folder import read_xray
from guide3d.dicom.xray_run import XrayRun
from tests.guide3d.dicom.written_xray import frames_of, write, xray_dataset

FRAMES = frames_of(12)
CT = "1.2.840.10008.5.1.4.1.1.2"


def write_frames(folder: Path, changes: list[dict[str, Any]], series: str = "1.2.3", number: str = "3") -> None:
    """One file a frame, named by its place in `changes`."""
    folder.mkdir(exist_ok=True)
    for place, changed in enumerate(changes):
        frame = FRAMES[place % len(FRAMES)][None]
        values = {"NumberOfFrames": None, "SeriesInstanceUID": series, "SeriesNumber": number, **changed}
        write(xray_dataset(frame, **values), folder / f"IM{number}_{place}")


def places_of(run: XrayRun) -> list[int]:
    """Which of the written frames each frame is."""
    return [int(np.flatnonzero((frame == FRAMES).all(axis=(1, 2)))[0]) for frame in run.frames]


def test_instance_numbers_give_the_order(tmp_path: Path) -> None:
    numbers = np.random.default_rng(0).permutation(12).tolist()
    changes = [
        {"InstanceNumber": str(n + 1), "AcquisitionDate": "20260102", "AcquisitionTime": f"1201{n:02d}.5",
         "PositionerPrimaryAngle": str(10 + n)}
        for n in numbers
    ]  # fmt: skip
    write_frames(tmp_path / "run", changes)
    (tmp_path / "run" / ".hidden").write_bytes(b"x")
    (tmp_path / "run" / "DICOMDIR").write_bytes(b"x")
    run = read_xray(tmp_path / "run")
    assert places_of(run) == np.argsort(numbers).tolist()
    assert np.allclose(run.times_ms, 1000.0 * np.arange(12))
    assert np.allclose(run.primary_deg, 10 + np.arange(12))
    assert run.pixel_mm.shape == (12, 2)
    assert run.moves
    assert not run.warnings
    assert main([str(tmp_path / "run"), "--output", str(tmp_path / "out"), "--frame", "3"]) == 0
    assert (tmp_path / "out" / "a" / "003.png").is_file()


@pytest.mark.parametrize(
    ("changes", "places", "said"),
    [
        ([{"AcquisitionTime": t} for t in ("120003", "120001", "120002.5")], [1, 2, 0], ["ordered by time"]),
        ([{"ContentTime": t, "InstanceNumber": "1"} for t in ("", "120001")], [0, 1], ["ordered by name"]),
        ([{"AcquisitionDateTime": f"2026010212000{t}", "InstanceNumber": "1"} for t in (2, 1)], [1, 0], ["by time"]),
        ([{}] * 12, list(range(12)), ["ordered by name"]),
        (
            [{"InstanceNumber": n, "AcquisitionTime": t} for n, t in (("1", "120002"), ("2", "120001"))],
            [0, 1],
            ["another order by time"],
        ),
        ([{"InstanceNumber": n} for n in ("1", "2", "5")], [0, 1, 2], ["2 instance numbers"]),
        ([{"InstanceNumber": "7"}], [0], []),
        ([{"InstanceNumber": n, "FrameTime": "0.05"} for n in ("1", "2")], [0, 1], ["FrameTime is 0.05 ms, which"]),
    ],
)
def test_other_orders_are_said(
    changes: list[dict[str, Any]], places: list[int], said: list[str], tmp_path: Path
) -> None:
    write_frames(tmp_path, changes)
    run = read_xray(tmp_path)
    assert places_of(run) == places
    assert len(run.warnings) == len(said)
    assert all(part in whole for part, whole in zip(said, run.warnings, strict=True))


def test_what_is_no_x_ray_is_left_out_and_said(tmp_path: Path) -> None:
    write_frames(tmp_path, [{"InstanceNumber": str(k)} for k in range(3)])
    (tmp_path / "notes.txt").write_text("x")
    write(xray_dataset(FRAMES[:1], kind=CT), tmp_path / "ct.dcm")
    run = read_xray(tmp_path)
    assert len(run) == 3
    assert run.warnings == ("2 files that are no X-ray images were left out: ct.dcm, notes.txt",)


def test_what_does_not_go_together_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="holds no X-ray files"):
        read_xray(tmp_path)
    write_frames(tmp_path / "series", [{}] * 5)
    write_frames(tmp_path / "series", [{}] * 2, "1.2.4", "8")
    said = (
        r"holds 2 series: number 3 with 5 files \(IM3_0, IM3_1, IM3_2, and 2 more\); "
        r"number 8 with 2 files \(IM8_0, IM8_1\)"
    )
    with pytest.raises(ValueError, match=said):
        read_xray(tmp_path / "series")
    write_frames(tmp_path / "sizes", [{"InstanceNumber": "1"}])
    write(xray_dataset(FRAMES[:1, :16, :20], SeriesInstanceUID="1.2.3"), tmp_path / "sizes" / "small")
    with pytest.raises(ValueError, match=r"several sizes or bits \(20 x 16 px, 32 x 24 px\)"):
        read_xray(tmp_path / "sizes")
    write_frames(tmp_path / "runs", [{}])
    write(xray_dataset(FRAMES, SeriesInstanceUID="1.2.3"), tmp_path / "runs" / "run.dcm")
    with pytest.raises(ValueError, match=r"files of several frames \(run.dcm\): give one of them"):
        read_xray(tmp_path / "runs")
