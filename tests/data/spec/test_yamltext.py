import pytest
import yaml

from mpdt.data.spec.yamltext import dump_yaml, load_yaml
from mpdt.errors import SpecError


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e5", 1e5), ("1e-4", 1e-4), ("-.5", -0.5), ("1.", 1.0), ("7", 7), ("-7", -7),
        ("0", 0), ("true", True), ("False", False), ("~", None), ("null", None), ("", None),
        (".inf", float("inf")),
        # YAML 1.1 would read booleans, 750, 493, a date.
        ("on", "on"), ("no", "no"), ("Yes", "Yes"), ("12:30", "12:30"), ("0755", "0755"),
        ("2024-09-01", "2024-09-01"), ("'1'", "1"), ('"1.0.0"', "1.0.0"), ("1.0.0", "1.0.0"),
    ],
)  # fmt: skip
def test_scalars(text, value):
    found = load_yaml(f"a: {text}", "x.yaml")["a"]
    assert found == value
    assert type(found) is type(value)


def test_repeated_keys_are_all_named_with_their_lines():
    with pytest.raises(SpecError) as caught:
        load_yaml("a: 1\nb: {c: 1, d: 2, c: 3}\na: 2\n", "x.yaml")
    assert str(caught.value) == "x.yaml: repeated key; found 'a' in line 3, 'c' in line 2"


def test_broken_yaml_names_the_line():
    with pytest.raises(SpecError, match=r"x\.yaml, line 3: not valid YAML"):
        load_yaml("a: 1\nb: [1, 2\nc: }", "x.yaml")


def test_python_tags_do_not_run():
    with pytest.raises(SpecError, match="not valid YAML"):
        load_yaml("a: !!python/object/apply:os.getcwd []", "x.yaml")


BILLION = "a: &a [x, x, x]\n" + "".join(
    f"{b}: &{b} [*{a}, *{a}, *{a}, *{a}, *{a}, *{a}, *{a}, *{a}, *{a}]\n"
    for a, b in ["ab", "bc", "cd", "de", "ef", "fg", "gh", "hi", "ij"]
)


@pytest.mark.parametrize(
    ("text", "what"),
    [
        (BILLION, "anchors and aliases"),
        ("a: &x 1\nb: *x\n", "anchors and aliases"),
        ("a: *x", "anchors and aliases"),
        ("a: " + "[" * 2000, "nested deeper than 20"),
        ("a: " + "{a: " * 30 + "1" + "}" * 30, "nested deeper than 20"),
        ("a: " + "1" * 5000, "not valid YAML"),
        ("a: \0", "not valid YAML"),
        ("a: !!timestamp 2024-13-45", "not valid YAML"),
    ],
)
def test_small_texts_stay_small(text, what):
    with pytest.raises(SpecError, match=what):
        load_yaml(text, "x.yaml")


def test_other_users_of_yaml_keep_their_rules():
    assert yaml.safe_load("on") is True


@pytest.mark.parametrize("text", ["12e34", "1.0", "true", "null", "~", "", "0", "on", "1.0.0", "é"])
def test_text_is_written_so_that_it_reads_back_as_text(text):
    value = {"b": [text], "a": {text or "x": text}}
    assert load_yaml(dump_yaml(value), "x") == value


def test_dumped_yaml_has_one_form():
    assert (
        dump_yaml({"b": {"d": 1, "c": [1, 2.0]}, "a": None})
        == "a: null\nb:\n  c: [1, 2.0]\n  d: 1\n"
    )
