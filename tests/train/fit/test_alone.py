"""The trainer by itself: who only trains loads neither a simulator nor what stands above it."""

import subprocess
import sys

PROGRAM = """
import importlib, pkgutil, sys
import mpdt.train.fit as fit
names = [found.name for found in pkgutil.walk_packages(fit.__path__, fit.__name__ + ".")]
for name in names:
    importlib.import_module(name)
print(len(names), *sorted(sys.modules))
"""
ABOVE = ("mpdt.train.run", "mpdt.train.adapt", "mpdt.train.study", "mpdt.train.report")
SIMULATORS = ("mujoco", "metaworld", "gymnasium", "mpdt.data.sim.simulators")


def test_fit_is_loaded_alone():
    command = [sys.executable, "-c", PROGRAM]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    number, *loaded = done.stdout.split()
    assert int(number) >= 8 and "mpdt.train.fit.loop" in loaded
    unwanted = (*ABOVE, "mpdt.train.evaluate", *SIMULATORS)
    assert not [name for name in loaded if name.startswith(unwanted)]
