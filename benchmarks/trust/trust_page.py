"""Write docs/trust.md from what the scripts beside it and tools/mutants.py found.

python benchmarks/trust/trust_page.py [--results results/trust]
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from mpdt.draw.table import markdown_table

ROOT = Path(__file__).parents[2]
HEAD = """# What was done to the data, and what it withstood

Written by `make trust` from `results/trust/`; do not edit. Small versions of all of it run in
`make test`.

## What is promised

- The same entry gives the same content hash with any number of workers, processes or Ray tasks,
  after any kill: same package versions, same CPU type and BLAS kernels, same shipped weights.
- Everything a file says is covered: episodes by a digest each, the rest by the seal.
  `mpdt-data verify FILE` recomputes both.
- A file leads nowhere else: links, external and virtual arrays are refused, in files of ours and in
  imports; sizes that it declares are compared with its own before anything is read.
- No command passes damage on: what is copied or trained on is compared with its digests.
- Reading data runs no code: HDF5, safetensors and JSON; foreign pickles go through a reader that
  builds plain values and arrays and refuses everything else. `np.load(allow_pickle=True)` and
  `torch.load` appear nowhere (a test looks).

## What cannot be promised

- Another MuJoCo version gives other trajectories; another CPU type or BLAS kernel may give network
  policies another last bit, which contacts amplify (decision 0008 has the kernels that agree).
  Random and TTA episodes, and Meta-World's scripts, use no matrix product of ours.
- libhdf5 itself can crash or hang on damaged metadata. Such a file is never read as good data, but
  the process that opens it may need to be stopped.
- A program that changes episodes and writes digests, hashes and seal anew is found only by
  `datasets.lock`, or by `verify --replay`; what it changes beside them by the check `claims`.
