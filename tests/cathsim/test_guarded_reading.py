"""Guards for files from outside: no regular file, references out of a folder, readers that crash or do not end."""

import multiprocessing
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from cathsim import guarded_reading
from cathsim.anatomy.mesh.report import MeshRefusedError
from cathsim.guarded_reading import UnreadableFileError, call_in_child, check_regular, open_regular, referenced_file

LIMIT_MB = 300


def test_a_regular_file_is_opened_and_a_link_to_one_followed(tmp_path: Path):
    (tmp_path / "a.stl").write_bytes(b"solid")
    (tmp_path / "link.stl").symlink_to(tmp_path / "a.stl")
    with open_regular(tmp_path / "link.stl", most_bytes=5) as file:
        assert file.read() == b"solid"
    assert check_regular(tmp_path / "a.stl") == 5


def test_what_is_no_regular_file_is_refused_at_once(tmp_path: Path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to(tmp_path / "pipe")
    (tmp_path / "circle").symlink_to(tmp_path / "circle")
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(str(tmp_path / "socket"))
    listener.close()
    for name in ("pipe", "link", "socket", "/dev/zero", "."):
        with pytest.raises(UnreadableFileError, match="is no regular file; give a file"):
            open_regular(tmp_path / name)
    with pytest.raises(UnreadableFileError, match="there is no file"):
        open_regular(tmp_path / "missing")
    for name in ("circle", "a\0b", "n" * 300):
        with pytest.raises(UnreadableFileError, match="cannot be opened"):
            open_regular(tmp_path / name)
    (tmp_path / "large").write_bytes(bytes(1001))
    with pytest.raises(UnreadableFileError, match=r"large has 1e-06 GB, at most 1e-06 GB are read"):
        check_regular(tmp_path / "large", 1000)


def test_a_reference_stays_within_its_folder(tmp_path: Path):
    folder = tmp_path / "scene"
    (folder / "data").mkdir(parents=True)
    owner = folder / "scene.gltf"
    for file in (tmp_path / "outside.bin", folder / "scene.bin", folder / "data" / "scene.bin"):
        file.write_bytes(b"abc")
    (folder / "inner.bin").symlink_to("data/scene.bin")
    (folder / "outer.bin").symlink_to("../outside.bin")
    os.mkfifo(folder / "pipe.bin")
    assert referenced_file(owner, "scene.bin") == folder / "scene.bin"
    assert referenced_file(owner, "data\\scene.bin") == referenced_file(owner, "inner.bin") == folder / "data/scene.bin"
    outside = ("../outside.bin", "data/../scene.bin", str(tmp_path / "outside.bin"), "outer.bin", "C:\\a", ".")
    for name in (*outside, "a\0b"):
        with pytest.raises(UnreadableFileError, match="which is no file of its own folder"):
            referenced_file(owner, name)
    with pytest.raises(UnreadableFileError, match=r"pipe\.bin is no regular file"):
        referenced_file(owner, "pipe.bin")
    with pytest.raises(UnreadableFileError, match="there is no file"):
        referenced_file(owner, "missing.bin")


def doubled(values: np.ndarray) -> tuple[np.ndarray, str]:
    print("noise of a reader")
    os.write(2, b"noise of a library")
    return 2 * values, "note"


def refusing() -> None:
    raise MeshRefusedError("no surface", Path("picture.png"))


class LocalError(Exception):
    def __init__(self, one: int, two: int) -> None:
        super().__init__(f"{one} {two}")


def raising(kind: str) -> None:
    raise {"local": LocalError(1, 2), "exit": SystemExit(3), "end": StopIteration()}[kind]


def crashing() -> None:
    os.kill(os.getpid(), signal.SIGSEGV)


def lasting(mark: str) -> None:
    Path(mark).write_text(str(os.getpid()), encoding="utf-8")
    while True:
        time.sleep(0.01)


def within(memory_mb: int) -> int:
    return len(bytes(memory_mb << 20))


@pytest.fixture(params=["forked", "started"])
def child(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Both ways to a child process; on Linux the second is what other systems use."""
    monkeypatch.setattr(guarded_reading, "_FORKS", request.param == "forked" and guarded_reading._FORKS)
    return request.param


def test_results_and_errors_come_back(child: str, capfd: pytest.CaptureFixture[str]):
    values = np.arange(3_000_000.0).reshape(-1, 3)
    result, note = call_in_child(doubled, values, subject="a.stl")
    np.testing.assert_array_equal(result, 2 * values)
    assert note == "note"
    with pytest.raises(MeshRefusedError, match="no surface; see the picture") as caught:
        call_in_child(refusing, subject="a.stl")
    assert caught.value.picture == Path("picture.png")
    words = {"local": "LocalError: 1 2", "exit": "SystemExit: 3", "end": "StopIteration"}
    for kind, word in words.items():
        with pytest.raises(UnreadableFileError, match=rf"^a\.stl cannot be read \({word}\); export it again\.$"):
            call_in_child(raising, kind, subject="a.stl")
    assert capfd.readouterr() == ("", "")


def test_a_crash_a_hang_and_a_bomb_are_one_sentence(child: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]):
    before = _children()  # of other tests
    with pytest.raises(UnreadableFileError, match=r"^a\.stl cannot be read: its reader crashed \(SIGSEGV\); export"):
        call_in_child(crashing, subject="a.stl")
    assert call_in_child(within, LIMIT_MB - 100, subject="a.stl", memory=LIMIT_MB << 20)
    for size_mb in (LIMIT_MB + 1000, LIMIT_MB - 50):  # the second fits once, and not beside its pickle
        with pytest.raises(UnreadableFileError, match=r"^a\.stl takes more than 0\.293 GB of memory to read; make"):
            call_in_child(bytes, size_mb << 20, subject="a.stl", memory=LIMIT_MB << 20)
    start = time.monotonic()
    with pytest.raises(UnreadableFileError, match=r"^a\.stl takes more than 1 s to read; make"):
        call_in_child(lasting, str(tmp_path / "mark"), subject="a.stl", seconds=1.0)
    assert time.monotonic() - start < 5
    mark = tmp_path / "mark"  # on a busy machine a new interpreter may not have begun to read
    assert not mark.exists() or not _alive(int(mark.read_text()))
    assert capfd.readouterr() == ("", "")
    assert _children() <= before, "no zombie"


def _children() -> set[str]:
    """The processes that this thread has started, those that have ended but were not waited for, too."""
    file = Path("/proc/thread-self/children")
    return set(file.read_text(encoding="utf-8").split()) if file.exists() else set()


def _alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


def test_from_a_thread_beside_others():
    results: list[np.ndarray] = []
    ended = threading.Event()

    def busy() -> None:  # allocates, prints to nowhere and computes while others fork
        while not ended.is_set():
            np.linalg.svd(np.random.default_rng(0).normal(size=(60, 60)))

    others = [threading.Thread(target=busy) for _ in range(2)]
    callers = [
        threading.Thread(target=lambda: results.append(call_in_child(doubled, np.ones(9), subject="a.stl")[0]))
        for _ in range(5)
    ]
    for thread in (*others, *callers):
        thread.start()
    for thread in callers:
        thread.join()
    ended.set()
    for thread in others:
        thread.join()
    np.testing.assert_array_equal(results, np.full((len(callers), 9), 2.0))


def _in_worker(queue: multiprocessing.Queue) -> None:
    queue.put(call_in_child(doubled, np.ones(3), subject="a.stl")[0].tolist())


@pytest.mark.parametrize("way", ["fork", "spawn"])
def test_from_a_daemon_process(way: str):
    context = multiprocessing.get_context(way)
    queue = context.Queue()
    worker = context.Process(target=_in_worker, args=(queue,), daemon=True)
    worker.start()
    assert queue.get(timeout=60) == [2.0, 2.0, 2.0]
    worker.join()


def test_after_torch_has_computed_in_threads():
    torch = pytest.importorskip("torch")
    code = (
        "import os, torch, numpy as np\n"
        "torch.set_num_threads(4)\n"
        "x = torch.randn(600, 600); (x @ x).sum()\n"
        "from tests.cathsim.test_guarded_reading import doubled\n"
        "from cathsim.guarded_reading import call_in_child\n"
        "for _ in range(20): assert call_in_child(doubled, np.ones((50, 50)), subject='a.stl')[0].sum() == 5000\n"
        "(x @ x).sum()\n"
    )
    del torch
    environment = os.environ | {"OMP_NUM_THREADS": "4", "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_the_child_ends_with_its_parent(number: signal.Signals, tmp_path: Path):
    mark = tmp_path / "mark"
    code = (
        "import signal\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"  # which a shell's background job ignores
        "from tests.cathsim.test_guarded_reading import lasting\n"
        "from cathsim.guarded_reading import call_in_child\n"
        f"call_in_child(lasting, {str(mark)!r}, subject='a.stl', seconds=1.0)\n"
    )
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    parent = subprocess.Popen([sys.executable, "-c", code], env=environment, stderr=subprocess.DEVNULL)
    while not (mark.exists() and mark.read_text()):
        time.sleep(0.01)
        assert parent.poll() is None
    parent.send_signal(number)
    assert parent.wait(20) == (-number if number == signal.SIGKILL else -signal.SIGINT)
    end = time.monotonic() + (0.5 if number == signal.SIGINT else 5)  # an orphan's own alarm
    while _alive(int(mark.read_text())) and time.monotonic() < end:
        time.sleep(0.05)
    assert not _alive(int(mark.read_text()))
