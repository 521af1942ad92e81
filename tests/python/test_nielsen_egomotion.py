"""Experiment nielsen-egomotion: its claims hold, and those that a few increments can show hold by default."""

from __future__ import annotations

import numpy as np
import pytest

from soopnav_cpp import vision
from soopnav_cpp.experiments import nielsen_egomotion as experiment
from soopnav_cpp.experiments.registry import REGISTRY, perform

pytestmark = pytest.mark.skipif(not vision.available(), reason="built without OpenCV")


@pytest.mark.consistency
def test_errors_of_the_foot_cancel(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(experiment, "FRAMES", 9)
    walk = experiment.walk(21, experiment.Setup(0.02, True, False))
    assert walk.statuses == ["measured"] * 8
    assert experiment.rms_mm([walk]) < 0.25
    # Independent increments would add up to 1; each foot's error leaves with the next.
    drift = np.hypot(*walk.errors[:, :2].sum(axis=0)) / np.sqrt(np.sum(walk.errors[:, :2] ** 2))
    assert drift < 0.9


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_every_claim_holds(seed: int, tmp_path) -> None:
    (item,) = REGISTRY.select(["nielsen-egomotion"])
    outcome = perform(item, seed=seed, out=tmp_path)
    assert outcome.error is None
    assert [claim.claim for claim in outcome.claims if not claim.holds] == []
    assert (tmp_path / "nielsen-egomotion.png").stat().st_size > 10_000
