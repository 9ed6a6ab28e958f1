"""The documents stay short enough to be read."""

from tests.integration.documents.pages import PAGES, PROJECT_ROOT, read


def test_the_readme_has_at_most_450_words() -> None:
    words = len(read(PROJECT_ROOT / "README.md").split())
    assert words <= 450


def test_the_pages_are_at_most_50_with_at_most_45_000_words() -> None:
    words = sum(len(read(page).split()) for page in (*PAGES, PROJECT_ROOT / "README.md"))
    assert len(PAGES) <= 50
    assert words <= 45_000


def test_the_readme_says_in_one_short_sentence_what_the_project_is() -> None:
    title, sentence = read(PROJECT_ROOT / "README.md").split("\n\n")[:2]
    assert title.startswith("# ")
    assert sentence.count(".") == 1
    assert len(sentence.split()) <= 25
