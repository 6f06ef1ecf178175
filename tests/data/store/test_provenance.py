import getpass
import platform
import sys
from pathlib import Path

from mpdt.data.store import provenance


def test_packages_name_versions_without_importing():
    before = set(sys.modules)
    found = provenance.packages()
    assert found["python"] == platform.python_version()
    assert found["mujoco"] == "3.3.0"
    assert not {"torch", "mujoco", "metaworld"} & (set(sys.modules) - before)


def test_a_package_not_installed_is_left_out(monkeypatch):
    monkeypatch.setattr(provenance, "_PACKAGES", ("numpy", "no-such-package"))
    assert set(provenance.packages()) == {"python", "hdf5", "numpy"}


def test_machine_names_its_kind_and_nobody():
    found = provenance.machine()
    assert found["arch"] == platform.machine()
    assert all(found.values())
    if "model name" in (known := Path("/proc/cpuinfo").read_text()):
        assert f": {found['cpu']}\n" in known
    text = " ".join(found.values())
    for private in (platform.node(), getpass.getuser(), str(Path.home())):
        assert private not in text
