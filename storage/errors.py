"""Errors that a user may see.

::

    PalpateError                what was found, what was expected, what to type next
    |-- InputError              a study, an image or an option is wrong; exit code 2
    `-- StoreError              the store cannot be used as it is; exit code 2
        |-- JournalError        a journal is damaged, or another driver is writing it
        `-- NewerSchemaError    written by a newer version than this one

A simulation that does not converge is not an error but a result.
"""


class PalpateError(Exception):
    """An error that the user can fix; the message explains how."""


class InputError(PalpateError):
    """An invalid or inconsistent input."""


class StoreError(PalpateError):
    """A store that cannot be used as it is."""


class JournalError(StoreError):
    """A journal that cannot be read or written."""


class NewerSchemaError(StoreError):
    """A record written by a newer version of Palpate."""
