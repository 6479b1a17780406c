"""Difficulty of the cases of a blind set; see `workers.blind.deviations`."""

from enum import StrEnum


class World(StrEnum):
    """Difficulty of the cases of a set."""

    plain = "plain"
    hard = "hard"
