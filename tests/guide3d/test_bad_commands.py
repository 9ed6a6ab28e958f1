"""Command lines: whatever is wrong with files, folders and numbers is one sentence and a non-zero exit."""

import logging
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from guide3d import train
from guide3d.dataset.dataset import Dataset
from guide3d.dataset.frame import ImageError, read_image
from guide3d.image_file import write_png
from tests.guide3d.learning.drawn_data import draw

SMOKE = ("--network", "unet", "--size", "smoke", "--device", "cpu")


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    draw(folder)
    (folder / "file").write_text("no folder")
    return folder


@pytest.mark.parametrize(
    "words",
    [
        ("{data}/none", "--output", "{out}"),
        ("{data}/file", "--output", "{out}"),
        ("{data}", "--output", "{data}/file"),
        ("{data}", "--output", "{out}/" + 300 * "n"),
        ("{data}", "--output", "{out}", "--epochs", "0"),
        ("{data}", "--output", "{out}", "--pictures", "{data}/file"),
        ("{data}", "--output", "{out}", "--images", "{data}/none"),
        ("{data}", "--output", "{out}", "--calibration", "{data}/file"),
        ("{data}", "--output", "{out}", "--curves", "{data}/file", "--network", "fgrn"),
        ("{data}", "--output", "{out}", "--pretrained", "{data}/file", "--network", "spherical"),
        ("{data}", "--output", "{out}", "--pretrained", "{data}", "--network", "spherical"),
    ],
)
def test_training_refuses_with_one_sentence(
    words: tuple[str, ...], data: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    given = [word.format(data=data, out=tmp_path) for word in words]
    with caplog.at_level(logging.ERROR):
        assert train.main([given[0], *SMOKE, *given[1:]]) == 2
    said = [record.getMessage() for record in caplog.records if record.levelno >= logging.ERROR]
    assert len(said) == 1
    assert "\n" not in said[0]


@pytest.mark.parametrize("name", ["raw.json", "dataset.json", "truth.json"])
@pytest.mark.parametrize("text", ["", "[" * 100_000, "[]", "\x00"])
def test_files_of_a_data_set_that_are_none_are_refused(name: str, text: str, data: Path) -> None:
    whole = (data / name).read_text()
    (data / name).write_text(text)
    try:
        with pytest.raises(ValueError, match=f"{name}|holds no frame that can be used"):
            Dataset.open(data)
    finally:
        (data / name).write_text(whole)


def test_damaged_pictures_are_refused_or_read(data: Path, tmp_path: Path) -> None:
    whole = next((data / "images").rglob("*.png")).read_bytes()
    generator = np.random.default_rng(0)
    refused = 0
    for bit in generator.integers(0, 8 * len(whole), 60).tolist():
        damaged = bytearray(whole)
        damaged[bit // 8] ^= 1 << bit % 8
        (tmp_path / "picture.png").write_bytes(damaged)
        try:
            read_image(tmp_path / "picture.png")
        except ImageError:
            refused += 1
    assert refused > 20


@pytest.mark.skipif(sys.platform == "win32", reason="it has no limit of a file's size")
def test_a_full_disk_is_one_sentence_with_the_file_and_leaves_no_part(tmp_path: Path) -> None:
    image = tmp_path / "image.png"
    write_png(np.tile(np.arange(256, dtype=np.uint8), (256, 1)), image)
    code = (
        "import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (8, 8))\n"
        "from guide3d.image_file import write_png; from guide3d.commands import in_words; import numpy as np\n"
        "try:\n    write_png(np.zeros((64, 64), np.uint8), sys.argv[1])\n"
        "except OSError as error:\n    sys.exit(in_words(error))"
    )
    command = [sys.executable, "-c", code, str(tmp_path / "new.png")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (1, f"{tmp_path / 'new.png'}: File too large\n")
    assert [path.name for path in tmp_path.iterdir()] == ["image.png"]
