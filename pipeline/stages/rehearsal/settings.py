"""Settings of the stage rehearsal: the scan, what may differ from it on the day, and the training."""

from __future__ import annotations

from dataclasses import field
from typing import TYPE_CHECKING, Annotated, ClassVar

from annotated_types import Ge, Le

from pipeline.anatomies.settings import ChosenAnatomies
from pipeline.settings import kinds
from pipeline.stages.learning.settings import StartingPolicySettings
from pipeline.store.errors import ConfigurationError
from pipeline.task import Task

if TYPE_CHECKING:
    from cathsim.anatomy import Phantom
    from enn.device_trials import TrialStatistics

SAC, PPO = "sac", "ppo"
PRICES_OF_FORCE = {False: 0.1, True: 0.3}  # 1/N, by whether there are two devices (docs/results/rehearsal.md)
PRESSING, PRICE_OF_PRESSING = 0.3, 1.0  # N; 1/N for a wire alone that always arrives and presses more
_Millimetres = Annotated[float, Ge(0), Le(20)]
_Percent = Annotated[float, Ge(0), Le(90)]


@kinds.validated()
class RehearsalSettings(ChosenAnatomies, StartingPolicySettings, kinds.JobSettings):
    """Settings of a rehearsal; a wire of length 0 becomes as long as the way asks for, at least the preset.

    Without `policy` it starts from the stage unseen's, or a shipped one, with the same devices.
    """

    shows_ct: ClassVar[str | None] = "film"

    name: str = "rehearsal"
    phantoms: kinds.FolderNames = field(default_factory=lambda: ["type_1"])  # one: that of the scan
    targets: kinds.TargetNames = field(default_factory=lambda: ["lcca"])  # one: any of the anatomy's
    choose_catheter: bool = True  # where none is named: by trials, of softer wires, too, or the shape of the take-off
    fit_steps: bool = True  # longer episodes than task.max_steps, where the way is long for them
    fresh: bool = False  # starts from nothing even where there is one
    walls_mm: _Millimetres = 1.0  # largest differences of a copy from the scan
    shift_mm: _Millimetres = 3.0
    turn_deg: Annotated[float, Ge(0), Le(30)] = 3.0
    stiffness_pct: _Percent = 30.0
    friction_pct: _Percent = 30.0
    breathing_mm: _Millimetres = 5.0
    breath_s: Annotated[float, Ge(0.5), Le(60)] = 4.0
    copies: kinds.Count = 16  # that are trained in, beside the scan
    validation_copies: kinds.Count = 15  # that choose the best policy, beside the scan
    test_copies: Annotated[int, Ge(1), Le(1000)] = 30
    scan_episodes: kinds.Episodes = 10  # on the scan itself
    mode: Annotated[str, kinds.one_of("stochastic", "deterministic")] = "stochastic"  # of the tests' actions
    film: bool = True  # of an episode in the scan after the training
    # Attempts of a test's episode: devices that have not arrived are withdrawn and begin again.
    attempts: Annotated[int, Ge(1), Le(10)] = 1
    # episodes that arrive, of other policies of the same devices where that which it starts from seldom does; 0: none
    demonstrations: Annotated[int, Ge(0), Le(1000)] = 12
    # When the sampling expert demonstrates: where policies give less than a third, always, or never.
    expert: Annotated[str, kinds.one_of("needed", "always", "never")] = "needed"
    algorithm: Annotated[str, kinds.one_of(SAC, PPO)] = SAC
    decisions: kinds.Decisions = 20_000
    # of them that is enough where the policy to start from arrives in three quarters of the training's copies, but not
    # in all, and in four fifths with trials and the validation's; SAC's rate is higher by as much. Where it arrives in
    # all and in all trials, two thirds of them at the usual rate. 1: all decisions
    share_of_decisions: Annotated[float, Ge(0.1), Le(1)] = 0.5
    # At most so many further trainings follow while fewer than nine tenths of the latest episodes arrive (SAC).
    further_trainings: Annotated[int, Ge(0), Le(20)] = 2
    environments: Annotated[int, Ge(1), Le(1024)] = 16  # of the training
    hidden: kinds.Units = 256  # units of both layers, where it starts from nothing
    training: kinds.Hyperparameters = None  # hyper-parameters: fields of enn's SacSettings or PpoSettings
    # of the training's reward, a newton and step; null: 0.3 for both devices, 0.1 for a wire alone, but 1 where it
    # always arrives in the trials and presses with more than 0.3 N
    force_penalty: kinds.Weight | None = None
    force_threshold_n: Annotated[float, Ge(0), Le(100)] = 0.0  # contact force that costs nothing
    path_penalty: kinds.Weight = 40.0  # a metre of the tip's way
    accuracy: kinds.Accuracy = "accurate"  # tests are accurate
    # that step the environments; 0: one a core, four at most
    threads: kinds.Processes = field(default=0, metadata=kinds.NO_EFFECT_ON_RESULTS)

    def __post_init__(self) -> None:
        """Reads the files, and refuses what contradicts itself."""
        super().__post_init__()
        StartingPolicySettings.__post_init__(self)
        for key in ("phantoms", "targets"):
            if len(getattr(self, key)) > 1:
                raise ConfigurationError(f"stage.{key} names several: a rehearsal has one scan and one target")
        if self.policy is not None and self.fresh:
            raise ConfigurationError("stage.fresh=true starts from nothing: leave out stage.policy")

    def price_of_force(self, task: Task, trial_statistics: TrialStatistics | None = None) -> float:
        """What a newton and step cost in training, 1/N, by the devices, and how the starting policy fared with them."""
        if self.force_penalty is not None:
            return self.force_penalty
        if trial_statistics is not None and not task.two_devices:  # what it need not learn any more is to arrive
            always = trial_statistics.reached == trial_statistics.episodes
            return PRICE_OF_PRESSING if always and trial_statistics.force_p95 > PRESSING else PRICES_OF_FORCE[False]
        return PRICES_OF_FORCE[task.two_devices]

    def fit(self, phantom: Phantom) -> None:
        """Leaves the wire to the stage, which fits it to the only target."""
