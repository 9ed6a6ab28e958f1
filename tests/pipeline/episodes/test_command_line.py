"""The command line of episode logs: what it prints, its exit codes, and one sentence for bad input."""

import subprocess
import sys
from pathlib import Path

import pytest

from pipeline.episodes.__main__ import main
from pipeline.episodes.checking import check

ROOT = Path(__file__).parents[3]


@pytest.fixture
def damaged_path(log_path):
    data = bytearray(log_path.read_bytes())
    data[len(data) // 2] ^= 4
    path = log_path.with_name("damaged.mcap")
    path.write_bytes(data)
    return path


def test_info_tells_the_episode(log_path, capsys):
    assert main(["info", str(log_path)]) == 0
    text = capsys.readouterr().out
    for part in ("type_1", "descending_aorta -> bca, seed 17", "success, 22 steps", "33 x 20 px, image + mask"):
        assert part in text


def test_check_of_several_files_reports_each(log_path, damaged_path, capsys):
    assert main(["check", str(log_path), str(damaged_path)]) == 1
    out, err = capsys.readouterr()
    assert out == f"{log_path} is fine: 23 records, 46 pictures\n"
    assert err.count("\n") == 1
    assert f"{damaged_path} is damaged: " in err
    assert main(["check", str(damaged_path), str(log_path.with_name("none"))]) == 2


def test_recover_names_its_output(damaged_path, log_path, capsys):
    assert main(["recover", str(damaged_path)]) == 0
    saved = damaged_path.with_name("damaged.recovered.mcap")
    assert "18 records kept, 5 known to be missing" in capsys.readouterr().out
    assert not check(saved).problems
    assert main(["recover", str(damaged_path)]) == 2
    assert "exists already" in capsys.readouterr().err
    assert main(["recover", "--overwrite", str(damaged_path), str(saved)]) == 0
    partial = log_path.with_name("killed.mcap.partial")
    partial.write_bytes(log_path.read_bytes()[:-500])
    assert main(["recover", str(partial)]) == 0
    assert not check(log_path.with_name("killed.mcap")).problems
    assert partial.exists()


@pytest.mark.parametrize("command", ["info", "check", "recover"])
def test_bad_and_missing_files_get_one_sentence(command, log_path, tmp_path, capsys):
    path, whole = tmp_path / "bad.mcap", log_path.read_bytes()
    garbage = (b"text\n" * 50, b"\x89MCAP0\r\n", b"\x89MCAP0\r\n" + bytes(range(256)) * 20)
    for content in (*garbage, *(whole[:length] for length in (0, 7, 30, 200))):
        path.write_bytes(content)
        assert main([command, str(path)]) == 1
        err = capsys.readouterr().err
        assert err.count("\n") == 1
        assert str(path) in err
        assert sorted(file.name for file in tmp_path.iterdir()) == ["bad.mcap", "episode.mcap"]
    assert main([command, str(tmp_path / "none.mcap")]) == 2
    assert f"{tmp_path / 'none.mcap'} is no file" in capsys.readouterr().err
    assert main([command, str(tmp_path)]) == 2


def test_wrong_usage_exits_with_two(capsys):
    for arguments in ([], ["open", "x"], ["info"]):
        with pytest.raises(SystemExit) as stop:
            main(arguments)
        assert stop.value.code == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 3, "each is one sentence"
    assert all(line.startswith("python -m pipeline.episodes") for line in lines)


def test_module_runs_without_simulator_and_learning_library(log_path):
    code = (
        "import sys; from pipeline.episodes.__main__ import main; code = main(['check', sys.argv[1]]); "
        "heavy = {'torch', 'cathsim', 'hydra', 'mujoco'} & set(sys.modules); assert not heavy, heavy; sys.exit(code)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(log_path)], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
