"""Workers: evaluation of a candidate.

One evaluation uses one thread: evaluations run in parallel, and a BLAS that
starts threads for vectors this short makes a solve two to three times slower.
The variables are read when NumPy loads, so they are set before anything else.

Volumes and element arrays are allocated thousands of times in an evaluation. glibc
returns their memory at once (under Dask from 64 kB on), and the kernel then clears
every page again: 13 % of the time of a study of 5000 nodes, 5 % with the two settings
below, which glibc reads when a process starts.
"""

import os

if __name__ != "palpate.workers":
    raise ImportError("Import palpate.workers: a checkout's folder workers is a link to it.")

WORKER_ENVIRONMENT = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "NUMBA_NUM_THREADS": "1",
    "VECLIB_MAXIMUM_THREADS": "1",
    "MALLOC_MMAP_THRESHOLD_": str(32 * 1024**2),  # the maximum accepted by glibc
    "MALLOC_TRIM_THRESHOLD_": str(256 * 1024**2),
}

for _name, _count in WORKER_ENVIRONMENT.items():
    os.environ.setdefault(_name, _count)
