"""Metrics of navigation episodes as the thesis defines them; beside them contact forces and intervals of shares."""

from cathsim.metrics.episodes import (
    FORCE_LIMIT,
    EpisodeMetrics,
    Statistic,
    Summary,
    force_magnitudes,
    median_depth_mm,
    path_length,
    safety,
    shortest_successful_paths,
    spl,
    summarise,
)

__all__ = [
    "FORCE_LIMIT",
    "EpisodeMetrics",
    "Statistic",
    "Summary",
    "force_magnitudes",
    "median_depth_mm",
    "path_length",
    "safety",
    "shortest_successful_paths",
    "spl",
    "summarise",
]
