"""The digest's recipe, spelled out with hashlib once more, and pinned."""

import hashlib
import struct
from dataclasses import replace

import numpy as np
import pytest
from makers import make_episode

from mpdt.data.store.digest import content_hash, content_header, episode_digest

ONE_STEP = make_episode(
    1, 0.5, (1, 1), task=1, quality=2, block=3, row=4, progress=0.75, policy=bytes(range(32)),
    actions=np.array([[-1.0]], np.float32), rewards=np.array([2.0], np.float32),
)  # fmt: skip
PINNED = "6dd0f8481b4521722ca3b1ebc357b894d6f4ad463c1dcd491cc67f99943cec7e"


def test_recipe_byte_by_byte():
    text = b"".join([
        b"observations\0<f4\x002,1\0", struct.pack("<2f", 0.5, 1.5),
        b"actions\0<f4\x001,1\0", struct.pack("<f", -1.0),
        b"rewards\0<f4\x001\0", struct.pack("<f", 2.0),
        b"terminations\0|b1\x001\0", b"\0",
        b"truncations\0|b1\x001\0", b"\1",
        b"task\0|u1\x008\0", b"backward",
        b"goal\0<f8\x001\0", struct.pack("<d", -1.0),
        b"quality\0|i1\0\0", b"\2",
        b"progress\0<f4\0\0", struct.pack("<f", 0.75),
        b"policy\0|u1\x0032\0", bytes(range(32)),
        b"seed_key\0<u4\x005\0", struct.pack("<5I", 0, 1, 2, 3, 4),
    ])  # fmt: skip
    assert episode_digest(ONE_STEP, "backward") == hashlib.sha256(text).digest()
    assert hashlib.sha256(text).hexdigest() == PINNED


@pytest.mark.parametrize(
    "change",
    [
        {"observations": np.array([[0.5], [1.25]], np.float32)},
        {"actions": np.array([[1.0]], np.float32)},
        {"rewards": np.array([-2.0], np.float32)},
        {"terminations": np.array([True])},
        {"successes": np.array([False])},
        {"goal": np.array([-1.0, 0.0])},
        {"quality": 1},
        {"progress": 0.5},
        {"policy": bytes(32)},
        {"seed_key": (0, 1, 2, 3, 5)},
    ],
)
def test_every_part_counts(change):
    assert episode_digest(replace(ONE_STEP, **change), "backward").hex() != PINNED


def test_the_task_counts_by_name_not_by_number():
    assert episode_digest(ONE_STEP, "forward").hex() != PINNED
    assert episode_digest(replace(ONE_STEP, task=7), "backward").hex() == PINNED


def test_memory_order_does_not_count():
    wide = np.asfortranarray(np.arange(6, dtype=np.float32).reshape(2, 3))
    plain = replace(ONE_STEP, observations=np.ascontiguousarray(wide))
    assert episode_digest(replace(plain, observations=wide), "a") == episode_digest(plain, "a")


def test_content_hash_recipe():
    header = content_header("cheetah_dir", ["forward"], 20, 6, has_success=False)
    text = (
        b'{"action_size":6,"family":"cheetah_dir","fields":["observations","actions","rewards",'
        b'"terminations","truncations"],"format":"mpdt/1","observation_size":20,'
        b'"tasks":["forward"]}'
    )
    digests = [bytes([1] * 32), bytes([2] * 32)]
    wanted = hashlib.sha256(text + b"".join(digests)).hexdigest()
    assert content_hash(header, digests) == wanted
    table = np.frombuffer(b"".join(digests), np.uint8).reshape(2, 32)
    assert content_hash(header, table) == wanted
    assert content_hash(header, reversed(digests)) != wanted
    assert content_header("f", [], 1, 1, has_success=True)["fields"][-1] == "successes"
