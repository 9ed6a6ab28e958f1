"""A human at the controls: live fluoroscopy and 3-D view in the browser, keys that steer the wire, recorded episodes.

`python -m cathsim.console` starts it; it needs the extra `endonav-cathsim[console]`.
"""

from __future__ import annotations

from cathsim.console.questionnaire import CRITERIA, check_answers
from cathsim.console.recorder import NpzRecorder, Recorder

__all__ = ["CRITERIA", "NpzRecorder", "Recorder", "check_answers"]
