"""Planning, execution and reports of studies and diagnoses."""

import palpate.workers  # noqa: F401 - before NumPy loads: one thread