"""


def torture(found: dict[str, Any]) -> str:
    where = {k.removeprefix("in "): v for k, v in found.items() if k.startswith("in ")}
    signals = {k: v for k, v in found.items() if k.startswith("SIG")}
    compared = found["finished files compared"]
    cells = [[name, count] for name, count in (where | signals).items()]
    return (
        f"\n## {found['kills']} kills\n\n"
        f"`python benchmarks/trust/torture.py`: {found['kills']} kills in "
        f"{found['seconds'] / 60:.0f} min, a third of them aimed at the pack. "
        "After each the target was absent or whole; "
        f"{compared} finished files had the content hash of the undisturbed run; no worker "
        "outlived its collector.\n\n" + markdown_table(["killed in / by", "times"], cells)
    )


def writers(found: dict[str, Any]) -> str:
    rows = [
        ["files destroyed", found["destroyed"]],
        ["successes that are not in the target", found["unkept"]],
        ["both failed", found["both failed"]],
        ["wrong or unclear messages", found["wrong"]],
        ["temporary files or locks left behind", found["left behind"]],
    ]
    codes = ", ".join(f"{n} with {code.removeprefix('exit ')}" for code, n in found.items()
                      if code.startswith("exit "))  # fmt: skip
    return (
        f"\n## {found['pairs']:,} pairs of writers\n\n"
        f"`python benchmarks/trust/writers.py`: {found['pairs']:,} pairs of commands that write "
        f"one target at once, {len(found['met'])} different pairs, in "
        f"{found['seconds'] / 60:.0f} min. In {found['killed']} one was stopped by SIGKILL or "
        f"SIGTERM, and {found['given again']} times given again afterwards. "
        f"{found['HDF5_USE_FILE_LOCKING=FALSE']} pairs ran without HDF5's own locks. Exit codes: "
        f"{codes}.\n\n" + markdown_table(["found", "times"], rows)
    )


def fuzz(found: dict[str, Any]) -> str:
    rows = []
    for what, counts in found.items():
        if what != "seed":
            groups = {"found": 0, "unchanged": 0, "accepted": 0, "crash or hang": 0, "missed": 0}
            for outcome, count in counts.items():
                name = outcome.split()[0]
                key = {"crash": "crash or hang", "hang": "crash or hang"}.get(name, name)
                groups[key if key in groups else "missed"] += count
            rows.append([what, sum(counts.values()), *groups.values()])
    return (
        "\n## Damage\n\n`python benchmarks/trust/fuzz.py`. found = a FAIL of `verify` or one clear "
        "error; unchanged = padding, nothing that can be read differs; accepted = a text that "
        "now says something else and may (an entry is what its author writes; its hash changes "
        "with it); crash or hang = inside libhdf5; missed = read as good although it differs, or a "
        "traceback.\n\n"
        + markdown_table(
            ["damage", "files", "found", "unchanged", "accepted", "crash or hang", "missed"], rows
        )
    )


def texts(found: dict[str, Any]) -> str:
    rows = []
    for what, counts in found["texts"].items():
        refused, read = counts.get("error", 0), counts.get("read", 0)
        total = sum(counts.values())
        rows.append([what, total, refused, read, total - refused - read])
    return (
        "\n## Texts that are read\n\n"
        f"`python benchmarks/trust/texts.py`: {found['mutations']:,} changes of texts and tables "
        "(types, nesting, sizes, Unicode, NUL, twice, missing, huge numbers), those in data files "
        "under a new seal, each read by a command that a user would type. error = one clear error "
        "with the exit code of its class; read = exit code 0; else = a traceback, another code, "
        "over 10 s of processor time, over 1 GB, or no word.\n\n"
        + markdown_table(["text", "changes", "error", "read", "else"], rows)
    )


def bundles(found: dict[str, Any]) -> str:
    kinds = {
        "bytes": "bits, lengths, missing files, files of another bundle, folders and links",
        "facts": "config.json under a new seal: types, names, huge numbers, versions",
        "tensors": "model.safetensors under new digests: names, shapes, types, headers",
    }
    rows = []
    for kind, counts in found["outcomes"].items():
        total, refused, acts = sum(counts.values()), counts.get("error", 0), counts.get("acts", 0)
        rows.append([kinds.get(kind, kind), total, refused, acts, total - refused - acts])
    return (
        "\n## Bundles of policies\n\n"
        f"`python benchmarks/trust/bundles.py`: {found['mutations']} changes of a bundle, each "
        "loaded and asked for actions. error = one clear error, and nothing was loaded; acts = "
        "what somebody may say who seals it anew, and the policy acts in finite numbers; else = "
        "a traceback, damage that nobody noticed, NaN, over 20 s of processor time, or over "
        "512 MB more.\n\n" + markdown_table(["changed", "bundles", "error", "acts", "else"], rows)
    )


def clusters(found: dict[str, Any]) -> str:
    rows = [
        [name, f"`{one['content'][:12]}`", one.get("killed_after_blocks", "-"), one["seconds"]]
        for name, one in found.items()
    ]
    return (
        "\n## A cluster that loses a node\n\n`python benchmarks/trust/clusters.py`: two Ray nodes "
        "on one machine, the second one killed while blocks were running on it.\n\n"
        + markdown_table(["engine", "content", "node killed after blocks", "seconds"], rows)
    )


def limits(found: list[dict[str, Any]]) -> str:
    rows = [
        [one["input"], f"`{one['command']}`", _size(one["bytes"]), one["megabytes"],
         one["seconds"], "read" if one["code"] == 0 else "refused"]
        for one in found
    ]  # fmt: skip
    return (
        "\n## Small inputs that announce much\n\n`python benchmarks/trust/limits.py`: what a "
        "command spends before it answers, in a process of its own; the first lines are what "
        "it needs anyway.\n\n"
        + markdown_table(["input", "command", "size", "most MB", "seconds", "outcome"], rows)
    )


def _size(num_bytes: int) -> str:
    return f"{num_bytes / 1e6:.1f} MB" if num_bytes >= 10**5 else f"{num_bytes / 1e3:.1f} kB"


def mutants(found: dict[str, Any]) -> str:
    """One line per folder, then every break in a list that can be searched."""
    breaks: list[dict[str, Any]] = found["breaks"]
    folders: dict[str, list[dict[str, Any]]] = {}
    for one in breaks:
        folders.setdefault(str(Path(one["file"]).parent), []).append(one)
    rows = [
        [f"`{folder}`", len({one["file"] for one in some}), len(some),
         sum(one["outcome"] != "survived" for one in some)]
        for folder, some in folders.items()
    ]  # fmt: skip
    survivors = sum(one["outcome"] == "survived" for one in breaks)
    text = (
        f"\n## {len(breaks)} breaks of the code\n\n`python tools/mutants.py`: a sign, a bound, a "
        f"check left out, one at a time, in {found['seconds'] / 60:.0f} min. "
        f"{survivors or 'None'} survived the tests beside each.\n\n"
        + markdown_table(["folder", "files", "breaks", "noticed"], rows)
    )
    for folder, some in folders.items():
        text += f"\n### {folder}\n\n"
        text += "".join(f"- `{Path(one['file']).name}` {_change(one)}\n" for one in some)
    return text.rstrip("\n")


def _change(one: dict[str, Any]) -> str:
    """What became what, and who noticed."""
    old, new = (" ".join(one[side].split()) for side in ("old", "new"))
    what = f"`` {old} `` became `` {new} ``" if new else f"`` {old} `` left out"
    return f"{what}: {one['by'].removeprefix('tests/') or one['outcome']}"


def page(folder: Path) -> str:
    """The whole page as Markdown."""
    sections = {
        "torture": torture,
        "writers": writers,
        "limits": limits,
        "fuzz": fuzz,
        "texts": texts,
        "bundles": bundles,
        "clusters": clusters,
        "mutants": mutants,
    }
    text = HEAD
    for name, section in sections.items():
        path = folder / f"{name}.json"
        text += section(json.loads(path.read_text())) + "\n" if path.exists() else ""
    return text


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--results", type=Path, default=ROOT / "results" / "trust")
    folder = parser.parse_args().results
    (ROOT / "docs" / "trust.md").write_text(page(folder))
    print("written  docs/trust.md")


if __name__ == "__main__":
    main()
