"""Defines the tree of errors that a user may see.

::

    PalpateError                what was found, what was expected, what to type next
    |-- InputError              a study, an image or an option is wrong; exit code 2
    `-- StoreError              the store cannot be used as it is; exit code 2
        |-- JournalError        a journal is damaged, or another driver is writing it
        `-- NewerSchemaError    written by a newer version than this one

A simulation that does not converge is none of these: it is an outcome.
"""


class PalpateError(Exception):
    """Something that the user can put right; the message says how."""


class InputError(PalpateError):
    """What was asked for makes no sense."""


class StoreError(PalpateError):
    """The store cannot be used as it is."""


class JournalError(StoreError):
    """The journal cannot be read or written."""


class NewerSchemaError(StoreError):
    """A record was written by a newer version of Palpate."""
