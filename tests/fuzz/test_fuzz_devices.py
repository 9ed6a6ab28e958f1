"""Files of guidewires and catheters: damaged bytes, and values that are exchanged, missing or added."""

import random
from pathlib import Path

import pytest
import yaml

from cathsim.devices.catheter import Catheter
from cathsim.devices.device_file import CATHETER, FOLDERS, PRESETS
from cathsim.devices.shelf import load_catheter
from cathsim.guidewire import Guidewire, load_guidewire
from tests.fuzz.mutations import altered, damaged
from tests.fuzz.promise import BrokenPromiseError, fuzz, refused

FILES = [(kind, path) for kind in sorted(FOLDERS) for path in sorted((PRESETS / FOLDERS[kind]).glob("*"))]


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the damaged file goes."""
    return tmp_path_factory.mktemp("devices") / "device.yaml"


@fuzz(1534)
def test_devices(rng: random.Random, path: Path) -> str:
    """A file that is taken gives a device, all of whose numbers its class has checked."""
    kind, preset = rng.choice(FILES)
    content = preset.read_bytes()
    path.write_bytes(damaged(content, rng) if rng.random() < 0.5 else altered_yaml(content, rng))
    try:
        device = load(kind, path)
    except ValueError as error:
        if str(path) not in str(error):
            raise BrokenPromiseError(f"a refusal does not name the file: {str(error)[:300]!r}") from error
        return refused(error)
    return "equal" if device == load(kind, preset) else "accepted"


def altered_yaml(content: bytes, rng: random.Random) -> bytes:
    """A file whose values are exchanged, missing or added."""
    try:
        return yaml.safe_dump(altered(yaml.safe_load(content), rng)).encode()
    except RecursionError:  # the writer has a limit of depth, too
        return b"kind: " + b"[" * 3000


def load(kind: str, path: Path) -> Guidewire | Catheter:
    """The device of a file."""
    return load_catheter(path) if kind == CATHETER else load_guidewire(path)
