"""One thread for linear algebra, in a process that imports this module before NumPy.

The matrices here are small. With a thread per core the threads of processes beside each other wait
for one another, many times as long as the products take. A number of threads that the user asks for
in the environment stays.
"""

import os

_VARIABLES = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")

if not any(name in os.environ for name in _VARIABLES):
    os.environ.update(dict.fromkeys(_VARIABLES, "1"))
