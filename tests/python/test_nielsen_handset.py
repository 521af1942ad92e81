"""The parts of nielsen's handset experiments: ranges out of channels, steps out of tracks, what it is compared with."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from soopnav_cpp.experiments import nielsen_handset
from soopnav_cpp.simulation import HandsetWorld

pytestmark = pytest.mark.unit


def short(**options: Any) -> HandsetWorld:
    return HandsetWorld.generate(3, duration_s=2.0, range_sigma_m=0.0, range_rate_hz=5.0, **options)


def test_ranges_are_the_paths_that_the_resolver_takes_for_the_first(monkeypatch: pytest.MonkeyPatch) -> None:
    given = []

    class Resolver:
        def __init__(self, **options: Any) -> None:
            given.append(options)

        def resolve(self, *_: Any) -> SimpleNamespace:
            return SimpleNamespace(delays_s=np.array([-1e-6, 1e-8]), toa_s=1e-8)  # a false path 300 m before

    monkeypatch.setattr(nielsen_handset, "PathResolver", Resolver)
    world = short()
    seen = nielsen_handset.through_multipath(world, 3)
    np.testing.assert_allclose(seen.ranges_m - world.ranges_m, 2.99792458, atol=1e-6)
    assert given == [{}]  # not told how many paths there are


def test_channels_have_up_to_four_echoes_that_overtake_each_other(monkeypatch: pytest.MonkeyPatch) -> None:
    counts, orders = set(), set()
    outer = np.outer

    def watched(frequencies: Any, delays: Any) -> Any:
        counts.add(len(delays))
        orders.add(tuple(np.argsort(delays)))
        assert delays[0] == 0.0
        assert (delays[1:] * nielsen_handset.LIGHT_MPS >= 5.0 - 1e-9).all()
        return outer(frequencies, delays)

    monkeypatch.setattr(nielsen_handset.np, "outer", watched)
    for seed in range(3):
        seen = nielsen_handset.through_multipath(short(), seed)
        assert np.isfinite(seen.ranges_m).any()
    assert counts <= {1, 2, 3, 4, 5}
    assert len(counts) >= 3
    assert len(orders) > len(counts)


def test_steps_out_of_tracks_are_those_of_the_walk() -> None:
    world = short(step_sigma_m=0.0, turn_sigma_rad=0.0)
    seen = nielsen_handset.through_tracks(replace(world, increments=np.full_like(world.increments, np.nan)), 3)
    error = seen.increments - world.increments
    assert np.abs(error[:, :2]).max() < 3e-4
    assert np.abs(error[:, 2]).max() < 6e-4
    assert np.abs(error).max() > 0.0


def test_booleans_without_a_camera_are_between_the_two() -> None:
    world = HandsetWorld.generate(3, duration_s=40.0)
    settled = world.epoch_s >= nielsen_handset.SETTLED_S
    rms = [
        nielsen_handset.rms(run.error_m(world.position_m)[settled])
        for run in (
            nielsen_handset.fused(world, 3, particles=500),
            nielsen_handset.without_camera(world, 3),
            nielsen_handset.alone(world),
        )
    ]
    assert rms[0] < 0.5 * rms[1] < 0.1 * rms[2]
