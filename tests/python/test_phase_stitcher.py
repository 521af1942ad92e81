"""Stitching bursts from Python: arrays, refusals, and the integers against integer least squares."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import soopnav_cpp as sn
from soopnav_cpp.experiments import pesyna_iridium
from soopnav_cpp.navigation import BurstStatus, PhaseStitcher, stitch_phase

SIGMA, SIGMA_HZ = pesyna_iridium.burst_sigmas(45.0)


def test_a_pass_over_a_place_is_stitched():
    found = pesyna_iridium.burst_pass(5, 45.0)
    got = pesyna_iridium.stitched(found, 45.0)
    assert len(got) == len(found.t_s)
    assert got.fixed.all()
    assert len(set(got.arc)) == 1
    np.testing.assert_array_equal(np.diff(got.integer), np.diff(found.integer))
    assert np.std(got.phase_cycles - found.true_cycles) < 2.0 * SIGMA
    assert "60 bursts in 1 arcs" in repr(got)


def test_integers_are_those_of_integer_least_squares():
    """Twelve bursts with a Doppler known to 0.3 Hz: the maximum of the posterior is the nearest integer vector."""
    rng = np.random.default_rng(8)
    m, n = 4, 12
    agree = 0
    for _ in range(40):
        t = np.cumsum(np.r_[0.0, rng.choice([0.09, 0.18, 0.27], n - 1)])
        f, r = rng.normal(0.0, 0.3), rng.normal(0.0, 0.3)
        eta = rng.integers(0, m, n)
        z = f * t + 0.5 * r * t**2 + eta / m + rng.normal(0.0, 0.02, n)
        got = stitch_phase(
            t, z, 0.02, frequency_sigma_hz_prior=0.3, rate_sigma_hzps=0.3, clock=sn.clock.TwoState(0.0, 0.0),
            decision_bursts=n,
        )  # fmt: skip
        # M (z_k - z_1) = n_k - n_1 + M (f dt + r dt²/2 + noise_k - noise_1): float ambiguities and their covariance.
        dt = (t - t[0])[1:]
        design = np.column_stack([dt, 0.5 * dt**2])
        covariance = m**2 * (
            design @ np.diag([0.3**2, 0.3**2]) @ design.T + 0.02**2 * (np.eye(n - 1) + np.ones((n - 1, n - 1)))
        )
        solved = sn.gnss.lambda_ils(m * (z - z[0])[1:], covariance)
        best = np.asarray(solved[0])[0]
        agree += int(np.array_equal(best, got.integer[1:]))
    assert agree == 40


def test_streaming_is_the_same_as_at_once():
    found = pesyna_iridium.burst_pass(6, 45.0, bursts=90)
    arguments = (found.t_s, found.measured_cycles, np.full(90, SIGMA), found.frequency_hz, np.full(90, SIGMA_HZ))
    whole, pieces = PhaseStitcher(clock=pesyna_iridium.CLOCK), PhaseStitcher(clock=pesyna_iridium.CLOCK)
    _, at_once = whole.push(
        *arguments, predicted_cycles=found.predicted_cycles, predicted_rate_cyclesps=found.predicted_rate
    )
    phases = []
    for k in range(90):
        status, decided = pieces.push(
            *(column[k] for column in arguments),
            predicted_cycles=found.predicted_cycles[k],
            predicted_rate_cyclesps=found.predicted_rate[k],
        )
        assert status[0] == (BurstStatus.STARTED if k == 0 else BurstStatus.ACCEPTED)
        phases.extend(decided.phase_cycles)
    np.testing.assert_array_equal(phases, at_once.phase_cycles)
    assert pieces.waiting == 0
    assert pieces.posterior > 0.999
    assert abs(pieces.frequency_error_hz) < 40.0
    assert "0 bursts waiting" in repr(pieces)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(*[st.floats(width=64) for _ in range(7)]), max_size=40))
def test_any_numbers_give_statuses_and_finite_phases(rows):
    stitcher = PhaseStitcher(decision_bursts=5)
    columns = np.array(rows, dtype=np.float64).reshape(-1, 7).T
    status, decided = stitcher.push(*columns[:5], predicted_cycles=columns[5], predicted_rate_cyclesps=columns[6])
    rest = stitcher.finish()
    assert len(status) == len(rows)
    for got in (decided, rest):
        assert np.isfinite(got.t_s).all()
        assert ((got.posterior >= 0.0) & (got.posterior <= 1.0)).all()


@pytest.mark.parametrize(
    ("option", "value"),
    [("fractions", 0), ("carrier_hz", -1.0), ("posterior", 0.4), ("decision_bursts", 1), ("gate_sigma", 0.0)],
)
def test_options_out_of_range_are_refused(option, value):
    with pytest.raises(ValueError, match=f"^{option} = "):
        PhaseStitcher(**{option: value})


def test_shapes_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match=r"^sigma_cycles: shape \(3,\) expected, got \(2,\)"):
        PhaseStitcher().push([0.0, 1.0, 2.0], [0.0, 0.0, 0.0], [0.1, 0.1])


def test_a_phase_that_is_no_receivers_leaves_the_pass_whole():
    found = pesyna_iridium.burst_pass(5, 45.0)
    measured = found.measured_cycles.copy()
    measured[[0, 30]] = 1e16, -1e16
    got = stitch_phase(
        found.t_s, measured, SIGMA, found.frequency_hz, SIGMA_HZ, predicted_cycles=found.predicted_cycles,
        predicted_rate_cyclesps=found.predicted_rate, clock=pesyna_iridium.CLOCK, decision_bursts=58,
    )  # fmt: skip
    assert got.fixed.all()
    assert len(set(got.arc)) == 1
    assert np.flatnonzero(got.status == BurstStatus.OUTLIER).tolist() == [0, 30]
    assert got.status[1] == BurstStatus.STARTED
    assert len(got) == 58
    assert "2 bursts refused" in repr(got)


def test_a_pass_says_what_became_of_each_burst():
    got = stitch_phase([0.0, 0.09, 0.09, 0.18], [0.0, np.nan, 0.0, 0.0], 0.01)
    assert got.status.tolist() == [
        BurstStatus.STARTED, BurstStatus.NOT_FINITE, BurstStatus.ACCEPTED, BurstStatus.ACCEPTED,
    ]  # fmt: skip


@pytest.mark.parametrize("sigma", [0.0, -0.1])
def test_standard_deviations_that_are_none_are_named(sigma):
    t = np.arange(4.0)
    with pytest.raises(ValueError, match=r"^sigma_cycles\[0\] = "):
        stitch_phase(t, t, sigma)
    with pytest.raises(ValueError, match=r"^sigma_cycles\[2\] = "):
        stitch_phase(t, t, [0.1, 0.1, sigma, 0.1])
    with pytest.raises(ValueError, match=r"^frequency_sigma_hz\[0\] = "):
        stitch_phase(t, t, 0.1, t, sigma)
