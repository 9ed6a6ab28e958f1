"""Shipped models: cards and index agree with the files, all are small together, and each loads by its name."""

from pathlib import Path

import pytest
import yaml

import enn
import guide3d
import splineformer
from guide3d.learning.model_file import write_content
from models import cards as model_cards
from models.cards import INDEX, SECTIONS, ShippedModel, main, shipped_models, written

LOADERS = {"enn": enn.load, "guide3d": guide3d.load, "splineformer": splineformer.Predictor.pretrained}
MODELS = shipped_models()


def test_cards_and_index_agree_with_the_files() -> None:
    outdated = [path.name for path, text in written().items() if path.read_text(encoding="utf-8") != text]
    assert not outdated, "run python models/cards.py"


@pytest.mark.parametrize("model", MODELS, ids=lambda model: f"{model.package}-{model.path.stem}")
def test_a_model_loads_by_its_name(model: ShippedModel) -> None:
    assert LOADERS[model.package](model.path.stem) is not None


@pytest.mark.parametrize("package", [enn, guide3d, splineformer], ids=lambda package: package.__name__)
def test_every_model_is_listed_with_a_sentence(package: object) -> None:
    listed = package.models()  # type: ignore[attr-defined]
    assert set(listed) == {model.path.stem for model in MODELS if model.package == package.__name__}  # type: ignore[attr-defined]
    assert all(sentence.endswith(".") and not sentence.startswith("|") for sentence in listed.values())


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A repository with one model, its card and an index whose tables are still empty."""
    weights = tmp_path / "packages/guide3d/src/guide3d/weights"
    write_content(weights / "a.pt", {"format": "guide3d-network-1"})
    sections = "\n\n".join(f"**{name}.** Words." for name in SECTIONS)
    (weights / "a.md").write_text(f"# a\n\nDoes\nthis.\n\n| file |\n|---|\n\n{sections}\n")
    (tmp_path / "models").mkdir()
    (tmp_path / INDEX).write_text("# Models\n\n| name |\n|---|\n\nEnd.\n")
    monkeypatch.setattr(model_cards, "written", lambda: written(tmp_path))
    return tmp_path


def test_tables_are_written_from_the_file(root: Path) -> None:
    assert main() == 0
    (model,) = shipped_models(root)
    card, index = model.card.read_text(), (root / INDEX).read_text()
    assert f"| `a.pt` | {model.size} | `{model.sha256}` | `guide3d-network-1` |\n\n**What it sees.**" in card
    head = yaml.safe_load(card.split("---")[1])
    assert (head["library_name"], head["model_name"], head["sha256"]) == ("guide3d", "a", model.sha256)
    assert "| `guide3d` `a` | Does this. |" in index
    assert model.sha256[:12] in index
    assert index.endswith("\n\nEnd.\n")
    assert written(root) == {model.card: card, root / INDEX: index}


def test_a_lacking_card_or_section_and_too_large_models_are_refused(
    root: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    card = shipped_models(root)[0].card
    card.write_text(card.read_text().replace("**Limits.**", "Limits."))
    assert main() == 1
    assert "then What it sees, Trained on, Command, Figures, Limits, each" in capsys.readouterr().err
    card.unlink()
    with pytest.raises(ValueError, match="has no card: write"):
        written(root)
    monkeypatch.setattr(model_cards, "LIMIT_BYTES", 100)
    with pytest.raises(ValueError, match="ship fewer"):
        written(root)
