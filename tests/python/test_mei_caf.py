"""What mei-caf gives its estimator, and what its claims refuse."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from soopnav_cpp import dsp
from soopnav_cpp.experiments import mei_caf
from soopnav_cpp.experiments.registry import REGISTRY, Claim, Lab

pytestmark = pytest.mark.unit

Array = npt.NDArray[np.float64]


def test_windows_and_doppler_come_from_predictions_that_are_off() -> None:
    count = 40
    heard = next(mei_caf.received(5, 10.0, 2e-3, count))
    truth = heard.snippets.truth
    delay_s = truth.tdoa_s - (heard.snippets.target_start_s - heard.snippets.anchor_start_s)  # left to the search
    assert np.max(np.abs(delay_s)) <= mei_caf.OFF_S + 0.5 / mei_caf.RATE_HZ + 1e-9
    assert np.sqrt(np.mean(delay_s**2)) == pytest.approx(12e-6 / np.sqrt(3.0), rel=0.4)
    fdoa_hz = heard.fdoa_hz - truth.fdoa_hz
    assert np.max(np.abs(fdoa_hz)) <= mei_caf.OFF_HZ
    assert np.sqrt(np.mean(fdoa_hz**2)) == pytest.approx(200.0 / np.sqrt(3.0), rel=0.4)
    # Both clocks' windows lie on whole samples.
    for start_s in (heard.snippets.target_start_s, heard.snippets.anchor_start_s):
        assert np.allclose(start_s * mei_caf.RATE_HZ, np.round(start_s * mei_caf.RATE_HZ), atol=1e-3)


def test_batches_have_their_own_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mei_caf, "BATCH", 3)
    first, second, last = mei_caf.received(5, 0.0, 2e-3, 8)
    assert [len(heard.snippets) for heard in (first, second, last)] == [3, 3, 2]
    rows = np.concatenate([first.snippets.target, second.snippets.target])
    likeness = np.abs(rows.conj() @ rows.T) / np.sum(np.abs(rows[0]) ** 2)
    assert np.max(likeness - np.diag(np.diag(likeness))) < 0.3


def claims(monkeypatch: pytest.MonkeyPatch, folder: Path, ratio: dict[float, float], share: float) -> dict[str, Claim]:
    """The claims if errors over Stein's bound were `ratio` and `share` of the paper's bursts were detected."""

    def errors(rng: np.random.Generator, sigmas: tuple[float, float], count: int) -> Array:
        out = np.full((count, 5), 20.0)
        out[:, :2] = rng.choice([-1.0, 1.0], (count, 2)) * sigmas
        out[:, 2:4] = sigmas
        return out

    def trials(seed: int) -> tuple[list[Array], Array, Array]:
        rng = np.random.default_rng(seed)
        main = []
        for snr_db in mei_caf.SNR_DB:
            bound = dsp.tdoa_fdoa_crlb(25e3, 90e-3, snr_db)
            sigmas = (ratio.get(snr_db, 1.0) * bound.sigma_tdoa_s, bound.sigma_fdoa_hz)
            main.append(errors(rng, sigmas, mei_caf.BURSTS[snr_db]))
        shown = np.array([[m[: mei_caf.SHOWN]] * 3 for m in main[len(mei_caf.LOW_DB) :]])
        paper = errors(rng, (2.73e-6, 2.19), 200)
        paper[round(share * 200) :] = np.nan
        return main, shown, paper

    monkeypatch.setattr(mei_caf, "trials", trials)
    monkeypatch.setattr(mei_caf, "_figure", lambda *_: None)
    monkeypatch.setattr(mei_caf, "_surface", lambda *_: None)
    lab: Any = Lab(REGISTRY.select(["mei-caf"])[0], 1, folder)
    return {claim.claim: claim for claim in mei_caf.caf(lab)}


def held(found: dict[str, Claim], words: str) -> bool:
    (claim,) = (claim for name, claim in found.items() if words in name)
    return claim.holds


@pytest.mark.parametrize(("at_0_db", "at_5_db", "holds"), [(1.105, 1.06, (True, True)), (1.15, 1.13, (False, False))])
def test_bars_are_those_of_the_claim(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, at_0_db: float, at_5_db: float, holds: tuple[bool, bool]
) -> None:
    found = claims(monkeypatch, tmp_path, {0.0: at_0_db, 5.0: at_5_db}, 1.0)
    assert held(found, "the same at 0 dB, where") is holds[0]
    assert held(found, "TDOA error over Stein's bound at 5") is holds[1]


@pytest.mark.parametrize(("over_bound", "holds"), [(1.11, True), (1.16, False)])
def test_low_snr_has_no_slack(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, over_bound: float, holds: bool) -> None:
    ratio = {}
    for snr_db in mei_caf.LOW_DB:
        kinds = [dsp.tdoa_fdoa_crlb(25e3, 90e-3, snr_db, kind=kind) for kind in ("stochastic", "stein")]
        ratio[snr_db] = over_bound * kinds[0].sigma_tdoa_s / kinds[1].sigma_tdoa_s
    assert held(claims(monkeypatch, tmp_path, ratio, 1.0), "over the stochastic bound at -8") is holds


@pytest.mark.parametrize(("share", "holds"), [(0.99, True), (0.9, False)])
def test_share_of_the_papers_bursts_is_bounded(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, share: float, holds: bool
) -> None:
    assert held(claims(monkeypatch, tmp_path, {}, share), "share of them") is holds
