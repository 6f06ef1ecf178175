"""`mpdt-data info --check`: what is missing here, for what, and how to get it."""

from __future__ import annotations

import json
import tomllib
from importlib import metadata
from pathlib import Path

import pytest

from mpdt.data.cli import main
from mpdt.data.verbs.needs import DEVELOPERS, FOR, REQUIRED, Need, needs

HERE = {"numpy": "2.4.6", "sshfs": "2025.1", "aiohttp": "3.14.5"}


class Installed:
    """Metadata of an mpdt that asks for these, beside the packages of `HERE`."""

    asked = ("numpy==2.4.6", "sshfs>=2026.8; extra == 'remote'", "aiohttp>=3.14; extra == 'remote'",
             "ray>=2.50; extra == 'ray'", "gone; python_version < '3'")  # fmt: skip

    @pytest.fixture(autouse=True)
    def installed(self, monkeypatch: pytest.MonkeyPatch) -> None:
        def version(name: str) -> str:
            if name not in HERE:
                raise metadata.PackageNotFoundError(name)
            return HERE[name]

        monkeypatch.setattr(metadata, "requires", lambda _: list(self.asked))
        monkeypatch.setattr(metadata, "version", version)


def of(part: str) -> Need:
    return next(one for one in needs() if one.part == part)


def test_every_extra_is_told_of() -> None:
    text = (Path(__file__).parents[3] / "pyproject.toml").read_text()
    extras = set(tomllib.loads(text)["project"]["optional-dependencies"])
    assert extras == (set(FOR) - {REQUIRED}) | DEVELOPERS


class TestWhatIsMissing(Installed):
    def test_it_is_named_with_what_brings_it(self) -> None:
        assert of(REQUIRED).lacks == () and of(REQUIRED).get == ""
        assert of("ray").lacks == ("ray",) and of("ray").get == "pip install 'mpdt[ray]'"

    def test_a_version_that_will_not_do_is_missing(self) -> None:
        assert of("remote").lacks == ("sshfs>=2026.8 (here 2025.1)",)

    def test_an_installation_older_than_its_code_says_so(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        class Old:
            def get_all(self, _: str) -> list[str]:
                return ["remote"]

        monkeypatch.setattr(metadata, "metadata", lambda _: Old())
        assert of("ray").lacks == ("this installation of mpdt is older than its code",)

    def test_what_is_needed_for_everything_ends_with_2(
        self, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        assert main(["info", "--check", "--json"]) == 0
        assert {one["part"] for one in json.loads(capsys.readouterr().out)} > {"ray", "weights"}
        monkeypatch.setitem(HERE, "numpy", "1.26")
        assert main(["info", "--check"]) == 2
        told = capsys.readouterr()
        assert "numpy==2.4.6 (here 1.26)" in told.out and "pip install mpdt" in told.err
