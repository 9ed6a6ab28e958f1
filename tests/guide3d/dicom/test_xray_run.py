"""X-ray runs: pixels, order and geometry as written; damaged files; no word of the patient."""

import importlib.util
import logging
import traceback
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("pydicom", reason="the extra guide3d[dicom] is not installed")

import pydicom
from pydicom.data import get_testdata_file
from pydicom.pixels import apply_voi, apply_windowing
from pydicom.sequence import Sequence
from pydicom.uid import ExplicitVRBigEndian, ImplicitVRLittleEndian, JPEGBaseline8Bit, JPEGLosslessSV1, RLELossless

from guide3d.dicom.run_folder import read_xray
from guide3d.dicom.xray_run import XrayRun
from guide3d.opencv import cv2
from guide3d.reading.grey_image import _eight_bits
from tests.guide3d.dicom.lossless_jpeg import encode_lossless
from tests.guide3d.dicom.written_xray import ENHANCED_XA, PATIENT, enhanced_groups, frames_of, item, write, xray_dataset

LOSSLESS = importlib.util.find_spec("libjpeg") is not None


def run_of(folder: Path, frames: np.ndarray, bits: int = 8, **changed: Any) -> XrayRun:
    """A run that was written and read."""
    return read_xray(write(xray_dataset(frames, bits, **changed), folder / "run.dcm"))


def require(run: XrayRun, **expected: Any) -> None:
    """Fails where an attribute of a run is another one."""
    for name, value in expected.items():
        np.testing.assert_allclose(getattr(run, name), np.broadcast_to(value, np.shape(getattr(run, name))), rtol=1e-12)


@pytest.mark.parametrize("bits", [8, 10, 16])
@pytest.mark.parametrize("count", [1, 3])
def test_frames_come_back_as_stored(bits: int, count: int, tmp_path: Path) -> None:
    frames = frames_of(count, 23, 33, bits)
    changed = {"NumberOfFrames": None} if count == 1 else {}
    run = run_of(tmp_path, frames, bits, **changed)
    assert np.array_equal(run.frames, frames)
    assert run.frames.dtype == frames.dtype
    # without a window grey values are shown as those of other images, by their content if there are more than 255
    shown = frames if bits == 8 else _eight_bits(frames, [])
    assert np.abs(run.images().astype(int) - shown).max() <= 1
    assert [said.split(":")[0] for said in run.warnings] == (["it has no window"] if bits > 8 else [])
    assert len(run) == count


@pytest.mark.parametrize(
    "window",
    [
        {"WindowCenter": "500", "WindowWidth": "1"},
        {"WindowCenter": ["400", "9"], "WindowWidth": ["800", "3"]},
        {"WindowCenter": "500", "WindowWidth": "300", "VOILUTFunction": "LINEAR_EXACT"},
        {"WindowCenter": "500", "WindowWidth": "300", "VOILUTFunction": "SIGMOID"},
    ],
)
@pytest.mark.parametrize("inverse", [False, True])
def test_windows_are_those_of_pydicom(window: dict[str, Any], inverse: bool, tmp_path: Path) -> None:
    frames = frames_of(2, bits=10)
    kind = "MONOCHROME1" if inverse else "MONOCHROME2"
    dataset = xray_dataset(frames, 10, PhotometricInterpretation=kind, **window)
    run = read_xray(write(dataset, tmp_path / "run.dcm"))
    expected = apply_windowing(frames, dataset) / 1023
    assert np.array_equal(run.images(), np.rint(255 * (1 - expected if inverse else expected)).astype(np.uint8))


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize(("bits", "kind"), [(16, "OW"), (16, "US"), (12, "OW"), (8, "OW"), (8, "US"), (8, "packed")])
def test_tables_of_grey_values_go_before_the_window(bits: int, kind: str, big: bool, tmp_path: Path) -> None:
    frames = frames_of(1, bits=10)
    table = np.linspace(0, 2**bits - 1, 600).astype(np.uint16)
    words = table.astype(np.uint8).view("<u2") if kind == "packed" else table
    dataset = xray_dataset(frames, 10, WindowCenter="9", WindowWidth="2")
    entries = item(LUTDescriptor=[600, 100, bits])
    if kind == "US":
        entries.add_new("LUTData", "US", words.tolist())
    else:
        entries.add_new("LUTData", "OW", words.astype(">u2" if big else "<u2").tobytes())
    dataset.VOILUTSequence = [entries]
    if big:
        dataset.file_meta.TransferSyntaxUID = ExplicitVRBigEndian
        dataset.PixelData = frames.astype(">u2").tobytes()
    path = write(dataset, tmp_path / "run.dcm")
    expected = table[np.clip(frames.astype(int) - 100, 0, 599)]
    if bits > 8:
        assert np.array_equal(apply_voi(frames, pydicom.dcmread(path)), expected)
    assert np.array_equal(read_xray(path).images(), np.rint(255 * (expected / (2.0**bits - 1))).astype(np.uint8))


