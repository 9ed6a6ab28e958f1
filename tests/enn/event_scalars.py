"""What TensorBoard itself reads of a training's curves."""

from pathlib import Path

from enn.curves import FOLDER


def scalars(training: Path) -> dict[str, dict[int, float]]:
    """Name of each scalar in a training's folder, to step, to value."""
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    events = EventAccumulator(str(training / FOLDER))
    events.Reload()
    return {name: {one.step: one.value for one in events.Scalars(name)} for name in events.Tags()["scalars"]}
