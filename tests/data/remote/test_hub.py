"""push and pull of hf:// through huggingface_hub, against a hub of a few routes on loopback."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import fsspec.config
import pytest
from aiohttp import web

from mpdt.data.remote.pull import pull
from mpdt.data.remote.push import push
from mpdt.errors import DataError, UsageError

Loop = Any


class Hub:
    """A repository, `datasets/me/set`, and `me/policy` of models with the same files.

    Takes a commit for the token `hf_right` alone.
    """

    def __init__(self) -> None:
        self.files: dict[str, bytes] = {}
        self.commits: list[list[str]] = []
        self.cards: list[dict[str, Any]] = []
        app = web.Application(client_max_size=1 << 28)
        for api, files in (("/api/datasets/me/set", "/datasets/me/set"),
                           ("/api/models/me/policy", "/me/policy")):  # fmt: skip
            app.router.add_get(api, self.repository)
            app.router.add_get(api + "/revision/main", self.repository)
            app.router.add_post(api + "/paths-info/main", self.paths_info)
            app.router.add_get(api + "/tree/main{folder:.*}", self.tree)
            app.router.add_post(api + "/preupload/main", self.preupload)
            app.router.add_post(api + "/commit/main", self.commit)
            app.router.add_get(files + "/resolve/main/{path:.*}", self.resolve)
        app.router.add_post("/api/validate-yaml", self.validate)
        app.router.add_route("*", "/{path:.*}", self.no_repository)
        self.runner = web.AppRunner(app, access_log=None)

    async def start(self) -> str:
        await self.runner.setup()
        await web.TCPSite(self.runner, "127.0.0.1", 0).start()
        return f"http://127.0.0.1:{self.runner.addresses[0][1]}"

    async def repository(self, request: web.Request) -> web.Response:
        return web.json_response({"id": "me/set", "sha": "0" * 40, "siblings": []})

    async def validate(self, request: web.Request) -> web.Response:
        """What the client asks before it sends a README.md."""
        self.cards.append(await request.json())
        return web.json_response({"errors": [], "warnings": []})

    async def no_repository(self, request: web.Request) -> web.Response:
        return web.Response(status=404, headers={"X-Error-Code": "RepoNotFound"})

    async def paths_info(self, request: web.Request) -> web.Response:
        wanted = (await request.post()).getall("paths")
        if request.content_type == "application/json":
            wanted = (await request.json())["paths"]
        return web.json_response([self.row(name) for name in wanted if name in self.files])

    async def tree(self, request: web.Request) -> web.Response:
        folder = request.match_info["folder"].lstrip("/")
        below = [name for name in self.files if name.startswith(f"{folder}/".lstrip("/"))]
        if not below and folder:
            return web.Response(status=404, headers={"X-Error-Code": "EntryNotFound"})
        return web.json_response([self.row(name) for name in below])

    def row(self, name: str) -> dict[str, Any]:
        content = self.files[name]
        oid = hashlib.sha1(content).hexdigest()
        return {"type": "file", "path": name, "size": len(content), "oid": oid}

    async def preupload(self, request: web.Request) -> web.Response:
        names = [file["path"] for file in (await request.json())["files"]]
        return web.json_response({
            "files": [{"path": name, "uploadMode": "regular", "shouldIgnore": False, "oid": None}
                      for name in names]
        })  # fmt: skip

    async def commit(self, request: web.Request) -> web.Response:
        if request.headers.get("authorization") != "Bearer hf_right":
            return web.json_response({"error": "no"}, status=403)
        lines = [json.loads(line) for line in (await request.text()).splitlines()]
        files = [line["value"] for line in lines if line["key"] == "file"]
        self.files |= {file["path"]: base64.b64decode(file["content"]) for file in files}
        self.commits.append([file["path"] for file in files])
        oid = f"{len(self.commits):040d}"
        return web.json_response(
            {"success": True, "commitOid": oid, "commitUrl": f"{request.url.origin()}/x/{oid}"}
        )

    async def resolve(self, request: web.Request) -> web.StreamResponse:
        content = self.files.get(request.match_info["path"])
        if content is None:
            return web.Response(status=404, headers={"X-Error-Code": "EntryNotFound"})
        part = content[request.http_range]
        headers = {"ETag": f'"{hashlib.sha1(content).hexdigest()}"', "X-Repo-Commit": "0" * 40,
                   "Accept-Ranges": "bytes"}  # fmt: skip
        return web.Response(body=part, status=206 if len(part) < len(content) else 200,
                            headers=headers)  # fmt: skip


@pytest.fixture
def hub(loop: Loop, monkeypatch: pytest.MonkeyPatch) -> Iterator[Hub]:
    hub = Hub()
    monkeypatch.setitem(fsspec.config.conf, "hf", {"endpoint": loop.run(hub.start())})
    monkeypatch.setenv("HF_TOKEN", "hf_right")
    monkeypatch.setattr("os.fsync", lambda handle: None)  # no test pulls the plug
    yield hub
    loop.run(hub.runner.cleanup())


def test_a_file_goes_to_the_hub_and_back(hub: Hub, collected: Path, tmp_path: Path) -> None:
    """One commit for the file and its sum; the second time there is nothing to do."""
    sent = push(collected, "hf://datasets/me/set")
    assert sent.address == "hf://datasets/me/set/tiny.h5"
    assert hub.commits == [["tiny.h5", "tiny.h5.sha256"]]
    assert hub.files["tiny.h5"] == collected.read_bytes()
    assert push(collected, "hf://datasets/me/set").num_new_bytes == 0 and len(hub.commits) == 1
    found = pull("hf://datasets/me/set/tiny.h5", tmp_path / "back.h5")
    assert (found.proof, found.num_new_bytes) == ("sums", collected.stat().st_size)
    assert (tmp_path / "back.h5").read_bytes() == collected.read_bytes()


def test_a_folder_is_one_commit(hub: Hub, tmp_path: Path) -> None:
    folder = tmp_path / "set"
    (folder / "data").mkdir(parents=True)
    (folder / "data/a.parquet").write_bytes(bytes(range(256)))
    (folder / "notes.txt").write_text("hello\n")
    push(folder, "hf://datasets/me/set")
    assert hub.commits == [["data/a.parquet", "notes.txt", "SHA256SUMS"]]
    assert pull("hf://datasets/me/set", tmp_path / "back").num_files == 2
    assert (tmp_path / "back/data/a.parquet").read_bytes() == bytes(range(256))
    (folder / "notes.txt").write_text("other\n")
    with pytest.raises(DataError, match="something else is there already"):
        push(folder, "hf://datasets/me/set")
    push(folder, "hf://datasets/me/set", replace=True)
    assert hub.commits[1:] == [["notes.txt", "SHA256SUMS"]]


def test_who_may_not_is_told_so(
    hub: Hub, collected: Path, monkeypatch: pytest.MonkeyPatch
) -> None:  # fmt: skip
    """The token is the library's affair, and no word of it appears."""
    monkeypatch.setenv("HF_TOKEN", "hf_wrong")
    with pytest.raises(ConnectionError, match="no permission") as caught:
        push(collected, "hf://datasets/me/set")
    assert "hf_wrong" not in caught.value.render() and not hub.files
    with pytest.raises(UsageError, match="no such repository"):
        push(collected, "hf://datasets/me/other/x.h5")
    with pytest.raises(UsageError, match="not a dataset repository"):
        push(collected, "hf://me/model/x.h5")