@pytest.mark.parametrize(
    ("timing", "expected"),
    [
        ({"FrameTime": "66.5"}, [0.0, 66.5, 133.0]),
        ({"FrameTimeVector": ["0", "60", "80"]}, [0.0, 60.0, 140.0]),
        ({"CineRate": "25"}, [0.0, 40.0, 80.0]),
        ({"RecommendedDisplayFrameRate": "10"}, [0.0, 100.0, 200.0]),
        ({}, None),
    ],
)
def test_times(timing: dict[str, Any], expected: list[float] | None, tmp_path: Path) -> None:
    run = run_of(tmp_path, frames_of(3), **timing)
    assert (run.times_ms is None) if expected is None else np.allclose(run.times_ms, expected)


def test_geometry_of_a_run_that_stands_still(tmp_path: Path) -> None:
    more = {
        "FieldOfViewShape": "ROUND",
        "FieldOfViewDimensions": ["229"],
        "TableHeight": "110",
        "PatientOrientation": ["L", "F"],
        "DetectorPrimaryAngle": "1.5",
    }
    run = run_of(tmp_path, frames_of(3), **more)
    require(run, primary_deg=30, secondary_deg=-20, source_detector_mm=1100, source_isocentre_mm=750, beam_tilt_deg=1.5)
    require(run, pixel_mm=[0.2, 0.4])  # x, y; DICOM has rows first
    assert (run.field_of_view_mm, run.field_of_view_shape) == ((229.0,), "ROUND")
    assert run.table_mm.shape == (3, 3)
    assert (run.table_mm[:, 0] == 110).all()
    assert run.orientation == ("L", "F")
    assert not run.moves
    assert not run.warnings


def test_one_increment_is_a_step_and_one_a_frame_are_offsets(tmp_path: Path) -> None:
    turning = {"PositionerPrimaryAngleIncrement": "1.5", "PositionerSecondaryAngleIncrement": ["0", "2", "5"],
               "TableLateralIncrement": ["0", "1", "4"]}  # fmt: skip
    run = run_of(tmp_path, frames_of(3), **turning)
    require(run, primary_deg=[30, 31.5, 33], secondary_deg=[-20, -18, -15])
    assert np.allclose(run.table_mm[:, 2], [0, 1, 4])
    assert run.moves
    alone = run_of(tmp_path, frames_of(1), PositionerPrimaryAngleIncrement="2", TableLateralIncrement="3")
    require(alone, primary_deg=30)
    assert np.allclose(alone.table_mm[:, 2], 0)
    with pytest.raises(ValueError, match=r"PositionerPrimaryAngleIncrement should have one value or one .* found 2"):
        run_of(tmp_path, frames_of(3), PositionerPrimaryAngleIncrement=["1", "2"])


def test_distances_and_spacing_follow_from_what_else_is_there(tmp_path: Path) -> None:
    less = {
        "DistanceSourceToPatient": None,
        "EstimatedRadiographicMagnificationFactor": "1.5",
        "ImagerPixelSpacing": None,
        "FieldOfViewDimensions": ["160", "120"],
        "BurnedInAnnotation": "YES",
    }
    run = run_of(tmp_path, frames_of(1, 24, 32), **less)
    require(run, source_isocentre_mm=1100 / 1.5, pixel_mm=5.0)
    assert all(word in " ".join(run.warnings) for word in ("magnification", "field of view", "name the patient"))


