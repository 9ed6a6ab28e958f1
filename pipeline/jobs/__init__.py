"""Jobs of a stage: processes, their devices, progress and costs."""
