"""The report: every table of the thesis beside what was measured here, with figures and provenance, as one page."""