def test_enhanced_runs_say_it_frame_by_frame(tmp_path: Path) -> None:
    frames = frames_of(3)
    run = run_of(tmp_path, frames, kind=ENHANCED_XA, **enhanced_groups([0.0, 10.0, 20.0]))
    require(run, primary_deg=[0, 10, 20], secondary_deg=0, source_detector_mm=1100, source_isocentre_mm=750)
    require(run, pixel_mm=0.3, table_mm=[5, 1, 2], times_ms=[0, 50, 100])
    assert run.moves
    for k in range(3):  # each frame has its own window
        window = {"WindowCenter": 100 + 20 * k, "WindowWidth": 100, "BitsStored": 8, "PixelRepresentation": 0}
        shown = apply_windowing(frames[k], item(PhotometricInterpretation="MONOCHROME2", **window))
        assert np.array_equal(run.image(k), np.rint(shown).astype(np.uint8))


def test_damage_in_the_middle_of_a_jpeg_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("PIL", reason="pydicom decodes JPEG by Pillow")
    frames = frames_of(2, 96, 128)
    dataset = xray_dataset(frames)
    dataset.file_meta.TransferSyntaxUID = JPEGBaseline8Bit
    codes = [cv2.imencode(".jpg", frame)[1].tobytes() for frame in frames]
    dataset.PixelData = pydicom.encaps.encapsulate(codes)
    read = read_xray(write(dataset, tmp_path / "run.dcm")).frames
    assert np.abs(read.astype(float) - frames).mean() < 20
    dataset.PixelData = pydicom.encaps.encapsulate([codes[0], codes[1][:2000] + bytes(400) + codes[1][2400:]])
    with pytest.raises(ValueError, match=r"run\.dcm: the compressed pictures are damaged$"):
        read_xray(write(dataset, tmp_path / "run.dcm"))


def lossless_file(path: Path, frames: np.ndarray, bits: int) -> Path:
    dataset = xray_dataset(frames, bits)
    dataset.PixelData = pydicom.encaps.encapsulate([encode_lossless(frame, bits) for frame in frames])
    dataset["PixelData"].VR = "OB"
    dataset["PixelData"].is_undefined_length = True
    dataset.file_meta.TransferSyntaxUID = JPEGLosslessSV1
    return write(dataset, path)


@pytest.mark.skipif(not LOSSLESS, reason="the extra guide3d[lossless] is not installed")
@pytest.mark.parametrize(
    ("table", "fragments", "said"), [(True, 1, 3), (True, 3, None), (False, 3, 3), (False, 1, None), (True, 3, 2)]
)
def test_lossless_jpeg_in_pieces_with_and_without_a_table(
    table: bool, fragments: int, said: int | None, tmp_path: Path
) -> None:
    frames = frames_of(3, 40, 56, 12)
    path = lossless_file(tmp_path / "run.dcm", frames, 12)
    dataset = pydicom.dcmread(path)
    codes = [encode_lossless(frame, 12) for frame in frames]
    dataset.PixelData = pydicom.encaps.encapsulate(codes, fragments_per_frame=fragments, has_bot=table)
    dataset.NumberOfFrames = said
    write(dataset, path)
    if said in (3, None):
        assert np.array_equal(read_xray(path).frames, frames)
    else:
        with pytest.raises(ValueError, match=f"expected {said} compressed frames, found"):
            read_xray(path)
    dataset.PixelData = dataset.PixelData[:-40]
    dataset.NumberOfFrames = 3
    with pytest.raises(ValueError, match=r"compressed frames, found [012]: the file is cut off"):
        read_xray(write(dataset, path))


@pytest.mark.skipif(LOSSLESS, reason="the extra guide3d[lossless] is installed")
def test_lossless_jpeg_without_its_decoder_says_what_to_install(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"JPEG lossless.*pip install 'endonav-guide3d\[lossless\]'"):
        read_xray(lossless_file(tmp_path / "run.dcm", frames_of(2), 8))


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"kind": "1.2.840.10008.5.1.4.1.1.2"}, "expected an X-ray run .* found CT Image Storage"),
        ({"kind": "1.2.3.4"}, "found a file of another kind"),
        ({"SamplesPerPixel": 3}, "grey pictures, found colour"),
        ({"PixelRepresentation": 1}, "unsigned pixels .* signed"),
        ({"HighBit": 6}, "unsigned pixels .* the highest 6"),
        ({"BitsStored": None}, "does not say their size and bits"),
        ({"Rows": 25}, "damaged or truncated"),
        ({"Rows": 60000}, "up to 8192 px"),
        ({"NumberOfFrames": 2}, "expected 2 frames, found pixels of 3"),
        ({"FrameTime": "-5"}, "order of their times, found steps below 0 ms"),
        ({"FrameTimeVector": ["0", "5", "-5"]}, "order of their times, found steps below 0 ms"),
    ],
)
def test_files_of_another_kind_are_one_sentence(changed: dict[str, Any], said: str, tmp_path: Path) -> None:
    path = write(xray_dataset(frames_of(3), **changed), tmp_path / "run.dcm")
    with pytest.raises(ValueError, match=said) as raised:
        read_xray(path)
    assert "\n" not in str(raised.value)
    assert str(path) in str(raised.value)


