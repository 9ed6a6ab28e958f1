"""The enn stage: the Expert Navigation Network, its ablation over modality sets, and policies with a force penalty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from enn.curves import chosen_logger
from pipeline.anatomies.settings import settle
from pipeline.settings.kinds import require_modalities
from pipeline.stages import Stage, StageContext
from pipeline.stages.learning.aids import note, of_training
from pipeline.stages.learning.settings import EnnSettings, with_hyperparameters
from pipeline.stages.learning.training import (
    THESIS,
    PolicyTrainingJob,
    check_learning,
    planned_training,
    run_trainings,
    task_of,
    training_seeds,
)
from pipeline.tables import Results
from pipeline.task import number_of_actions, observed

if TYPE_CHECKING:
    from enn.reinforcement.training.settings import TrainingSettings

# The thesis's table of training times has names of its own for the sets.
TRAINING_TIME_ROWS = {"V": "image", "V+M": "image_mask", "I": "internal", "I+V": "internal_image", "I+V+M": "enn"}
TRAINING_TIME_PHANTOM = "type_1"  # of the thesis's ablation
SAFE = "safe"
IMAGE_SHAPE = (1, 80, 80)  # of the thesis
# A poor policy of two devices may arrive in all of ten episodes by chance.
EVALUATIONS_OF_TWO_DEVICES = 20
_SECONDS_AN_HOUR = 3600.0


def check_enn(settings: EnnSettings) -> None:
    """Refuses unknown phantoms, targets, wires and modality sets with a ConfigurationError."""
    check_learning(settings)
    require_modalities(settings.expert, *settings.modalities)
    if settings.training:  # now, and not after the stages that it reads
        training_settings(settings, settings.decisions)


def run_enn(settings: EnnSettings, context: StageContext) -> Results:
    trainings = plan(settings, context)
    outcomes = run_trainings(trainings, settings, context)
    tables = {
        "training_time_h": training_times(trainings, outcomes),
        "architecture_params": architecture(),
        "sac_hyperparameters": hyperparameters(settings),
        # how long is trained and evaluated, beside the thesis's settings
        "task": {
            "training_steps": {"value": settings.decisions},
            "evaluation_episodes": {"value": settings.evaluation_episodes},
        },
    }
    return Results(tables, notes=dict.fromkeys(("ablation", "training_time_h"), note(trainings, of_training)))


def plan(settings: EnnSettings, context: StageContext) -> list[PolicyTrainingJob]:
    """The trainings: those of the expert row first, as later stages wait for them."""
    from enn.networks.observation_spaces import modality_keys

    most = max(settings.seeds, settings.ablation_seeds)
    trainings: list[PolicyTrainingJob] = []

    def add(phantoms: Sequence[str], row: str, modalities: str, count: int, *, weight: float = 0.0) -> None:
        keys = observed(settings.task, modality_keys(modalities))
        decisions = settings.safe_decisions if weight else settings.decisions
        trained = training_settings(settings, decisions, keys if settings.variant == THESIS else ())
        for seed in training_seeds(context.seed, count, most):
            first = row == settings.expert and seed == context.seed * most
            for phantom in phantoms:
                for target in settings.targets:
                    task = task_of(settings, phantom, target, algorithm=settings.algorithm, force_penalty=weight)
                    episodes = settings.expert_episodes if first else 0
                    trainings.append(
                        planned_training(settings, context, task, row, seed, keys, trained, expert_episodes=episodes)
                    )

    chosen = settings.modality  # from a sweep: this row alone
    if chosen is None or chosen == settings.expert:
        add(settings.phantoms, settings.expert, settings.expert, settings.seeds)
    for modalities in settings.modalities:
        if modalities != settings.expert:
            add(settings.ablation_phantoms, modalities, modalities, settings.ablation_seeds)
    for weight in settings.safe_weights:
        row = f"{settings.expert} {SAFE} {weight:g}"
        add(settings.ablation_phantoms, row, settings.expert, settings.ablation_seeds, weight=weight)
    return trainings


def training_settings(settings: EnnSettings, decisions: int, keys: tuple[str, ...] = ()) -> TrainingSettings:
    """SAC or PPO of the variant with so many decisions; `keys` are what the thesis's network observes.

    The desk's policies of a wire in a catheter are chosen by 20 episodes instead of 10.
    """
    from enn.reinforcement.training.settings import DESK_PPO, DESK_SAC, THESIS_PPO, THESIS_SAC

    desk, thesis = (DESK_SAC, THESIS_SAC) if settings.algorithm == "sac" else (DESK_PPO, THESIS_PPO)
    preset: TrainingSettings = thesis if settings.variant == THESIS else desk
    if settings.variant != THESIS and settings.task.two_devices:
        preset = replace(preset, evaluation_episodes=EVALUATIONS_OF_TWO_DEVICES)
    sized = preset.sized(decisions, settings.evaluation_episodes, logger=chosen_logger(), keys=keys)
    return with_hyperparameters(sized, settings.training)


def training_times(trainings: Sequence[PolicyTrainingJob], outcomes: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Row to target to hours of trainings on the Type I arch with their encoders' fits, mean and spread over seeds."""
    import numpy as np

    hours: dict[tuple[str, str], list[float]] = {}
    for training in trainings:
        row = TRAINING_TIME_ROWS.get(training.origin.row)
        if row is not None and training.task.phantom == TRAINING_TIME_PHANTOM:
            outcome = outcomes[training.name]
            spent = (outcome["training_s"] + outcome["encoder_s"]) / _SECONDS_AN_HOUR
            hours.setdefault((row, training.task.target), []).append(spent)
    table: dict[str, dict[str, Any]] = {}
    for (row, target), values in hours.items():
        mean = float(np.mean(values))
        table.setdefault(row, {})[target] = [mean, float(np.std(values))] if len(values) > 1 else mean
    return table


def architecture() -> dict[str, dict[str, Any]]:
    """The layers of the thesis's networks as they are built here, with the thesis's wire and image."""
    from cathsim import load_guidewire
    from enn.networks.features import LAYER_COLUMNS, layer_table, thesis_cnn, thesis_mlp

    joints = 4 * (load_guidewire(THESIS).joints + 1)  # positions and velocities of feeder and hinges
    networks = {
        "cnn": layer_table(thesis_cnn(IMAGE_SHAPE), IMAGE_SHAPE),
        "mlp": layer_table(thesis_mlp(joints), (joints,)),
    }
    return {
        f"{network}/{layer}": dict(zip(LAYER_COLUMNS, cells, strict=True))
        for network, layers in networks.items()
        for layer, cells in layers.items()
    }


def hyperparameters(settings: EnnSettings) -> dict[str, dict[str, Any]]:
    """What SAC was run with, in the thesis's table; nothing where PPO was run."""
    from enn.reinforcement.training.settings import SacSettings

    used = training_settings(settings, settings.decisions)
    if not isinstance(used, SacSettings):
        return {}
    values = {
        "learning_rate": used.learning_rate,
        "buffer_size": used.buffer_size,
        "batch_size": used.batch_size,
        "tau": used.tau,
        "gamma": used.gamma,
        "train_freq": 1,
        "gradient_steps": used.gradient_steps,
        "ent_coef": used.ent_coef,
        "target_update_interval": 1,
        "target_entropy": float(-number_of_actions(settings.task))
        if used.target_entropy is None
        else used.target_entropy,
    }
    return {name: {"value": value} for name, value in values.items()}


STAGE = Stage(settings=EnnSettings, run=run_enn, reads=("expert",), prepare=settle, check=check_enn)
