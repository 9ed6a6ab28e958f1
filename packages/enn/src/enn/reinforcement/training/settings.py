"""Settings of a training by SAC or PPO: everything that it is defined by, and the presets of thesis and desk."""

from __future__ import annotations

import re
from dataclasses import fields, replace
from typing import Annotated, Any, Literal, Self

from annotated_types import Interval

from enn.curves import Logger
from enn.networks.network import NetworkSettings
from enn.setting_kinds import Count, CountOrNone, LearningRate, Seconds, Share, Weight, settings

_LEAST_SHARE_BEFORE_LEARNING = 4  # a tiny budget still spends most of its decisions learning
_LEARNT_ENTROPY = re.compile(r"auto(_(?P<start>[0-9.]+(e-?[0-9]+)?))?")


@settings
class TrainingSettings(NetworkSettings):
    """What `SacSettings` and `PpoSettings` have in common.

    One decision is one action of one environment, held for `action_repeat` steps.
    """

    # fits mean and scale of vector observations to the first decisions; never with an encoder, whose features are
    # normalised
    normalise: bool = True
    decisions: Count = 6000  # budget, all environments together
    n_envs: Annotated[int, Interval(ge=1, le=4096)] = 8
    threads: Annotated[int, Interval(ge=1, le=4096)] = 1  # that step them
    action_repeat: Count = 3  # environment steps a decision
    learning_rate: LearningRate = 1e-3  # of Adam
    # share of it that is left at the end of the budget, to which it falls evenly
    final_learning_rate: Annotated[float, Interval(gt=0, le=1e3)] = 1.0
    batch_size: Count = 128
    gamma: Annotated[float, Interval(gt=0, le=1)] = 0.99  # discount a decision
    learning_starts: CountOrNone = 304  # random decisions at the start
    # of the squared distance to the demonstrations' actions: before PPO's first roll-out, and after each update; in the
    # loss of SAC's actor where its critics prefer those actions, as a share of their values' magnitude
    cloning_weight: Weight = 0.0
    start_state_buffer_share: Share = 0.75  # share of the resets from the start-state buffer; 0: there is none
    start_state_buffer_capacity: Count = 4096  # states in the start-state buffer; with cases, of each of them
    # how many cases (an anatomy and a target each, say) the environment chooses from; each then has its own buffer,
    # and episodes take place more often where they fail. 0: the environment has no cases.
    start_state_buffer_cases: CountOrNone = 0
    evaluate_every: CountOrNone = 1000  # decisions between evaluations; 0: none, the last policy is kept
    # deterministic episodes, and as many stochastic ones where those were no worse than the best so far; when the
    # first three fail, the rest are not played
    evaluation_episodes: Count = 10
    # keeps the latest policy that is not clearly worse than the best, by drawn episodes alone
    keep_latest: bool = False
    # evaluations in a row that are perfect and no shorter than the best, after which training stops early; 0: never
    stop_after: CountOrNone = 0
    curve_every: Count = 200  # decisions between rows of the curve
    checkpoint_seconds: Seconds = 60.0  # between checkpoints; 0: after every decision
    logger: Logger = "none"  # of the curves, as `enn.curves.open_writer`
    keep_critics: bool = False  # in the policy's file, so that a training can start from it (SAC; PPO keeps all)
    device: str = "cpu"  # of the networks: "cpu", "cuda", "cuda:1", or "auto", a GPU where there is one

    def __post_init__(self) -> None:
        if type(self) is TrainingSettings:
            raise ValueError("TrainingSettings name no algorithm: take SacSettings or PpoSettings")
        self.network  # noqa: B018 - refuses unknown names

    def sized(self, decisions: int, evaluation_episodes: int, **changed: Any) -> Self:
        """The same run with another budget in decisions; what does not fit a tiny budget becomes smaller.

        Args:
            evaluation_episodes: at most so many.
        """
        return replace(
            self,
            decisions=decisions,
            learning_starts=min(self.learning_starts, decisions // _LEAST_SHARE_BEFORE_LEARNING),
            evaluate_every=min(self.evaluate_every, decisions),
            evaluation_episodes=min(self.evaluation_episodes, evaluation_episodes),
            curve_every=min(self.curve_every, decisions),
            **changed,
        )

    def with_network(self, network: NetworkSettings) -> Self:
        """The same run of another network, such as that of a policy to start from."""
        return replace(self, **{field.name: getattr(network, field.name) for field in fields(NetworkSettings)})

    def learning_rate_after(self, done: float) -> float:
        """The learning rate when a share of the budget is used."""
        return self.learning_rate * (1.0 - (1.0 - self.final_learning_rate) * done)

    @property
    def learns_from_demonstrations(self) -> bool:
        """Whether steps of demonstrations take part in updates, beside their states in the start-state buffer."""
        return self.cloning_weight > 0

    @property
    def network(self) -> NetworkSettings:
        """The part that shapes of weights depend on."""
        return NetworkSettings(**{field.name: getattr(self, field.name) for field in fields(NetworkSettings)})


@settings
class SacSettings(TrainingSettings):
    """A training by SAC."""

    algorithm: Literal["sac"] = "sac"
    # updates are made while the other threads step, in a process of their own, from what was there before these
    # decisions
    overlap: bool = False
    gradient_steps: Annotated[float, Interval(ge=0, le=1e4)] = 1.0  # updates a decision; may be a fraction
    tau: Annotated[float, Interval(gt=0, le=1)] = 0.005  # share of the new weights in the target critic
    ent_coef: str | Weight = "auto_0.05"  # weight of the entropy; "auto" or "auto_0.05" learns it, from 1 or 0.05
    # that "auto" aims at; None: minus the number of actions. A fixed weight has none.
    target_entropy: Annotated[float, Interval(ge=-1e4, le=1e4)] | None = None
    buffer_size: Count = 50_000
    half: bool = False  # vectors of the replay buffer in half precision
    # share of each batch drawn from demonstrations
    demonstrations_in_replay: Annotated[float, Interval(ge=0, lt=1)] = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.cloning_weight and not self.demonstrations_in_replay:
            raise ValueError(
                "SAC clones the demonstrations in its batches: with cloning_weight give demonstrations_in_replay, too"
            )
        if isinstance(self.ent_coef, str):
            learnt = _LEARNT_ENTROPY.fullmatch(self.ent_coef)
            if learnt is None or not float(learnt["start"] or 1.0) > 0:
                raise ValueError(
                    f"ent_coef must be a number, auto, or auto_ and the positive number to start from, got "
                    f"'{self.ent_coef}'"
                )
        elif self.target_entropy is not None:
            raise ValueError(
                f"a fixed ent_coef of {self.ent_coef} aims at no entropy: leave target_entropy out, or learn the "
                f"weight with ent_coef='auto_{self.ent_coef}'"
            )

    def sized(self, decisions: int, evaluation_episodes: int, **changed: Any) -> Self:
        """As every run's; the replay buffer holds no more than the decisions."""
        size = min(self.buffer_size, max(decisions, 1))
        return super().sized(decisions, evaluation_episodes, buffer_size=size, **changed)

    @property
    def learns_from_demonstrations(self) -> bool:
        """Whether steps of demonstrations take part in updates, beside their states in the start-state buffer."""
        return self.demonstrations_in_replay > 0


@settings
class PpoSettings(TrainingSettings):
    """A training by PPO, which keeps no replay buffer."""

    algorithm: Literal["ppo"] = "ppo"
    ent_coef: Weight = 0.0  # weight of the entropy
    n_steps: Count = 256  # decisions of each environment between updates
    epochs: Count = 10  # over each roll-out
    gae_lambda: Share = 0.95
    clip_range: Annotated[float, Interval(gt=0, le=1e3)] = 0.2
    log_std_init: Annotated[float, Interval(ge=-20, le=2)] = 0.0  # of the actions, logarithm of their deviation
    # It falls evenly to this value until the budget ends, so that drawn actions become the best; None: it is learnt.
    log_std_final: Annotated[float, Interval(ge=-20, le=2)] | None = None
    # factor on the rewards, for the value's loss, clipped together with the policy's, should not be far larger
    reward_scale: Annotated[float, Interval(gt=0, le=1e6)] = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.log_std_final is not None and self.ent_coef:
            raise ValueError(
                f"log_std_final settles the entropy of PPO's actions: leave it out, or ent_coef at 0, got "
                f"{self.ent_coef}"
            )

    def sized(self, decisions: int, evaluation_episodes: int, **changed: Any) -> Self:
        """As every run's; there are two roll-outs or more."""
        steps = min(self.n_steps, max(decisions // (2 * self.n_envs), 16))
        return super().sized(decisions, evaluation_episodes, n_steps=steps, **changed)

    def log_std_after(self, done: float) -> float | None:
        """The logarithm of the actions' deviation when a share of the budget is used; None: it is learnt."""
        last = self.log_std_final
        return None if last is None else self.log_std_init + (last - self.log_std_init) * done


# Thesis, table of SAC's hyper-parameters, features of its architecture table; the layers after them, which it does not
# print, are the library's. Budget: 600,000 steps. Its entropy coefficient of 1 and target entropy of -2 fit together
# only if the coefficient is learnt from 1 on; -2 is minus the number of its actions, and for 21 actions it is -21.
THESIS_SAC = SacSettings(
    variant="thesis",
    extractor="multimodal",
    hidden=(256, 256),
    normalise=False,
    decisions=600_000,
    action_repeat=1,
    n_envs=1,
    learning_rate=3e-4,
    batch_size=256,
    learning_starts=100,
    ent_coef="auto_1.0",
    buffer_size=1_000_000,
    start_state_buffer_share=0.0,
    evaluate_every=10_000,
    curve_every=1000,
)
# Thesis, CathSim chapter: Adam at 3e-4; the rest as in stable-baselines3.
THESIS_PPO = PpoSettings(
    variant="thesis",
    extractor="multimodal",
    hidden=(64, 64),
    activation="tanh",
    normalise=False,
    decisions=600_000,
    action_repeat=1,
    n_envs=1,
    learning_rate=3e-4,
    batch_size=64,
    learning_starts=0,
    n_steps=2048,
    start_state_buffer_share=0.0,
    evaluate_every=10_000,
    curve_every=2048,
)
# Measured: with demonstrations in the start-state buffer, LCCA is learnt fast only if actions last 0.3 s.
DESK_SAC = SacSettings(
    decisions=4000,
    critic_layer_norm=True,
    demonstrations_in_replay=0.25,
    final_learning_rate=0.1,
    evaluate_every=1000,
    stop_after=1,
)
# Small roll-outs make many updates; without the actions of demonstrations a training fails by chance.
DESK_PPO = PpoSettings(
    activation="tanh",
    decisions=40_000,
    learning_rate=1e-3,
    final_learning_rate=0.1,
    batch_size=64,
    n_steps=32,
    epochs=5,
    log_std_init=-1.0,
    log_std_final=-2.5,
    reward_scale=0.1,
    cloning_weight=1.0,
    start_state_buffer_share=0.5,
    evaluate_every=2500,
    stop_after=1,
    curve_every=1024,
)


def thesis_baseline(algorithm: str, observation: str) -> TrainingSettings:
    """The thesis's baseline with its own networks: "ppo" or "sac" on "internal", "image" or "sequential".

    Two layers of 64 with tanh over the state; over images the convolutions of Mnih et al. and 512 units, from which the
    actions are linear. The critic of SAC, which the thesis does not print, is the library's.
    """
    changed: dict[str, Any] = {"hidden": (64, 64), "activation": "tanh"}
    if observation != "internal":
        changed = {"hidden": (), "activation": "relu"}
    if algorithm == "sac":
        changed["critic_hidden"] = (256, 256)
    preset: TrainingSettings = THESIS_PPO if algorithm == "ppo" else THESIS_SAC
    return replace(preset, keys=(observation,), variant="baselines", **changed)
