"""What the operator chooses: devices, anatomy and limits."""
