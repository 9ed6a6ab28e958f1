"""Forces from shape: contact forces of a device at rest in a vessel, from its observed curve."""

from cathsim.statics.ensemble_summary import ContactForces, Estimate
from cathsim.statics.estimator import ContactForceEstimator, contact_forces
from cathsim.statics.observed_curve import curve_from_entry, inserted_curve, inserted_part
from cathsim.statics.shape_series import DrawnErrors, drawn_errors, noisy_curve
from cathsim.statics.uncertainty import Uncertainty

__all__ = [
    "ContactForceEstimator",
    "ContactForces",
    "DrawnErrors",
    "Estimate",
    "Uncertainty",
    "contact_forces",
    "curve_from_entry",
    "drawn_errors",
    "inserted_curve",
    "inserted_part",
    "noisy_curve",
]
