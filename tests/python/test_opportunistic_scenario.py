"""Scenarios of opportunistic navigation: stages, joins and leaves, refusals, figures."""

from pathlib import Path

import numpy as np
import pydantic
import pytest

from soopnav_cpp.scenarios import opportunistic_pipeline as pipeline
from soopnav_cpp.scenarios.opportunistic import Opportunistic, OpportunisticScenario
from soopnav_cpp.scenarios.registry import load

ROOT = Path(__file__).resolve().parents[2]
TOWERS = [
    {"name": "a", "position_m": [1200.0, 800.0, 30.0], "h0": 3e-25, "h_minus_2": 3e-27},
    {"name": "b", "position_m": [-900.0, 1500.0, 20.0], "joins_s": 12.0, "leaves_s": 35.0},
]


def scenario(**changes):
    keys = {
        "system": "opportunistic",
        "duration_s": 50.0,
        "stage_2_s": 10.0,
        "stage_3_s": 30.0,
        "basestations": TOWERS,
        **changes,
    }
    return OpportunisticScenario.model_validate(keys)


def test_stages_joins_and_leaves():
    got = Opportunistic().run(scenario(), 3)
    assert got.stage.tolist() == [1] * 100 + [2] * 200 + [3] * 200
    assert got.heard["b"].sum() == 230
    assert sum(name.startswith("G") for name in got.heard) == 6
    with_gps = got.stage < 3
    # Satellites without errors: the clock is known to a fraction of a code's noise, and to a cycle without GPS.
    assert np.abs(got.smoothed_error_s[with_gps]).max() < 2e-9
    assert np.abs(pipeline.stage_3_cycles(got)).max() < 0.5
    assert np.linalg.norm(got.position_m[-1]) < 0.1
    assert any("not observable" in note for note in got.notes)
    numbers = Opportunistic().numbers(scenario(), got)
    assert 0.05 < numbers["a_h0_over_true"] < 20.0
    assert numbers["slips"] == 0
    assert set(Opportunistic().figures(scenario(), got)) == {"clock", "stability", "coherence"}


def test_the_same_seed_gives_the_same_bits():
    short = scenario(duration_s=20.0, stage_2_s=5.0, stage_3_s=15.0, characterization="true")
    first, second, other = (Opportunistic().run(short, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.clock_error_s, second.clock_error_s)
    assert not np.array_equal(first.clock_error_s, other.clock_error_s)


def test_wrong_noise_costs_coherence():
    """Swapped trust in two basestations: the steadier one is not believed."""
    worst = {}
    for kind in ("true", "wrong"):
        changed = [TOWERS[0] | {"name": "a"}, {"name": "b", "position_m": [-900.0, 1500.0, 20.0]}]
        runs = [
            Opportunistic().run(scenario(characterization=kind, basestations=changed, duration_s=130.0), seed)
            for seed in range(6)
        ]
        worst[kind] = np.sqrt(np.mean([np.mean(pipeline.stage_3_cycles(r) ** 2) for r in runs]))
    assert worst["wrong"] > 1.5 * worst["true"]


def test_gps_returns_and_nothing_heard():
    got = Opportunistic().run(scenario(gps_returns_s=40.0, basestations=[], characterization="true"), 5)
    assert got.stage[-1] == 2
    assert any("nothing is heard for 10.0 s" in note for note in got.notes)
    assert np.isfinite(got.clock_error_s).all()
    sigma = got.clock_sigma_s
    assert sigma[399] > 3.0 * sigma[299]  # coasting
    assert sigma[-1] < sigma[399]
    blind = Opportunistic().run(scenario(gps={"count": 0}, characterization="likelihood"), 5)
    assert np.isfinite(blind.position_m).all()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"stage_2_s": 40.0}, "stage_2_s < stage_3_s"),
        ({"gps_returns_s": 20.0}, "later than stage_3_s"),
        ({"basestations": [TOWERS[0], TOWERS[0]]}, "each name once"),
        ({"basestations": [{"name": "a", "position_m": [0.0, 0.0, 1.0]}]}, "at least 10 m"),
        ({"basestations": [TOWERS[1] | {"leaves_s": 5.0}]}, "leaves_s after joins_s"),
        ({"duration_s": 1e5}, "at most 20000"),
        ({"gps": {"count": 40}}, "less than or equal to 16"),
    ],
)
def test_refusals(change, words):
    with pytest.raises(pydantic.ValidationError, match=words):
        scenario(**change)


def test_the_examples_are_sound(tmp_path):
    system, found = load(ROOT / "examples" / "scenarios" / "pesyna_stages.toml")
    assert system.name == "opportunistic"
    assert len(found.basestations) == 3
    file = tmp_path / "a.toml"
    file.write_text(Opportunistic.example)
    assert load(file)[1].characterization == "likelihood"
