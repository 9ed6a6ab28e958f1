"""Networks of the policies and encoders."""
