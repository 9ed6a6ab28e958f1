"""Where jobs run: processes of this machine, or tasks of a cluster."""
