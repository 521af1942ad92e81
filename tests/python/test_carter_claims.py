"""Every experiment of carter, run once as ``soopnav reproduce`` runs it: all claims hold."""

import numpy as np
import pytest

from soopnav_cpp import experiments
from soopnav_cpp.experiments import carter_emitters
from soopnav_cpp.experiments.registry import perform

CARTER = [item for item in experiments.load().all() if item.id.startswith("carter-")]


@pytest.mark.slow
@pytest.mark.parametrize("item", CARTER, ids=lambda item: item.id)
def test_claims_hold(item, tmp_path):
    outcome = perform(item, seed=1, out=tmp_path)
    if outcome.error is not None:
        raise outcome.error
    assert [claim.as_row(item, 1) for claim in outcome.claims if not claim.holds] == []


def test_there_are_experiments_to_run():
    assert {"carter-2", "carter-4.7", "carter-5.5", "carter-5.9", "carter-x1", "carter-x3.2", "carter-x3.4"} <= {
        item.id for item in CARTER
    }


def test_a_manifold_s_errors_and_its_trials_are_drawn_apart(monkeypatch):
    seeds, generator = [], np.random.default_rng
    monkeypatch.setattr(np.random, "default_rng", lambda seed: seeds.append(str(seed)) or generator(seed))
    carter_emitters.file_trials(3, 1)
    assert len(seeds) >= 2
    assert len(set(seeds)) == len(seeds)
