"""The version, and how files name it."""

__version__ = "0.1.0"

LIBRARY = f"ml_dash_mcap {__version__}"
