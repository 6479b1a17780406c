"""Decides what is computed, has it computed, and reports the results."""

import workers  # noqa: F401 - before NumPy loads: one thread
