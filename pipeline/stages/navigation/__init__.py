"""The stage navigation: autonomous navigation on predicted curves."""
