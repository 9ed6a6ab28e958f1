"""Files of a run: folders, manifests, atomic writing, provenance."""
