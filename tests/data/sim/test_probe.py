from __future__ import annotations

import numpy as np
import pytest

from mpdt.data.sim import probe as module
from mpdt.data.sim.probe import Gauge, Probe, Script
from mpdt.data.spec.tasks import get_family

SCRIPT = Script(get_family("mt50"), "metaworld")


def test_probe_repeats_itself_and_tells_rates_apart():
    first, again = Probe(SCRIPT, "reach", seed=3), Probe(SCRIPT, "reach", seed=3)
    returns, successes = first.outcomes(0.5, 30, 2)
    # asked in another order and in two portions: the same numbers
    again.outcomes(0.0, 30, 1)
    again.outcomes(0.5, 30, 1)
    np.testing.assert_array_equal(again.outcomes(0.5, 30, 2)[0], returns)
    assert returns[0] != returns[1] and successes.tolist() == [0.0, 0.0]
    assert (first.outcomes(0.0, 30, 2)[0] > first.outcomes(1.0, 30, 2)[0]).all()


def test_a_long_episode_answers_for_a_short_one(monkeypatch):
    played = []
    real = module.run_block

    def counted(env, policy, keys, **options):
        played.append((options["horizon"], [key.row for key in keys]))
        return real(env, policy, keys, **options)

    monkeypatch.setattr(module, "run_block", counted)
    long, short = Probe(SCRIPT, "reach", seed=3), Probe(SCRIPT, "reach", seed=3)
    long.outcomes(0.5, 20, 2)
    np.testing.assert_array_equal(long.outcomes(0.5, 7, 2)[0], short.outcomes(0.5, 7, 2)[0])
    assert played == [(20, [0, 1]), (7, [0, 1])]
    # the other way round they have to be played again, and become the same
    np.testing.assert_array_equal(short.outcomes(0.5, 20, 2)[0], long.outcomes(0.5, 20, 2)[0])
    assert played[2:] == [(20, [0, 1])]


class FakeProbe:
    """Returns 500 - 400 rate +- 4 by row; at rate 0.5 the first episode has 100 more."""

    def outcomes(self, rate, horizon, num_episodes):
        returns = 500.0 - 400.0 * rate + 4.0 * (-1.0) ** np.arange(num_episodes)
        returns[0] += 100.0 * (rate == 0.5)
        return returns, np.full(num_episodes, float(rate < 0.5))


def test_a_level_is_measured_until_it_is_known_up_to_a_limit():
    gauge = Gauge(FakeProbe(), 500, portion=4, portions=5, error=0.025)
    assert (gauge.low, gauge.span) == (100.0, 400.0)
    # (104, -4, 4, -4, ...): std / sqrt(n) is 26.4, 13.1, 8.8 for n = 4, 8, 12; 0.025 * 400 = 10
    assert gauge.measure(0.5).episodes == 12
    assert gauge.measure(0.5).level == pytest.approx(0.5 + 100 / 12 / 400, abs=1e-4)
    assert gauge.measure(0.4).episodes == 4 and gauge.measure(0.4, 2).episodes == 2
    strict = Gauge(FakeProbe(), 500, portion=4, portions=5, error=0.0001)
    assert strict.measure(0.5).episodes == 20


class NoisyEnd(FakeProbe):
    """The script's episodes return 460, 540, 460, 540, and 420 from then on."""

    def outcomes(self, rate, horizon, num_episodes):
        if rate:
            return super().outcomes(rate, horizon, num_episodes)
        returns = np.array([460.0, 540.0, 460.0, 540.0, *[420.0] * 32])[:num_episodes]
        return returns, np.ones(num_episodes)


def test_the_ends_of_the_scale_are_the_episodes_that_made_it():
    """4 episodes: span 400. 8: mean 460, std 52.4, 18.5 / 400 < 0.05, so the span is 360.

    Asked anew, 18.5 / 360 > 0.05 would take 12 episodes, whose mean is not level 1.
    """
    gauge = Gauge(NoisyEnd(), 500, portion=4, portions=9, error=0.05)
    assert gauge.span == 360.0
    expert = gauge.measure(0.0)
    assert (expert.episodes, expert.mean_return, expert.level) == (8, 460.0, 1.0)
    assert gauge.measure(1.0).level == 0.0


def test_judging_stops_as_soon_as_a_level_is_clearly_wrong():
    gauge = Gauge(FakeProbe(), 500, portion=4, portions=5, error=0.0001)
    # level 0.6 +- 0.0058 after 4: further than 0.05 from one half by more than its error
    assert gauge.judge(0.4, 0.05).episodes == 4
    assert gauge.judge(0.4, 0.099).episodes == 20
