"""What a reconstruction costs, measured: ``python -m benchmarks [section ...]`` writes into ``results/``.

Everything runs on one thread: the libraries read their settings when first imported, which is after this.
"""

import os

for _setting in ("OMP", "OPENBLAS", "MKL", "NUMBA"):
    os.environ[f"{_setting}_NUM_THREADS"] = "1"
os.environ["OPENCV_FOR_THREADS_NUM"] = "1"
