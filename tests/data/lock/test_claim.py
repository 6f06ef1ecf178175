import pytest

from mpdt.data.lock.claim import Claim, claim_of, next_version

SPEC = {"tasks": ["a"], "seed": 1, "license": "MIT", "episodes": {"random": 4, "expert": 0},
        "tta": {"default": {"episodes": 2}}, "goals": None}  # fmt: skip


@pytest.mark.parametrize(
    ("old", "new", "claim"),
    [
        ("1.2.3", "1.2.3", Claim.SAME),
        ("1.2.3", "1.2.4", Claim.PATCH),
        ("1.2.3", "1.3.0", Claim.MINOR),
        ("1.2.3", "1.10.0", Claim.MINOR),  # numbers, not text
        ("1.9.9", "2.0.0", Claim.MAJOR),
        ("1.2.3", "1.2.2", Claim.BACK),
        ("2.0.0", "1.9.9", Claim.BACK),
        ("1.0.0+smoke", "1.0.0+other", Claim.SAME),
        ("1.0.0+smoke", "1.1.0+smoke", Claim.MINOR),
        ("1.0.0-rc1", "1.0.0-rc1", Claim.SAME),
        ("1.0.0-rc1", "1.0.0-rc2", Claim.MAJOR),
        ("1.0.0-rc1", "1.0.0", Claim.MAJOR),
        ("1.0.0", "1.0.0-rc1", Claim.BACK),
    ],
)
def test_claims(old, new, claim):
    assert claim_of(old, new) is claim


@pytest.mark.parametrize(
    ("change", "version"),
    [
        ({"license": "CC0-1.0"}, "1.0.1"),
        ({"episodes": {"random": 5, "expert": 0}}, "1.1.0"),
        ({"episodes": {"random": 4, "expert": 9}}, "1.1.0"),
        ({"episodes": {"random": 3, "expert": 9}}, "2.0.0"),
        ({"tasks": ["a", "b"]}, "1.1.0"),
        ({"tasks": "all"}, "1.1.0"),
        ({"tasks": ["b"]}, "2.0.0"),
        ({"tta": {"default": {"episodes": 2}, "wide": {"episodes": 9}}}, "1.1.0"),
        ({"tta": {}}, "2.0.0"),
        ({"seed": 2}, "2.0.0"),
    ],
)
def test_the_version_a_change_calls_for(change, version):
    assert next_version("1.0.0", SPEC, SPEC | change) == version
    assert next_version("1.0.0+smoke", SPEC, SPEC | change) == f"{version}+smoke"
