import torch
from torch import nn

from enn.imitation.images.wire_segmentation import fitted


def test_every_image_is_seen_once_an_epoch_and_the_loss_falls() -> None:
    x, seen, losses = torch.linspace(-1.0, 1.0, 11)[:, None], [], []

    def loss_of(network, rows, generator):
        seen.append(rows)
        return (network(x[rows]) - 3 * x[rows]).square().mean()

    network = fitted(
        lambda: nn.Linear(1, 1),
        11,
        loss_of,
        epochs=9,
        seed=0,
        progress=lambda _, loss: losses.append(loss),
        device="cpu",
    )
    assert [sorted(int(k) for rows in seen[n : n + 2] for k in rows) for n in range(0, 18, 2)] == [list(range(11))] * 9
    assert len(losses) == 9
    assert losses[-1] < losses[0]
    assert not network.training
