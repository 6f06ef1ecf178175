from __future__ import annotations

from pathlib import Path

from mpdt.data.sim.calibration import Calibration, Measurement, load_calibrations, table

PAGE = Path(__file__).parents[3] / "docs" / "calibration.md"


def measured(rate, mean_return, level):
    return Measurement(rate, 20, mean_return, 0.5, level, 0.021)


def test_table_has_a_row_per_task_and_horizon():
    entry = Calibration(
        task="reach",
        horizon=200,
        rate=0.83,
        level=0.47,
        random=measured(1.0, 298.8, 0.0),
        medium=measured(0.83, 1021.2, 0.47),
        expert=measured(0.0, 1835.3, 1.0),
        monotone=False,
        curve=(),
        seed=1,
        versions={},
    )
    *_, row = table([entry]).splitlines()
    assert row == (
        "| reach | 200 | 0.830 | 0.47 ± 0.02 | 299 / 1021 / 1835 | 0.50 / 0.50 / 0.50 "
        "| 20 / 20 / 20 | no |"
    )


def test_the_page_shows_what_is_shipped(tmp_path):
    """Otherwise: python tools/calibration_table.py"""
    assert PAGE.read_text().endswith(table(list(load_calibrations(tmp_path).values())))
