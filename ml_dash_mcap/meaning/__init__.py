"""What a field is: its quantity, unit and frame."""
