"""The particle filter experiments of nielsen 3.3: every claim holds, and a wrong filter does not pass."""

import functools
from dataclasses import replace

import numpy as np
import pytest

from soopnav_cpp.estimation import ParticleFilter
from soopnav_cpp.experiments import nielsen_crossing, nielsen_lines, nielsen_rooms
from soopnav_cpp.experiments.registry import REGISTRY, perform

pytestmark = pytest.mark.consistency

IDS = [f"nielsen-{number}" for number in (*range(18, 25), *range(26, 39))]


def carried_out(name, folder, seed=1):
    [item] = REGISTRY.select([name])
    return perform(item, seed=seed, out=folder)


@pytest.mark.parametrize("name", IDS)
def test_claims_hold(name, tmp_path):
    outcome = carried_out(name, tmp_path)
    assert outcome.error is None, outcome.error
    assert [claim.claim for claim in outcome.claims if not claim.holds] == []
    assert (tmp_path / f"{name}.png").stat().st_size > 10_000
    with np.load(tmp_path / f"{name}.npz") as data:
        assert data.files
        assert all(np.all(np.isfinite(data[key])) for key in data.files)


class Wrong(ParticleFilter):
    """A filter with a mistake."""

    def __init__(self, *args, **options):
        super().__init__(*args, **(options | {"resampling": "nearest"}))


class Leaky(ParticleFilter):
    """A filter without walls."""

    def constrain(self, **_):
        return super().constrain()


class Overconfident(ParticleFilter):
    """A filter that takes the ranges for twice as good as they are."""

    def run(self, time_s, process, measured, **options):
        return super().run(time_s, process, replace(measured, sigma=0.5 * np.asarray(measured.sigma)), **options)

    def update(self, model, z, sigma):
        return super().update(model, z, 0.5 * sigma)


@pytest.mark.parametrize(
    ("name", "module", "mistake"),
    [
        ("nielsen-18", nielsen_lines, Wrong),
        ("nielsen-19", nielsen_lines, Overconfident),
        ("nielsen-23", nielsen_lines, Wrong),
        ("nielsen-24", nielsen_lines, Overconfident),
        ("nielsen-27", nielsen_rooms, Overconfident),
        ("nielsen-28", nielsen_rooms, Leaky),
        ("nielsen-32", nielsen_rooms, Overconfident),
        ("nielsen-37", nielsen_crossing, Overconfident),
        ("nielsen-38", nielsen_crossing, Overconfident),
    ],
)
def test_wrong_filters_are_noticed(name, module, mistake, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "ParticleFilter", mistake)
    outcome = carried_out(name, tmp_path)
    assert outcome.error is None, outcome.error
    assert not outcome.holds


def test_runs_depend_on_their_seed_alone():
    same = functools.partial(nielsen_rooms.biased, 5)
    np.testing.assert_array_equal(same().mean, same().mean)
    assert not np.array_equal(same().mean, nielsen_rooms.biased(6).mean)
