"""Errors that a user may see.

::

    PalpateError                what was found, what was expected, what to type next
    |-- InputError              a study, an image or an option is wrong; exit code 2
    `-- StoreError              the store cannot be used as it is; exit code 2
        |-- JournalError        a journal is damaged, or another driver is writing it
        `-- NewerSchemaError    written by a newer version than this one

A simulation that does not converge is not an error but a result.
"""

import re

# Longer than any path in use: what is quoted from a damaged file may have thousands of digits.
_LONGEST_WORD = 1000
_ENDLESS = re.compile(rf"\S{{{_LONGEST_WORD},}}")


class PalpateError(Exception):
    """An error that the user can fix; the message explains how.

    Words of more than 1,000 characters are truncated.
    """

    def __str__(self) -> str:
        return _ENDLESS.sub(lambda word: f"{word[0][:60]}...", super().__str__())


class InputError(PalpateError):
    """An invalid or inconsistent input."""


class StoreError(PalpateError):
    """A store that cannot be used as it is."""


class JournalError(StoreError):
    """A journal that cannot be read or written."""


class NewerSchemaError(StoreError):
    """A record written by a newer version of Palpate."""
