import os
import platform
import subprocess
import sys

import pytest


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="glibc's allocator")
def test_memory_that_was_used_is_not_mapped_anew():
    program = """
import resource, sys
import numpy as np
from gsjax.cli import environment
if sys.argv[1] == "kept":
    environment.keep_memory()
def pages():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    np.empty(10_000_000, np.float32).fill(1)
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before
pages()
print(pages())
"""
    found = {}
    for kind in ("kept", "given back"):
        environ = {name: value for name, value in os.environ.items() if not name.startswith("MALLOC_")}
        environ["NUMPY_MADVISE_HUGEPAGE"] = "0"  # Of huge pages there are too few to count.
        command = [sys.executable, "-c", program, kind]
        found[kind] = int(subprocess.run(command, check=True, capture_output=True, text=True, env=environ).stdout)
    assert found["kept"] < 100 < found["given back"]
