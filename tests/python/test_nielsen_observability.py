"""Experiments nielsen-40 ... 43 and nielsen-crlb: their claims hold, and fail where they should."""

import math

import numpy as np
import pytest

from soopnav_cpp.experiments import nielsen_crlb, nielsen_observability
from soopnav_cpp.experiments.registry import REGISTRY, perform

IDS = ["nielsen-40", "nielsen-41", "nielsen-42", "nielsen-43", "nielsen-crlb"]


@pytest.mark.unit
@pytest.mark.parametrize("id", IDS)
def test_every_claim_holds(id, tmp_path):
    (item,) = REGISTRY.select([id])
    outcome = perform(item, seed=3, out=tmp_path)
    assert outcome.error is None
    assert [claim.claim for claim in outcome.claims if not claim.holds] == []
    assert (tmp_path / f"{id}.png").stat().st_size > 10_000
    assert (tmp_path / f"{id}.npz").exists()


@pytest.mark.golden
def test_the_listing_to_six_digits():
    # g1.m itself, written down again: A by its two loops, σ from inv(A'A).
    for positions in (2, 30):
        for x0 in (0.0, 0.7, 2.0, 4.0):
            A = np.zeros((2 * positions, 3))
            for i in range(1, positions + 1):
                A[2 * i - 2] = [1.0, 0.0, i * x0 / math.sqrt(1.0 + x0**2)]
                A[2 * i - 1] = [0.0, 1.0, i * (x0 - 4.0) / math.sqrt(1.0 + (x0 - 4.0) ** 2)]
            expected = np.sqrt(np.diag(np.linalg.inv(A.T @ A)))
            np.testing.assert_allclose(nielsen_observability.straight_line_sigma(x0, positions)[0], expected, rtol=1e-9)


@pytest.mark.crosscheck
@pytest.mark.parametrize("bias", ["known", "common", "separate"])
@pytest.mark.parametrize("length", ["step", "offset"])
def test_the_printed_matrix_of_four_corners(length, bias):
    x0, y0, rows = 0.8, 2.6, []
    for i in range(1, 21):
        x = x0 + 0.1 * i
        for j, (a, b) in enumerate(((0, 0), (4, 0), (4, 4), (0, 4))):
            cosine = (x - a) / math.hypot(x - a, y0 - b)
            head = {"known": [], "common": [1.0], "separate": list(np.eye(4)[j])}[bias]
            rows.append([*head, (i if length == "step" else 1) * cosine])
    A = np.array(rows)
    expected = math.sqrt(np.linalg.inv(A.T @ A)[-1, -1])
    got = nielsen_observability.corner_walk_sigma(x0, y0, length, bias)
    assert float(got) == pytest.approx(expected, rel=1e-9)


@pytest.mark.unit
def test_a_walk_over_a_node_is_blank():
    got = nielsen_observability.corner_walk_sigma([1.0, 2.0], 0.0, "step", "known")
    assert np.isfinite(got[0])
    assert np.isnan(got[1])


@pytest.mark.law
def test_claims_fail_for_a_wrong_geometry(tmp_path, monkeypatch):
    monkeypatch.setattr(nielsen_observability, "TWO_NODES_M", np.array([[0.0, 1.0], [4.0, 1.001]]))
    (item,) = REGISTRY.select(["nielsen-40"])
    assert not perform(item, seed=3, out=tmp_path).holds


@pytest.mark.crosscheck
def test_blue_and_ranging_against_numpy():
    for printed, expected in ((True, 0.103), (False, 0.379)):
        C = nielsen_crlb.clock_walk_covariance_cm2(as_printed=printed)
        h = 10.0 * np.arange(30.0)
        sigma = 1.0 / math.sqrt(h @ np.linalg.solve(C, h))
        assert nielsen_crlb.blue_angle_sigma_rad(C) == pytest.approx(sigma, rel=1e-9)
        assert sigma == pytest.approx(expected, abs=5e-4)
    # Trapezia over a fine grid for the integral.
    f = np.linspace(0.0, 1e7, 20001)
    assert nielsen_crlb.mean_square_bandwidth(0.0, 1e7) == pytest.approx(
        np.trapezoid((2 * math.pi * f) ** 2, f) / 1e7, rel=1e-8
    )
    # Twice the energy, half the variance.
    one, two = (nielsen_crlb.tone_range_sigma_m(snr, known_phase=False) for snr in (1.0, 2.0))
    assert one / two == pytest.approx(math.sqrt(2.0))
