"""Model files: what was written is read, and what is no model of the kind is one sentence."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from enn.encoder import Encoder, EncoderSettings
from enn.model_file import another_architecture, decoded, read_model, write_model

SETTINGS = EncoderSettings(keys=("image", "joints"), shapes=((1, 36, 36), (4,)), hidden=8, features=6)


def read(path: Path) -> dict:
    return read_model(path, "toy-1", kind="toy", verb="build")


def test_what_was_written_is_read(tmp_path: Path) -> None:
    path = tmp_path / "new" / "toy.pt"
    write_model(path, {"format": "toy-1", "sizes": (2, 3), "weights": {"a": torch.arange(3)}})
    content = read(path)
    assert content["sizes"] == (2, 3)
    assert content["weights"]["a"].tolist() == [0, 1, 2]
    assert [file.name for file in path.parent.iterdir()] == ["toy.pt"]


def test_a_failed_write_leaves_the_former_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "toy.pt"
    write_model(path, {"format": "toy-1", "number": 1})

    def full(file: Path, data: bytes) -> None:
        file.open("wb").write(data[:100])
        raise OSError("no room")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(OSError, match="no room"):
        write_model(path, {"format": "toy-1", "number": 2})
    assert read(path)["number"] == 1
    assert [file.name for file in tmp_path.iterdir()] == ["toy.pt"]


def test_what_is_no_model_is_one_sentence(tmp_path: Path) -> None:
    path = tmp_path / "toy.pt"
    with pytest.raises(FileNotFoundError, match=r"there is no toy .*toy\.pt: build one first"):
        read(path)
    path.write_bytes(b"something else")
    with pytest.raises(ValueError, match=r"is damaged or no toy \(its digest does not match\): build it again"):
        read(path)
    write_model(path, {"format": "toy-0"})
    with pytest.raises(ValueError, match="is no toy of format toy-1, but 'toy-0': build it again"):
        read(path)
    assert "x.pt is of another architecture than this version builds (sizes differ): fit it again" in str(
        another_architecture(Path("x.pt"), RuntimeError("sizes\n  differ"), verb="fit")
    )


def test_an_encoder_is_kept(tmp_path: Path) -> None:
    torch.manual_seed(0)
    encoder = Encoder(SETTINGS)
    path = tmp_path / "encoder.pt"
    encoder.save(path)
    again = Encoder.load(path)
    seen = {"image": torch.randint(0, 255, (3, 1, 36, 36), dtype=torch.uint8), "joints": torch.rand(3, 4)}
    assert again.settings == SETTINGS
    assert torch.equal(again(seen), encoder(seen))
    assert not any(parameter.requires_grad for parameter in again.parameters())
    content = decoded(path.read_bytes())
    write_model(path, {**content, "settings": {**content["settings"], "hidden": 9}})
    with pytest.raises(ValueError, match=r"encoder\.pt is of another architecture"):
        Encoder.load(path)
