"""Decides what is computed, has it computed, and reports the results."""

import palpate.workers  # noqa: F401 - before NumPy loads: one thread
