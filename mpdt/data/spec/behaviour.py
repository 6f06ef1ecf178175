"""Who acts in the episodes of an entry, and what is refused of it."""

from __future__ import annotations

import math

import msgspec


class Behaviour(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Who acts: a behaviour network, a script or a trained policy, exactly one of the three.

    Args:
        network: name of the shipped weights, or the path of one's own without suffix, such as
            `./weights/cheetah_dir`; what has a slash or begins with a dot is a path.
        script: one of the family's own, such as `metaworld`.
        bundle: folder of a policy of `mpdt-train`; a task acts behind its own prompt.
        start: of the bundle's sets of prompts the one for tasks that have no own.
        rungs: number of policies on the ladder from untrained to final.
        noise: standard deviation of the Gaussian added to the actions of all but Meta-World's
            scripts, in their unit.
    """

    network: str | None = None
    script: str | None = None
    rungs: int = 20
    noise: float = 0.0
    # Unset, they are no part of what is hashed: entries of before keep their hashes.
    bundle: str | msgspec.UnsetType = msgspec.UNSET
    start: str | msgspec.UnsetType = msgspec.UNSET


def is_own_network(network: str | None) -> bool:
    """Whether `behaviour.network` is a path, and not the name of shipped weights."""
    return network is not None and ("/" in network or network.startswith("."))


def own_weights(behaviour: Behaviour) -> str:
    """Path of what acts, if it is not of mpdt; empty otherwise."""
    if behaviour.bundle:
        return behaviour.bundle
    return behaviour.network or "" if is_own_network(behaviour.network) else ""


def behaviour_problems(behaviour: Behaviour) -> list[tuple[str, str, str]]:
    """Every mistake that the types cannot catch, as (key path, what, hint)."""
    problems = list[tuple[str, str, str]]()
    given = (behaviour.network is not None, behaviour.script is not None,
             behaviour.bundle is not msgspec.UNSET)  # fmt: skip
    if sum(given) != 1:
        problems.append(("behaviour", "needs exactly one of network, script and bundle", ""))
    elif given[2] and (not behaviour.bundle or "://" in str(behaviour.bundle)):
        problems.append(("behaviour.bundle", f"{behaviour.bundle!r} is no folder",
                         "mpdt-train pull brings a policy from an address"))  # fmt: skip
    if behaviour.start is not msgspec.UNSET and not given[2]:
        problems.append(("behaviour.start", "names prompts of a bundle", "leave it out"))
    if not (math.isfinite(behaviour.noise) and behaviour.noise >= 0):
        problems.append(("behaviour.noise", f"{behaviour.noise} is not a noise", "0 or more"))
    return problems
