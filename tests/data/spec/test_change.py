from __future__ import annotations

from mpdt.data.spec.change import changed_keys


def test_changed_keys_by_hand():
    old = {"a": 1, "b": {"c": [1, 2], "d": "x"}, "e": None}
    new = {"a": 1, "b": {"c": [1, 3], "d": "x"}, "f": True}
    assert changed_keys(old, new) == ["b.c [1, 2] -> [1, 3]", "f absent -> true"]
    assert changed_keys(old, old) == []
    assert changed_keys({"a": None}, {"a": 1}) == ["a null -> 1"]


def test_a_field_that_a_later_release_adds_without_a_value_changes_nothing():
    assert changed_keys({"a": 1}, {"a": 1, "goals": None}) == []
