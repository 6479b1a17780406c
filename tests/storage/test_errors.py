"""Messages of errors that a user may see."""

import pickle

from palpate.storage.errors import InputError


def test_very_long_words_are_truncated() -> None:
    digits, path = "9" * 5000, "/data/" + "a" * 900
    error = InputError(f"{path}, line 4: stress_kpa is not a number, found {digits!r}.")
    expected = f"{path}, line 4: stress_kpa is not a number, found '{'9' * 59}..."
    assert str(error) == expected
    assert str(pickle.loads(pickle.dumps(error))) == expected
