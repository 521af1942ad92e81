"""The experiments of nielsen's LTE: closely spaced paths, and the downlink's signals, cells and arrivals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from soopnav_cpp.experiments import load, nielsen_lte, nielsen_paths
from soopnav_cpp.experiments.registry import perform

pytestmark = pytest.mark.consistency


def test_a_share_of_cells_is_demodulated_as_the_standard_says() -> None:
    rows = nielsen_lte.signals_run(5, 3, 84)
    assert rows[:, 0].tolist() == [3, 87, 171, 255, 339, 423]
    assert rows[:, 5:].max() < 1e-5


def test_one_path_is_near_its_bound_and_two_are_better_than_the_first_peak() -> None:
    one = nielsen_paths.channels_run(1, 20.0, False)
    # 25 squared errors over the bound's: chi-square, 0.30 ... 2.35 at 1e-4.
    ratio = np.mean(np.square(one[:, 0] / one[:, 9]))
    assert 0.30 < ratio < 2.35
    two = nielsen_paths.channels_run(2, 20.0, True)
    assert np.sum(np.square(two[:, 0])) < np.sum(np.square(two[:, 1])) / 9.0


def test_runs_at_two_snrs_share_no_draw(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(nielsen_paths, "BATCH", 12)
    first, second = (nielsen_paths.channels_run(3, snr_db, False) for snr_db in (10.0, 20.0))
    # The bound is an SNR's alone, errors are independent: 12 pairs correlate by 0.95 with a probability below 1e-5.
    assert abs(np.corrcoef(first[:, 0], second[:, 0])[0, 1]) < 0.95


@pytest.mark.slow
@pytest.mark.parametrize("name", ["nielsen-lte", "nielsen-x3"])
def test_every_claim_holds(name: str, tmp_path: Path) -> None:
    (item,) = load().select([name])
    outcome = perform(item, seed=11, out=tmp_path)
    assert [claim.claim for claim in outcome.claims if not claim.holds] == []
