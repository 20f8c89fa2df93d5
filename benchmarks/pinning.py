"""Pin the process to one core and one thread. Import before JAX and NumPy."""

import os

CORE = max(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else None

for _name in ("OMP", "OPENBLAS", "MKL", "TBB"):
    os.environ[f"{_name}_NUM_THREADS"] = "1"
os.environ["JAX_PLATFORMS"] = "cpu"
os.environ["XLA_FLAGS"] = (
    os.environ.get("XLA_FLAGS", "")
    + " --xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
)
if CORE is not None:
    os.sched_setaffinity(0, {CORE})
