"""The task ArchVariety: random points in arches of six branching types, a new arch each episode."""
