"""What turns a candidate into a number.

One evaluation uses one thread: evaluations run side by side, and a BLAS that
spins up threads for vectors this short makes a solve two to three times slower.
The variables are read when NumPy loads, so they are set before anything else.

Volumes and element arrays come and go thousands of times in an evaluation. glibc
gives their memory back at once, Dask has it do so from 64 kB on, and the kernel then
clears every page anew: 13 % of the time of a study of 5000 nodes, 5 % with these.
glibc reads these two when a process starts.
"""

import os

WORKER_ENVIRONMENT = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "NUMBA_NUM_THREADS": "1",
    "VECLIB_MAXIMUM_THREADS": "1",
    "MALLOC_MMAP_THRESHOLD_": str(32 * 1024**2),  # the most that glibc takes
    "MALLOC_TRIM_THRESHOLD_": str(256 * 1024**2),
}

for _name, _count in WORKER_ENVIRONMENT.items():
    os.environ.setdefault(_name, _count)
