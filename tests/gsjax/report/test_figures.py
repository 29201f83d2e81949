"""matplotlib is imported by one thread at a time."""

import subprocess
import sys

PROGRAM = """
import sys, threading
from gsjax.report.figures import new_figure, round_ticks
sys.setswitchinterval(1e-6)
faults, start = [], threading.Barrier(6)
def draw(turn):
    start.wait()
    try:
        new_figure(2, 1).subplots() if turn % 2 else round_ticks(0, 1, 5)
    except Exception as fault:
        faults.append(fault)
threads = [threading.Thread(target=draw, args=(turn,)) for turn in range(6)]
for thread in threads: thread.start()
for thread in threads: thread.join()
assert not faults, faults
assert "matplotlib.pyplot" not in sys.modules
"""


def test_threads_that_draw_at_once_meet_no_half_loaded_module():
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
