"""What readings are written as: tables, JSON, pictures, and a page with the wire in space."""
