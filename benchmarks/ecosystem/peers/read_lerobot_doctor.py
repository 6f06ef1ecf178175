"""lerobot-doctor over a LeRobot v3 tree; its warnings are told, a failure is one."""

import importlib.metadata
import pathlib
import re
import subprocess
import sys

program = pathlib.Path(sys.executable).with_name("lerobot-doctor")
done = subprocess.run([program, sys.argv[1]], capture_output=True, text=True, check=False)
found = re.search(r"Summary: (.*)", done.stdout)
assert found and "FAIL" not in found[1], done.stdout + done.stderr
print(importlib.metadata.version("lerobot-doctor"), found[1].replace(" | ", ", "))