@pytest.mark.parametrize("kind", ["run lengths", "deflated", "implicit", "big endian"])
def test_other_ways_of_writing(kind: str, tmp_path: Path) -> None:
    frames = frames_of(3, bits=10)
    dataset = xray_dataset(frames, 10)
    if kind == "run lengths":
        dataset.compress(RLELossless)
    else:
        syntax = {"deflated": ".1.99", "implicit": "", "big endian": ".2"}[kind]
        dataset.file_meta.TransferSyntaxUID = f"1.2.840.10008.1.2{syntax}"
    if kind == "big endian":
        dataset.PixelData = frames.byteswap().tobytes()
    assert np.array_equal(read_xray(write(dataset, tmp_path / "run.dcm")).frames, frames)


@pytest.mark.parametrize("meta", [True, False])
@pytest.mark.parametrize("implicit", [True, False])
def test_files_without_a_preamble_are_read(meta: bool, implicit: bool, tmp_path: Path) -> None:
    frames = frames_of(3)
    dataset = xray_dataset(frames, FrameTime="50")
    if implicit:
        dataset.file_meta.TransferSyntaxUID = ImplicitVRLittleEndian
    path = write(dataset, tmp_path / "run.dcm")
    if meta:
        path.write_bytes(path.read_bytes()[132:])
    else:
        pydicom.dcmwrite(path, item(**{e.keyword: e.value for e in dataset}), implicit_vr=implicit, little_endian=True)
    assert path.read_bytes()[128:132] != b"DICM"
    run = read_xray(path)
    assert np.array_equal(run.frames, frames)
    assert np.allclose(run.primary_deg, 30)


@pytest.mark.parametrize(
    ("changed", "said", "last_ms"),
    [
        ({"FrameTime": "0.04"}, "its FrameTime is 0.04 ms, which is taken as not known", None),
        ({"FrameTime": "1e30", "CineRate": "20"}, "its FrameTime is 1e+30 ms, which is taken as not known", 100),
        ({"FrameTime": "40", "CineRate": "15"}, "its FrameTime is 40 ms, but its CineRate 15 frames/s", 80),
        ({"FrameTime": "40", "FrameTimeVector": ["0", "30"]}, "its FrameTimeVector has 2 values for 3 frames", 80),
        ({"Modality": "CT"}, "its Modality is another one than XA or RF", None),
        ({"RescaleSlope": "-1", "RescaleIntercept": "255"}, "its RescaleSlope is below 0, which is not applied", None),
    ],
)
def test_what_contradicts_an_x_ray_run_is_said(changed: dict, said: str, last_ms: float | None, tmp_path: Path) -> None:
    run = run_of(tmp_path, frames_of(3), **changed)
    assert len(run.warnings) == 1
    assert run.warnings[0].startswith(said)
    assert run.times_ms is None if last_ms is None else run.times_ms[-1] == pytest.approx(last_ms)


def test_a_mask_is_not_subtracted_and_that_is_said(tmp_path: Path) -> None:
    frames = frames_of(3)
    mask = Sequence([item(MaskOperation="AVG_SUB", MaskFrameNumbers=[1, 2], ApplicableFrameRange=[1, 3])])
    run = run_of(tmp_path, frames, MaskSubtractionSequence=mask)
    assert np.array_equal(run.frames, frames)
    assert ["subtract a mask (frames 1, 2)" in said for said in run.warnings] == [True]
    unmasked = Sequence([item(MaskOperation="NONE")])
    for changed, notes in (({"MaskSubtractionSequence": unmasked}, 0), ({"RecommendedViewingMode": "SUB"}, 1)):
        assert len(run_of(tmp_path, frames, **changed).warnings) == notes


