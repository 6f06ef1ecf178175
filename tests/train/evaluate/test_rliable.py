"""Against rliable 1.2.0: numbers it gave, and the package itself where it is installed.

python -m venv V && V/bin/pip install rliable==1.2.0 "pandas<3"    its arch breaks with pandas 3
PYTHONPATH=V/lib/python3.11/site-packages pytest -W ignore tests/train/evaluate/test_rliable.py
"""

import importlib
import warnings

import numpy as np
import pytest

from mpdt.train.evaluate.aggregate import improvement, iqm, profile, stratified_interval

SCORES = np.array([
    [0.1, 0.9, 0.5, 0.4], [0.2, 1.0, 0.5, 0.3], [0.0, 0.7, 0.6, 0.8], [0.3, 0.8, 0.1, 0.4],
    [0.9, 0.9, 0.2, 0.4],
])  # fmt: skip
"""(5 runs, 4 tasks)."""
OTHERS = np.array([[0.1, 0.8, 0.7, 0.4], [0.4, 1.0, 0.5, 0.2], [0.2, 0.2, 0.6, 0.9]])
AT = np.array([0.0, 0.25, 0.5, 0.75])
PINNED = {
    "iqm": 0.49, "profile": [0.95, 0.75, 0.4, 0.3], "improvement": 0.43333333333333335,
    "interval": (0.36, 0.63),
}  # fmt: skip


def test_numbers_that_rliable_gave():
    """1.2.0, 2026-11-29: aggregate_iqm, run_score_deviation, probability_of_improvement, and the
    interval of its StratifiedBootstrap with 50,000 draws, which ours with 2,000 comes near."""
    assert iqm(SCORES) == pytest.approx(PINNED["iqm"], abs=1e-12)
    assert profile(SCORES, AT) == pytest.approx(PINNED["profile"], abs=1e-12)
    assert improvement(SCORES, OTHERS) == pytest.approx(PINNED["improvement"], abs=1e-12)
    assert improvement(OTHERS, SCORES) == pytest.approx(1 - PINNED["improvement"], abs=1e-12)
    assert stratified_interval(SCORES) == pytest.approx(PINNED["interval"], abs=0.02)


def rliable(part):
    pytest.importorskip("rliable")
    return importlib.import_module(f"rliable.{part}")


def test_rliable_itself():
    metrics, library = rliable("metrics"), rliable("library")
    assert iqm(SCORES) == pytest.approx(metrics.aggregate_iqm(SCORES), abs=1e-12)
    above = [library.run_score_deviation(SCORES, at) for at in AT]
    assert profile(SCORES, AT) == pytest.approx(above, abs=1e-12)
    assert improvement(SCORES, OTHERS) == pytest.approx(
        metrics.probability_of_improvement(SCORES, OTHERS), abs=1e-12)  # fmt: skip
    with warnings.catch_warnings():  # of arch, about the generator that rliable gives it
        warnings.simplefilter("ignore", FutureWarning)
        drawn = np.random.RandomState(0)
        _, bounds = library.get_interval_estimates(
            {"ours": SCORES}, metrics.aggregate_iqm, reps=4000, random_state=drawn
        )
    assert stratified_interval(SCORES) == pytest.approx(bounds["ours"].ravel(), abs=0.02)
