"""Experiment nielsen-plane: its claims hold, and its runs are what they say."""

import numpy as np
import pytest

from soopnav_cpp.experiments import nielsen_plane
from soopnav_cpp.experiments.registry import REGISTRY, perform


@pytest.mark.unit
def test_a_cloud_gives_tilt_height_and_frames():
    result = nielsen_plane.one_cloud(5)
    assert result["errors"].shape == (len(nielsen_plane.SHARES), 2, 3)
    assert np.isfinite(result["errors"]).all()
    svd, robust = result["errors"][5, 0], result["errors"][5, 1]
    assert robust[0] < 0.03 < 0.5 < svd[0]
    assert result["chain"].max() < 1e-11
    again = nielsen_plane.one_cloud(5)
    np.testing.assert_array_equal(again["errors"], result["errors"])


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_every_claim_holds(seed, tmp_path):
    (item,) = REGISTRY.select(["nielsen-plane"])
    outcome = perform(item, seed=seed, out=tmp_path)
    assert outcome.error is None
    assert [claim.claim for claim in outcome.claims if not claim.holds] == []
    assert (tmp_path / "nielsen-plane.png").stat().st_size > 10_000
