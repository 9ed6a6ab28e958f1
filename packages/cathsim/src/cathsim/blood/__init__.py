"""Blood: its flow, the drag on the wire, and their plots."""
