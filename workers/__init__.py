"""What turns a candidate into a number.

One evaluation uses one thread: evaluations run side by side, and a BLAS that
spins up threads for vectors this short makes a solve two to three times slower.
The variables are read when NumPy loads, so they are set before anything else.
"""

import os

THREAD_ENVIRONMENT = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "NUMBA_NUM_THREADS": "1",
    "VECLIB_MAXIMUM_THREADS": "1",
}

for _name, _count in THREAD_ENVIRONMENT.items():
    os.environ.setdefault(_name, _count)
