"""Files of guidewires and catheters: damaged bytes, and values that are exchanged, missing or added."""

from __future__ import annotations

import random
from pathlib import Path

import yaml

from cathsim.devices.catheter import Catheter
from cathsim.devices.device_file import CATHETER, FOLDERS, PRESETS
from cathsim.devices.shelf import load_catheter
from cathsim.guidewire import Guidewire, load_guidewire
from tests.fuzz.mutations import altered, damaged
from tests.fuzz.target import Target, WrongError, refused


class DeviceTarget(Target):
    """A file that is taken gives a device, all of whose numbers its class has checked."""

    name = "devices"

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.files = [(kind, path) for kind in sorted(FOLDERS) for path in sorted((PRESETS / FOLDERS[kind]).glob("*"))]
        self.whole = {path: self._load(kind, path) for kind, path in self.files}

    def run(self, seed: int) -> None:
        rng = random.Random(seed)
        kind, preset = rng.choice(self.files)
        content = preset.read_bytes()
        if rng.random() < 0.5:
            content = damaged(content, rng)
        else:
            content = self._altered(content, rng)
        path = self.folder / "device.yaml"
        path.write_bytes(content)
        try:
            device = self._load(kind, path)
        except ValueError as error:
            if str(path) not in str(error):
                raise WrongError(f"a refusal does not name the file: {str(error)[:300]!r}") from error
            self.counts[refused(error)] += 1
            return
        self.counts["equal" if device == self.whole[preset] else "accepted"] += 1

    @staticmethod
    def _altered(content: bytes, rng: random.Random) -> bytes:
        try:
            return yaml.safe_dump(altered(yaml.safe_load(content), rng)).encode()
        except RecursionError:  # the writer has a limit of depth, too
            return b"kind: " + b"[" * 3000

    @staticmethod
    def _load(kind: str, path: Path) -> Guidewire | Catheter:
        return load_catheter(path) if kind == CATHETER else load_guidewire(path)
