"""Planning, execution and reports of studies and diagnoses."""

import palpate.workers  # noqa: F401 - before NumPy loads: one thread

if __name__ != "palpate.service":
    raise ImportError("Import palpate.service: a checkout's folder service is a link to it.")
