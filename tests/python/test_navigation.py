"""Positions from times of arrival, and what they are worth, through the bindings."""

import math

import numpy as np
import pytest

import soopnav_cpp as sn
from soopnav_cpp.navigation import FixStatus, NodeUse

C = 299_792_458.0
NODES = np.array(
    [[150.0, 620.0, 35.0], [900.0, 240.0, 42.0], [520.0, -780.0, 28.0], [-640.0, -510.0, 31.0], [-760.0, 410.0, 45.0]]
)
HERE = np.array([180.0, -120.0, 1.5])  # fmt: skip


def arrivals(nodes=NODES, bias_s=3.2e-3):
    return (np.linalg.norm(nodes - HERE, axis=1) / C + bias_s) % 10e-3


@pytest.mark.unit
def test_exact_arrivals_give_the_place():
    fix = sn.navigation.position_fix(NODES, arrivals(), np.full(5, 1e-9), height_m=1.5, dimensions=2)
    assert fix.status is FixStatus.CONVERGED
    assert fix.dimensions == 2
    np.testing.assert_allclose(fix.position_m, HERE, atol=1e-4)
    assert fix.clock_bias_s == pytest.approx(3.2e-3, abs=1e-12)
    assert fix.covariance_m2.shape == (3, 3)
    assert fix.covariance_m2[2, 2] == 0.0
    assert fix.used.dtype == np.bool_
    assert fix.used.all()
    assert fix.unobservable == []
    assert fix.alternatives_m.shape == (0, 3)
    assert fix.dop.hdop > 0.5
    assert math.isnan(fix.dop.vdop)
    assert repr(fix).startswith("PositionFix(")
    assert "5 of 5 nodes" in repr(fix)


@pytest.mark.law
def test_a_clock_offset_is_taken_off():
    offsets = np.array([0.0, 3e-6, -2e-6, 1e-7, 5e-6])
    fix = sn.navigation.position_fix(
        NODES, arrivals() + offsets, np.full(5, 1e-9), clock_offsets_s=offsets, height_m=1.5, dimensions=2
    )
    np.testing.assert_allclose(fix.position_m, HERE, atol=1e-4)


@pytest.mark.unit
def test_a_false_node_is_rejected():
    toas = arrivals()
    toas[3] += 41.0 / C
    fix = sn.navigation.position_fix(NODES, toas, np.full(5, 2e-9), height_m=1.5, dimensions=2)
    assert fix.use[3] is NodeUse.REJECTED
    assert fix.residuals_m[3] == pytest.approx(41.0, abs=0.5)
    assert fix.gates_m[3] < 20.0
    np.testing.assert_allclose(fix.position_m, HERE, atol=1e-3)


@pytest.mark.unit
def test_too_few_nodes_are_a_status():
    fix = sn.navigation.position_fix(NODES[:2], arrivals()[:2], [1e-9, 1e-9], height_m=1.5, dimensions=2)
    assert fix.status is FixStatus.TOO_FEW_NODES
    assert np.isnan(fix.position_m).all()
    assert fix.message
    assert repr(fix)


@pytest.mark.unit
def test_a_node_that_is_not_finite_is_left_out():
    toas = arrivals()
    toas[0] = math.nan
    fix = sn.navigation.position_fix(NODES, toas, np.full(5, 1e-9), height_m=1.5, dimensions=2)
    assert fix.use[0] is NodeUse.NOT_FINITE
    assert list(fix.used) == [False, True, True, True, True]
    np.testing.assert_allclose(fix.position_m, HERE, atol=1e-4)


@pytest.mark.unit
@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"nodes_enu_m": np.zeros((5, 2))}, "nodes_enu_m: rows of three numbers expected, got 2"),
        ({"nodes_enu_m": np.zeros(3)}, r"nodes_enu_m: expected numbers with shape \(n, columns\), got float64 \(3,\)"),
        ({"nodes_enu_m": "here"}, "nodes_enu_m: expected numbers"),
        ({"toas_s": np.zeros((5, 1))}, r"toas_s: expected numbers with shape \(n,\), got float64 \(5, 1\)"),
        ({"toas_s": np.zeros(4)}, "toas_s"),
        ({"sigmas_s": np.zeros(4)}, "sigmas_s"),
        ({"clock_offsets_s": np.zeros(4)}, "clock_offsets_s: 5 numbers expected, one for each node, got 4"),
        ({"node_sigmas_s": np.full(5, -1.0)}, "sigma_s"),
        ({"near_m": [1.0, 2.0]}, "near_m: three numbers expected"),
        ({"dimensions": 4}, "dimensions: 4 is neither 2 nor 3"),
        ({"false_alarm_probability": 0.7}, "false_alarm_probability"),
        ({"period_s": -1.0}, "period_s"),
        ({"max_iterations": 0}, "max_iterations"),
    ],
)
def test_mistakes(changes, sentence):
    arguments = {"nodes_enu_m": NODES, "toas_s": arrivals(), "sigmas_s": np.full(5, 1e-9), "height_m": 1.5} | changes
    with pytest.raises(ValueError, match=sentence):
        sn.navigation.position_fix(**arguments)


@pytest.mark.law
def test_ellipse_of_a_turned_covariance():
    turn = np.array([[np.cos(0.3), -np.sin(0.3)], [np.sin(0.3), np.cos(0.3)]])
    ellipse = sn.estimation.error_ellipse(turn @ np.diag([9.0, 4.0]) @ turn.T)
    assert (ellipse.semi_major_m, ellipse.semi_minor_m) == pytest.approx((3.0, 2.0))
    assert ellipse.angle_rad == pytest.approx(0.3)
    wide = sn.estimation.error_ellipse(np.diag([9.0, 4.0]), probability=0.95)
    assert wide.semi_major_m == pytest.approx(3.0 * math.sqrt(-2.0 * math.log(0.05)))
    assert sn.estimation.circular_error_m(np.eye(2)) == pytest.approx(math.sqrt(2.0 * math.log(2.0)))


@pytest.mark.unit
@pytest.mark.parametrize(
    ("covariance", "probability", "sentence"),
    [
        (np.eye(3), 0.5, r"covariance_m2: expected shape \(2, 2\)"),
        (-np.eye(2), 0.5, "covariance_m2: not a covariance"),
        (np.eye(2) * math.nan, 0.5, "covariance_m2: not a covariance"),
        (np.eye(2), 1.0, "probability: 1.0+ is outside 0 ... 1"),
        (np.eye(2), math.nan, "probability: nan is outside"),
    ],
)
def test_mistakes_of_ellipses(covariance, probability, sentence):
    for call in (sn.estimation.error_ellipse, sn.estimation.circular_error_m):
        with pytest.raises(ValueError, match=sentence):
            call(covariance, probability=probability)
