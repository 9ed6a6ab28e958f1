"""The stage rehearsal: a policy for one anatomy, trained in perturbed copies of its scan."""
