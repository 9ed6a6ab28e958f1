"""Forces from shape: contact forces of a device at rest in a vessel, from its observed curve."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cathsim.lazy_names import lazy_names

if TYPE_CHECKING:
    from cathsim.statics.ensemble_summary import ContactForces as ContactForces
    from cathsim.statics.ensemble_summary import Estimate as Estimate
    from cathsim.statics.estimator import ContactForceEstimator as ContactForceEstimator
    from cathsim.statics.estimator import contact_forces as contact_forces
    from cathsim.statics.observed_curve import curve_from_entry as curve_from_entry
    from cathsim.statics.observed_curve import inserted_curve as inserted_curve
    from cathsim.statics.observed_curve import inserted_part as inserted_part
    from cathsim.statics.observed_curve import noisy_curve as noisy_curve
    from cathsim.statics.shape_series import DrawnErrors as DrawnErrors
    from cathsim.statics.shape_series import drawn_errors as drawn_errors
    from cathsim.statics.uncertainty import Uncertainty as Uncertainty

__getattr__, __dir__, __all__ = lazy_names(
    __name__,
    {
        "ensemble_summary": "ContactForces Estimate",
        "estimator": "ContactForceEstimator contact_forces",
        "observed_curve": "curve_from_entry inserted_curve inserted_part noisy_curve",
        "shape_series": "DrawnErrors drawn_errors",
        "uncertainty": "Uncertainty",
    },
)
