"""The patch encoder: an image in square patches, each a token, through every layer of a transformer."""

from __future__ import annotations

from torch import Tensor, nn

from splineformer.modeling.positions import grid_positions
from splineformer.modeling.transformer import EncoderLayer


class PatchEncoder(nn.Module):
    """Patches to tokens by LayerNorm, a linear map and LayerNorm; sinusoidal positions; then layer after layer.

    Args:
        image_px: side of the square image.
        patch_px: side of a patch; divides `image_px`.
        width: of the tokens.
        layers: how many.
        heads: of each.
        dropout: in training.
    """

    positions: Tensor

    def __init__(self, image_px: int, patch_px: int, width: int, layers: int, heads: int, dropout: float = 0.0) -> None:
        super().__init__()
        if image_px % patch_px:
            raise ValueError(f"patch_px must divide image_px, got {patch_px} and {image_px}")
        self.patch_px, self.side = patch_px, image_px // patch_px
        self.embed = nn.Sequential(nn.LayerNorm(patch_px**2), nn.Linear(patch_px**2, width), nn.LayerNorm(width))
        self.register_buffer("positions", grid_positions(self.side, width), persistent=False)
        self.dropout = nn.Dropout(dropout)
        self.layers = nn.ModuleList(EncoderLayer(width, heads, dropout) for _ in range(layers))
        self.norm = nn.LayerNorm(width)

    def forward(self, image: Tensor) -> Tensor:
        """(B, 1, image_px, image_px) normalised images to the (B, side², width) memory, row by row."""
        p, s = self.patch_px, self.side
        patches = image[:, 0].unflatten(2, (s, p)).unflatten(1, (s, p)).permute(0, 1, 3, 2, 4).flatten(3).flatten(1, 2)
        x = self.dropout(self.embed(patches) + self.positions)
        for layer in self.layers:
            x = layer(x)
        return self.norm(x)
