"""The meaning of a field: its quantity, unit and frame."""
