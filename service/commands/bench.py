"""`palpate bench`."""


def bench() -> None:
    """x"""