def test_damaged_files_are_refused_or_read_and_never_quote_the_patient(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]
) -> None:
    dataset = xray_dataset(frames_of(3, 16, 16), FrameTime="66.5", StudyDate="19440607")
    whole = write(dataset, tmp_path / "whole.dcm").read_bytes()
    generator = np.random.default_rng(0)
    cases = [whole[:length] for length in generator.integers(0, len(whole) - 1, 10).tolist()]
    for bit in generator.integers(0, 8 * (len(whole) - 3 * 256), 20).tolist():
        damaged = bytearray(whole)
        damaged[bit // 8] ^= 1 << bit % 8
        cases.append(bytes(damaged))
    sentences, shown = [], []
    with caplog.at_level(logging.DEBUG):
        for case in cases:
            (tmp_path / "run.dcm").write_bytes(case)
            try:
                shown.append(repr(read_xray(tmp_path / "run.dcm")))
            except ValueError as error:
                sentences.append(str(error))
                shown.append(traceback.format_exc())  # with the errors that it hides, were they not hidden
    assert len(sentences) > 10
    assert not [said for said in sentences if "\n" in said]
    out = capfd.readouterr()
    everything = "\n".join([*shown, caplog.text, out.out, out.err])
    assert not [secret for secret in (*PATIENT.values(), "Doe", "Jonathan", "774411") if secret in everything]


def test_a_name_where_a_number_belongs_is_not_quoted(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]
) -> None:
    for keyword in ("PositionerPrimaryAngle", "DistanceSourceToDetector", "NumberOfFrames", "WindowCenter"):
        dataset = xray_dataset(frames_of(3), WindowCenter="111111", WindowWidth="100", FrameTime="5")
        path = write(dataset, tmp_path / "run.dcm")
        tag = pydicom.tag.Tag(keyword)
        raw = path.read_bytes()
        at = raw.index(tag.group.to_bytes(2, "little") + tag.element.to_bytes(2, "little"))
        length = int.from_bytes(raw[at + 6 : at + 8], "little")
        raw = raw[: at + 8] + b"Jonathan"[:length].ljust(length) + raw[at + 8 + length :]
        path.write_bytes(raw)
        with caplog.at_level(logging.DEBUG), pytest.raises(ValueError, match=keyword) as raised:
            read_xray(path)
        out = capfd.readouterr()
        assert "Jo" not in str(raised.value) + caplog.text + out.out + out.err


def test_what_is_read_holds_no_attribute_of_the_patient(tmp_path: Path) -> None:
    from guide3d.dicom.header import Header

    path = write(xray_dataset(frames_of(1)), tmp_path / "run.dcm")
    assert "PatientName" in pydicom.dcmread(path)
    assert not [element.keyword for element in Header(path).dataset if element.tag.group == 0x0010]


def pydicom_file(name: str) -> str:
    """A file that comes with pydicom."""
    path = get_testdata_file(name, download=False)
    return path or pytest.skip(f"pydicom is installed without {name}")


@pytest.mark.parametrize(
    ("name", "said"), [("no_meta.dcm", "found something else"), ("DICOMDIR", "found Media Storage Directory Storage")]
)
def test_files_of_pydicom_are_refused_by_name(name: str, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        read_xray(pydicom_file(name))


@pytest.mark.parametrize("name", ["MR_small.dcm", "MR_small_RLE.dcm", "MR_small_bigendian.dcm"])
def test_pixels_of_pydicoms_files_are_decoded_as_an_x_ray_run(name: str, tmp_path: Path) -> None:
    dataset = pydicom.dcmread(pydicom_file(name))
    dataset.SOPClassUID = "1.2.840.10008.5.1.4.1.1.12.1"
    dataset.file_meta.MediaStorageSOPClassUID = dataset.SOPClassUID
    dataset.PixelRepresentation = 0  # its values are positive
    pydicom.dcmwrite(tmp_path / "run.dcm", dataset)
    assert np.array_equal(read_xray(tmp_path / "run.dcm").frames[0], pydicom.dcmread(pydicom_file(name)).pixel_array)
