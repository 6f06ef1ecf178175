"""Which models are asked for over the network, and what is said when nobody answers."""

from __future__ import annotations

import json
import logging
import socket
import urllib.error
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import huggingface_hub
import pytest
import torch

from mpdt.errors import BackboneError
from mpdt.model import hub, language
from mpdt.model.backbone import BackboneSettings, load_backbone


def cache(monkeypatch: pytest.MonkeyPatch, folder: Path, files: Iterable[str]) -> None:
    """The hub's cache holds these files of every model, empty unless they exist."""
    held = {file: str(folder / file) for file in files}
    monkeypatch.setattr(huggingface_hub, "try_to_load_from_cache", lambda _, file: held.get(file))


@pytest.fixture
def nothing_cached(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    cache(monkeypatch, tmp_path, ())
    monkeypatch.setattr(huggingface_hub.constants, "HF_HUB_OFFLINE", False)


def silent(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """No host answers; the list collects what was asked for."""
    asked: list[str] = []
    monkeypatch.setattr(hub, "_answers", asked.append)
    return asked


@pytest.mark.usefixtures("nothing_cached")
def test_a_silent_host_is_one_error_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = silent(monkeypatch)
    # Its client would try for half a minute.
    monkeypatch.setattr("transformers.AutoConfig.from_pretrained", break_off)
    with pytest.raises(BackboneError, match=r"gpt2: .* cannot be downloaded; found no answer") as e:
        load_backbone("gpt2")
    assert len(asked) == 1 and asked[0].endswith("/gpt2/resolve/main/config.json")
    for way in ("hf download gpt2", "HF_HOME", "local folder", "smollm2-135m"):
        assert way in e.value.hint


@pytest.mark.usefixtures("nothing_cached")
@pytest.mark.parametrize(
    ("name", "guess"), [("gpt3", "gpt2"), ("smolm2-135m", "smollm2-135m"), ("gpt2", None)]
)
def test_short_names_get_the_nearest(
    monkeypatch: pytest.MonkeyPatch, name: str, guess: str | None
) -> None:
    silent(monkeypatch)
    with pytest.raises(BackboneError) as caught:
        load_backbone(name)
    assert ("did you mean" in str(caught.value)) == (guess is not None)
    assert guess is None or f"(did you mean '{guess}'?)" in str(caught.value)


def test_a_missing_folder_is_not_looked_for_on_the_network(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    asked = silent(monkeypatch)
    with pytest.raises(BackboneError, match="no such folder") as caught:
        load_backbone(str(tmp_path / "gone"))
    assert "smollm2-135m" in caught.value.hint and not asked


@pytest.mark.usefixtures("nothing_cached")
def test_offline_never_asks_the_network(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(huggingface_hub.constants, "HF_HUB_OFFLINE", True)
    asked = silent(monkeypatch)
    with pytest.raises(BackboneError, match="HF_HUB_OFFLINE"):
        load_backbone("gpt2")
    assert not asked


def test_only_a_whole_download_counts_as_cached(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    index = {"weight_map": {"a": "1.safetensors", "b": "2.safetensors", "c": "1.safetensors"}}
    (tmp_path / "model.safetensors.index.json").write_text(json.dumps(index))
    whole = {
        ("config.json", "model.safetensors"): True,
        ("model.safetensors",): False,
        ("config.json",): False,
        ("config.json", "model.safetensors.index.json", "1.safetensors"): False,
        ("config.json", "model.safetensors.index.json", "1.safetensors", "2.safetensors"): True,
    }
    for files, cached in whole.items():
        cache(monkeypatch, tmp_path, files)
        assert (hub._cached("gpt2") is not None) is cached, files


@pytest.mark.parametrize(
    "text", ["", "[]", '{"weight_map": []}', "[" * 2000, '{"weight_map": {"a": 1}}']
)
def test_an_index_that_is_none(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, text: str) -> None:
    (tmp_path / "model.safetensors.index.json").write_text(text)
    cache(monkeypatch, tmp_path, ("config.json", "model.safetensors.index.json"))
    with pytest.raises(BackboneError, match="not an index of weights"):
        load_backbone("gpt2")


def test_what_is_cached_is_read_without_the_network(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    cache(monkeypatch, tmp_path, ("config.json", "model.safetensors"))
    asked = silent(monkeypatch)
    assert hub.local_folder("gpt2", []) == tmp_path and not asked


class HalfWayError(Exception):
    """No OSError: what a transport raises when a connection breaks."""


def break_off(*_args: Any, **_options: Any) -> Any:
    raise HalfWayError("connection closed after 12 bytes")


@pytest.mark.usefixtures("nothing_cached")
def test_a_download_that_breaks_off_is_one_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hub, "_answers", lambda url: True)
    monkeypatch.setattr("transformers.AutoConfig.from_pretrained", break_off)
    with pytest.raises(BackboneError, match="connection closed after 12 bytes"):
        load_backbone("gpt2")


def test_the_default_asks_no_network(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor does `auto`, the word that settings of before have for it."""
    asked = silent(monkeypatch)
    monkeypatch.setattr(language, "_smollm2", lambda depth, dtype: "shipped")
    for name in (BackboneSettings().name, "auto"):
        found = language.read_language_model(name, None, torch.float32, 0)
        assert found == ("smollm2-135m", "shipped")
    assert not asked


def test_a_host_that_never_answers_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hub, "_PROBE_S", 0.05)
    with socket.create_server(("127.0.0.1", 0)) as mute:
        assert hub._answers(f"http://127.0.0.1:{mute.getsockname()[1]}/x") is False


@pytest.mark.parametrize(("code", "answers"), [(404, True), (401, True), (503, False)])
def test_a_refusal_is_an_answer(monkeypatch: pytest.MonkeyPatch, code: int, answers: bool) -> None:
    def refuse(*_args: Any, **_options: Any) -> None:
        raise urllib.error.HTTPError("http://x", code, "no", None, None)  # type: ignore[arg-type]

    monkeypatch.setattr(hub.urllib.request, "urlopen", refuse)
    assert hub._answers("http://localhost:9/x") is answers


def test_quiet_keeps_retries_to_itself_and_ends() -> None:
    talk = logging.getLogger("huggingface_hub")
    before = talk.level
    with hub.quiet():
        assert not talk.isEnabledFor(logging.WARNING)
        assert not logging.getLogger("transformers").isEnabledFor(logging.ERROR)
    assert talk.level == before
