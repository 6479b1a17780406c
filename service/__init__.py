"""What decides and tells."""

import workers  # noqa: F401 - before NumPy loads: one thread
