"""The stages of the thesis as runs on disk: configuration, artifacts, episode logs and the report."""
