"""The setting of a policy that a training starts from, declared once."""

from __future__ import annotations

from pathlib import Path

from pipeline.settings.checks import validated
from pipeline.settings.kinds import PathText
from pipeline.store.errors import ConfigurationError
from pipeline.store.provenance import hash_file


@validated()
class StartingPolicySettings:
    """A file with a policy and its critics; results depend on what is in it."""

    policy: PathText | None = None
    policy_sha256: str | None = None  # filled in

    def __post_init__(self) -> None:
        """Reads the file.

        Raises:
            ConfigurationError: there is none.
        """
        self.policy_sha256 = None
        if self.policy is not None:
            if not Path(self.policy).is_file():
                raise ConfigurationError(
                    f"stage.policy={self.policy} is no file: give a policy.pt that was saved with critics"
                )
            self.policy_sha256 = hash_file(Path(self.policy))
