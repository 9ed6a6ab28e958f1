"""Shipped networks of this package, which `splineformer.Predictor.pretrained` loads."""

from __future__ import annotations

from guide3d import shipped


def models() -> dict[str, str]:
    """The shipped networks: name to a sentence that says what each does."""
    return shipped.models("splineformer")


def card(name: str) -> str:
    """The card of a shipped network, as Markdown.

    Raises:
        ValueError: there is none of this name; the message lists those that there are.
    """
    return shipped.card(name, "splineformer")
