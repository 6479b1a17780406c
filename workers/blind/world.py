"""How kind the cases of a blind set are; see `workers.blind.deviations`."""

from enum import StrEnum


class World(StrEnum):
    """How kind the cases of a set are."""

    plain = "plain"
    hard = "hard"
