"""What the trackers' own packages wrote, read back: after a kill nothing is missing or twice.

A process is killed at a moment that comes from the run itself, and the same command is given again.
Slow, and left out without the packages; `make ecosystem` has them.
"""

import importlib.util
import json
import os
import signal
import subprocess
import sys
import time

import pytest

from ..run.command import QUICK

pytestmark = pytest.mark.slow
SHORT = [*QUICK, "--multitask.log-every", "2", "--multitask.checkpoint-every", "4", "-q"]


def environment(tmp_path):
    return os.environ | {
        "WANDB_MODE": "offline", "TRACKIO_DIR": str(tmp_path / "trackio"),
        "PYTHONPATH": os.pathsep.join(path for path in sys.path if path),
    }  # fmt: skip


def run(tmp_path, data, tracker, name, kill_after=None):
    """One command; killed with SIGKILL once metrics.jsonl has so many lines."""
    words = ["-m", "mpdt.train.cli", "--data", data, *SHORT, "--log", tracker, "--name", name]
    process = subprocess.Popen(
        [sys.executable, *map(str, words)], cwd=tmp_path, env=environment(tmp_path),
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    log = tmp_path / "runs" / name / "metrics.jsonl"
    while kill_after is not None and process.poll() is None:
        if log.exists() and log.read_bytes().count(b"\n") >= kill_after:
            process.send_signal(signal.SIGKILL)
            break
        time.sleep(0.02)
    said = process.communicate()[1]
    assert process.returncode == (0 if kill_after is None else -signal.SIGKILL), said
    assert "left alone" not in said
    return log


def wanted(log):
    """(update, action loss) of every line that has one, by phase."""
    lines = [json.loads(line) for line in log.read_text().splitlines()]
    return {
        phase: [(line["step"], pytest.approx(line["action_loss"], rel=1e-6)) for line in lines
                if line["phase"] == phase]
        for phase in ("teacher", "student")
    }, lines  # fmt: skip


def read_tensorboard(tmp_path, name, lines):
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    read = EventAccumulator(str(tmp_path / "runs" / name / "tensorboard"))
    read.Reload()
    tags = read.Tags()
    assert {"prompts/P_c", "prompts/P_0"} <= set(tags["images"])
    assert "settings/text_summary" in tags["tensors"]
    (told,) = read.Tensors("tags/text_summary")
    assert b"cheetah_dir" in told.tensor_proto.string_val[0] and b"data-" in (
        told.tensor_proto.string_val[0])  # fmt: skip
    assert len(read.Scalars("test mean return/MPDT from cross, adapted")) == 1
    return {
        phase: [(e.step, e.value) for e in read.Scalars(f"{phase}/action_loss")]
        for phase in ("teacher", "student")
    }


def records(path):
    """Records of a session of W&B: blocks of 32 KiB with pieces of (CRC, length, kind)."""
    from wandb.proto import wandb_internal_pb2 as wandb_pb2

    content, at, piece = path.read_bytes(), 7, b""
    while at + 7 <= len(content):
        if 32768 - at % 32768 < 7:
            at += 32768 - at % 32768
            continue
        length, kind = int.from_bytes(content[at + 4 : at + 6], "little"), content[at + 6]
        piece += content[at + 7 : at + 7 + length]
        at += 7 + length
        if kind in (1, 4):
            yield wandb_pb2.Record.FromString(piece)
            piece = b""


def read_wandb(tmp_path, name, lines):
    sessions = sorted((tmp_path / "runs" / name / "wandb").glob("offline-run-*"))
    found, ids, steps, config = {"teacher": [], "student": []}, set(), [], {}
    for session in sessions:
        (path,) = session.glob("*.wandb")
        for record in records(path):
            kind = record.WhichOneof("record_type")
            if kind == "run":
                ids.add(record.run.run_id)
                assert any(tag.startswith("data-") for tag in record.run.tags)
                config |= {item.key: item.value_json for item in record.run.config.update}
            elif kind == "history":
                row = {"/".join(item.nested_key) or item.key: json.loads(item.value_json)
                       for item in record.history.item}  # fmt: skip
                steps.append(row["_step"])
                for phase, points in found.items():
                    if f"{phase}/action_loss" in row:
                        points.append((row[f"{phase}/update"], row[f"{phase}/action_loss"]))
    assert len(ids) == 1 and steps == list(range(len(lines) + 1))
    assert json.loads(config["multitask"])["log_every"] == 2 and "mpdt" in config["described"]
    assert list(sessions[-1].glob("files/media/images/prompts/*.png"))
    return found


def read_trackio(tmp_path, name, lines):
    program = (
        "import json, sys; from trackio.sqlite_storage import SQLiteStorage as S\n"
        "runs = [r for r in S.get_runs('mpdt') if r.startswith(sys.argv[1] + '-')]\n"
        "print(json.dumps([runs, S.get_logs('mpdt', runs[0]), S.get_run_config('mpdt', runs[0])]))"
    )
    done = subprocess.run([sys.executable, "-c", program, name], env=environment(tmp_path),
                          capture_output=True, text=True, check=True)  # fmt: skip
    runs, rows, config = json.loads(done.stdout.splitlines()[-1])
    assert len(runs) == 1 and [row["step"] for row in rows] == list(range(len(lines) + 1))
    assert any(tag.startswith("data-") for tag in config["tags"])
    assert rows[-1]["prompts/P_c"]["_type"] == "trackio.image"
    return {
        phase: [(row["update"], row[f"{phase}/action_loss"]) for row in rows
                if f"{phase}/action_loss" in row]
        for phase in ("teacher", "student")
    }  # fmt: skip


READ = {"tensorboard": read_tensorboard, "wandb": read_wandb, "trackio": read_trackio}


@pytest.mark.parametrize("tracker", READ)
def test_what_the_package_wrote(tmp_path, tiny_file, tracker):
    if importlib.util.find_spec(tracker) is None:
        pytest.skip(f"{tracker} is not installed")
    for kill_after in (3, 14):
        run(tmp_path, tiny_file, tracker, "killed", kill_after)
    log = run(tmp_path, tiny_file, tracker, "killed")
    run(tmp_path, tiny_file, tracker, "killed")  # a finished run has nothing to tell
    points, lines = wanted(log)
    assert READ[tracker](tmp_path, "killed", lines) == points
    assert len(points["student"]) == 10


def test_several_at_once(tmp_path, tiny_file):
    names = [name for name in READ if importlib.util.find_spec(name)]
    if len(names) < 2:
        pytest.skip("one tracker or none is installed")
    log = run(tmp_path, tiny_file, ",".join(names), "all")
    points, lines = wanted(log)
    for name in names:
        assert READ[name](tmp_path, "all", lines) == points
