"""What is measured: our side of each case, and the peers it is held against."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, cast

import numpy as np

from soopnav_cpp import estimation
from soopnav_cpp.bench import systems
from soopnav_cpp.bench.harness import Case, Data, Peer, Prepare

__all__ = ["CASES", "ekf_planar_ins", "particle_bootstrap"]

Timed = tuple[Callable[[], Any], Callable[[Any], Sequence[float]]]


def _rts_data() -> Data:
    system = systems.fourteen_states()
    return cast(Data, system | systems.run_kalman(system, systems.simulate(system, 2400, seed=1)))


def _rts(data: Data) -> Timed:
    F, x_pred, P_pred, x, P = (data[name] for name in ("F", "x_pred", "P_pred", "x", "P"))

    def run() -> Any:
        return estimation.rts_smooth(F, x_pred, P_pred, x, P)

    def answer(smoothed: Any) -> list[float]:
        return [*smoothed[0][0], *np.diagonal(smoothed[1][0])]

    return run, answer


RTS = Case(
    name="rts/14x2400",
    title="RTS smoother of a filtered run, 14 states, 2400 steps",
    data=_rts_data,
    ours=_rts,
    peers=(Peer("filterpy", "filterpy_peers", "rts"),),
    tolerance=1e-9,
)


def ekf_planar_ins(ours: Prepare) -> Case:
    """The EKF of `systems.planar_ins`; its answer is the last state and the diagonal of its covariance."""
    return Case(
        name="ekf/planar-ins",
        title="planar INS, 6000 predicts, 120 updates with three range differences",
        data=lambda: cast(Data, systems.planar_ins()),
        ours=ours,
        peers=(Peer("filterpy", "filterpy_peers", "ekf_planar_ins"),),
        tolerance=1e-8,
    )


def particle_bootstrap(ours: Prepare, *, single: bool = False) -> Case:
    """Ten steps of the bootstrap filter of `systems.range_cloud`; its answer is the last mean, before resampling.

    Two right filters differ by the noise of a hundred thousand particles, about 0.01 in each state.

    Parameters
    ----------
    ours : callable
    single : bool
        In single precision: NumPy then works in it as well, the packages do not know it.
    """
    return Case(
        name="particle/bootstrap-1e5-float" if single else "particle/bootstrap-1e5",
        title="100 000 particles, 5 states, 10 steps of 4 ranges, systematic resampling at each",
        data=lambda: cast(Data, systems.range_cloud(100_000, 10)),
        ours=ours,
        peers=(
            Peer("numpy", "numpy_peers", "bootstrap_float" if single else "bootstrap"),
            Peer("particles", "particles_peers", "bootstrap", requirements=("particles==0.4", "numpy<2")),
            Peer("pfilter", "pfilter_peers", "bootstrap"),
            Peer("stonesoup", "stonesoup_peers", "bootstrap"),
        ),
        tolerance=0.08,
    )


CASES: tuple[Case, ...] = (RTS,)
