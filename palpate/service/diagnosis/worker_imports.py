"""Imports of diagnosis workers before their first task; see `service.cluster.worker_startup`.

Imports take 1.2 s, the digest of their code 0.2 s, and the first kernel of any
kind 0.25 s, when numba sets up its compiler.
"""

import numpy as np

import palpate.workers.tasks.diagnosis_tasks  # noqa: F401
from palpate.workers.body.mesh.mesh_geometry import elements_of_nodes
from palpate.workers.tasks.diagnosis_store import diagnosis_code

diagnosis_code("scanned case")
elements_of_nodes(np.zeros((1, 4), np.int32), 1)
