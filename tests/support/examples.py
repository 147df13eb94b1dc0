"""How many examples a law is tried on: few in each run of the tests (profile `fast`), many in `make torture` (`thorough`)."""

from __future__ import annotations

import os

from hypothesis import settings

PROFILES = {"fast": 0.25, "thorough": 20.0}
"""Name of a profile to what the number of examples of each law is multiplied with."""

_PROFILE = os.environ.get("HYPOTHESIS_PROFILE", "fast")


def examples(number: int) -> int:
    """Return how many examples to try of a law that is worth a number of them."""
    return max(10, round(number * PROFILES[_PROFILE]))


def load_profile() -> None:
    """Use the profile that the environment names, for laws that state no number of examples too."""
    settings.register_profile(_PROFILE, max_examples=examples(100), deadline=None)
    settings.load_profile(_PROFILE)
