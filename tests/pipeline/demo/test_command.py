"""The demo's command: an episode with film, log and page; bad arguments and files are refused in one sentence."""

from pathlib import Path

import imageio_ffmpeg
import pytest
from PIL import Image

from cathsim import load_phantom
from enn import retrying
from pipeline.demo.__main__ import EXIT_USAGE, GIF, LOG, MP4, main
from pipeline.demo.film import TITLE_PX, VIEW_PX
from pipeline.episodes import EpisodeReader
from tests.pipeline.demo.small_policies import TASK_OF_DEMO, ship


@pytest.fixture(autouse=True)
def shipped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    return ship(tmp_path / "shipped", monkeypatch)


def one_sentence(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert main(arguments) == EXIT_USAGE
    (line,) = capsys.readouterr().err.splitlines()
    return line


def test_two_attempts_leave_log_films_and_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(retrying, "_BACK", 9)  # steps in which a wire that has not arrived is drawn back
    folder = tmp_path / "demo"
    assert main(("--output", str(folder), "--seed", "3", "--attempts", "2")) == 0
    printed = capsys.readouterr().out
    assert "the navigator steers to the BCA of random arch 40003" in printed
    assert "did not reach the target at attempt 2 in 2.3 s" in printed
    assert printed.endswith(f"open {folder / 'index.html'}\n")
    with EpisodeReader(folder / LOG) as episode:
        assert episode.outcome.steps == 2 * TASK_OF_DEMO.max_steps + 9
        assert episode.info.phantom == "random_40003"
    width, height = next(imageio_ffmpeg.read_frames(str(folder / MP4)))["size"]
    assert height == VIEW_PX + TITLE_PX
    assert width >= 2 * VIEW_PX
    with Image.open(folder / GIF) as gif:
        assert gif.n_frames >= 2
    page = (folder / "index.html").read_text(encoding="utf-8")
    assert page.index("film.mp4") < page.index("<h1>")
    for words in ("Not reached", "The image alone.", LOG, 'poster="film.gif"'):
        assert words in page


def test_a_surface_of_ones_own_and_the_roadmap(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    load_phantom("type_1", resolution=2e-3).lumen_mesh.export(tmp_path / "arch.stl")
    own = ("--anatomy", str(tmp_path / "arch.stl"), "--model", "generalist")
    refused = one_sentence(capsys, *own, "--target", "spleen")
    assert refused.startswith("arch.stl has no target 'spleen': choose --target from ")
    known = refused.rpartition(" from ")[2].split(", ")
    assert main((*own, "--target", known[0], "--attempts", "1", "--output", str(tmp_path / "demo"))) == 0
    assert "of arch.stl" in capsys.readouterr().out
    assert "It gets no image" in (tmp_path / "demo" / "index.html").read_text(encoding="utf-8")


def test_files_that_are_no_anatomy_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "there is no anatomy nowhere.stl" in one_sentence(capsys, "--anatomy", "nowhere.stl")
    damaged = tmp_path / "damaged.stl"
    damaged.write_bytes(b"no mesh at all")
    assert "damaged.stl" in one_sentence(capsys, "--anatomy", str(damaged))


def test_a_model_that_is_not_there_is_refused(shipped: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (shipped / "navigator.pt").unlink()
    assert one_sentence(capsys) == "there is no model 'navigator': choose from generalist"


def test_wrong_arguments_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    for option, value in (("--seed", "1000"), ("--attempts", "0"), ("--model", "reader"), ("--unit", "km")):
        with pytest.raises(SystemExit) as end:
            main((option, value))
        assert end.value.code == EXIT_USAGE
        assert f"'{value}'" in capsys.readouterr().err


def test_a_folder_that_cannot_be_made_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("")
    assert main(("--output", str(tmp_path / "file" / "demo"))) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.endswith("give another folder by --output")
