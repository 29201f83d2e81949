"""Runs `tests/several_devices` where there are four devices: the number is fixed before jax begins."""

import os
import subprocess
import sys
from pathlib import Path

FOLDER = Path(__file__).with_name("several_devices")


def test_what_several_devices_do(pytestconfig):
    flags = f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count=4"
    command = [sys.executable, "-m", "pytest", "-p", "no:xdist", "-p", "no:cacheprovider", str(FOLDER)]
    command += ["--long"] * pytestconfig.getoption("--long")
    done = subprocess.run(command, env={**os.environ, "XLA_FLAGS": flags}, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "passed" in done.stdout and "skipped" not in done.stdout
