"""Positions from observations, and the navigators."""

from __future__ import annotations

import numpy.typing as npt

from soopnav_cpp._cooperative import (
    CooperativeRun,
    CooperativeTracker,
    PairBursts,
    PairStart,
    PairStartStatus,
    PairUse,
    SmoothedRun,
    expected_pair,
    start_pair,
)
from soopnav_cpp._cooperative_motion import (
    CooperativeGroup,
    GroupRun,
    GroupStatus,
    InertialPairRun,
    InertialTracker,
    InertialUnit,
    ManoeuvringTracker,
    TwoMotions,
    pair_noise_shares,
    shared_anchor_correlation,
)
from soopnav_cpp._core import navigation as _navigation
from soopnav_cpp._core.navigation import DopplerStatus, DopplerUse, FixStatus, NodeUse, PositionFix
from soopnav_cpp._doppler_fix import DopplerFix, doppler_fix
from soopnav_cpp._handset import (
    HandsetEstimate,
    HandsetLocator,
    HandsetReport,
    HandsetRun,
    HandsetStatus,
    HandsetUse,
)
from soopnav_cpp._node_mapping import NodeMap, NodeMapStatus, NodeStart, locate_nodes, start_node
from soopnav_cpp._ofdm_inertial import (
    ImuCounts,
    LinkReport,
    OfdmInertialNavigator,
    OfdmInertialRun,
    PlanarStart,
    RangeChanges,
)
from soopnav_cpp._opportunistic import (
    ObservableUse,
    OpportunisticNavigator,
    OpportunisticReport,
    OpportunisticRun,
    OpportunisticSmoothed,
    OpportunisticSourceState,
)
from soopnav_cpp._phase_stitcher import BurstStatus, PhaseStitcher, StitchedPhase, stitch_phase
from soopnav_cpp._source import (
    BearingUse,
    SourceFix,
    SourceLine,
    SourceLocator,
    SourceMethod,
    SourceRun,
    SourceStatus,
    locate_source,
)
from soopnav_cpp._source_bounds import cep, likelihood_surface, source_crlb
from soopnav_cpp._source_tracks import SourceTrack, SourceTracks, TrackState
from soopnav_cpp._strapdown import StrapdownNavigator, StrapdownRun, StrapdownStart, strapdown_errors

__all__ = [
    "BearingUse",
    "BurstStatus",
    "CooperativeGroup",
    "CooperativeRun",
    "CooperativeTracker",
    "DopplerFix",
    "DopplerStatus",
    "DopplerUse",
    "FixStatus",
    "GroupRun",
    "GroupStatus",
    "HandsetEstimate",
    "HandsetLocator",
    "HandsetReport",
    "HandsetRun",
    "HandsetStatus",
    "HandsetUse",
    "ImuCounts",
    "InertialPairRun",
    "InertialTracker",
    "InertialUnit",
    "LinkReport",
    "ManoeuvringTracker",
    "NodeMap",
    "NodeMapStatus",
    "NodeStart",
    "NodeUse",
    "ObservableUse",
    "OfdmInertialNavigator",
    "OfdmInertialRun",
    "OpportunisticNavigator",
    "OpportunisticReport",
    "OpportunisticRun",
    "OpportunisticSmoothed",
    "OpportunisticSourceState",
    "PairBursts",
    "PairStart",
    "PairStartStatus",
    "PairUse",
    "PhaseStitcher",
    "PlanarStart",
    "PositionFix",
    "RangeChanges",
    "SmoothedRun",
    "SourceFix",
    "SourceLine",
    "SourceLocator",
    "SourceMethod",
    "SourceRun",
    "SourceStatus",
    "SourceTrack",
    "SourceTracks",
    "StitchedPhase",
    "StrapdownNavigator",
    "StrapdownRun",
    "StrapdownStart",
    "TrackState",
    "TwoMotions",
    "cep",
    "doppler_fix",
    "expected_pair",
    "likelihood_surface",
    "locate_nodes",
    "locate_source",
    "pair_noise_shares",
    "position_fix",
    "shared_anchor_correlation",
    "source_crlb",
    "start_node",
    "start_pair",
    "stitch_phase",
    "strapdown_errors",
]


def position_fix(
    nodes_enu_m: npt.ArrayLike,
    toas_s: npt.ArrayLike,
    sigmas_s: npt.ArrayLike,
    *,
    clock_offsets_s: npt.ArrayLike | None = None,
    node_sigmas_s: npt.ArrayLike | None = None,
    dimensions: int | None = None,
    height_m: float | None = None,
    near_m: npt.ArrayLike | None = None,
    period_s: float = 10e-3,
    reject_outliers: bool = True,
    false_alarm_probability: float = 1e-3,
    max_iterations: int = 50,
) -> PositionFix:
    """Position and receiver clock from times of arrival at one receiver, by weighted least squares.

    No start is needed. Where two positions fit, both are reported; one node at a time is rejected when the others
    contradict it.

    Parameters
    ----------
    nodes_enu_m : array_like, shape (n, 3)
        Antennas, east, north, up in one local level frame. At most 64.
    toas_s, sigmas_s : array_like, shape (n,)
        Times of arrival and their standard deviations. A node with a NaN is left out.
    clock_offsets_s : array_like, shape (n,), optional
        How much later than the common time each node transmits.
    node_sigmas_s : array_like, shape (n,), optional
        Standard deviation of each node's own clock and place.
    dimensions : {2, 3}, optional
        Coordinates to estimate: two at `height_m`, or three. Without it as many as the nodes allow.
    height_m : float, optional
        The receiver's height, for two dimensions.
    near_m : array_like, shape (3,), optional
        Where two positions fit equally, the one nearer to this is taken.
    period_s : float
        Times of arrival repeat after this (the LTE radio frame).
    reject_outliers : bool
    false_alarm_probability : float
        Of each test for an outlier.
    max_iterations : int

    Returns
    -------
    PositionFix
        ``status``, ``position_m``, ``covariance_m2``, ``clock_bias_s``, ``clock_sigma_s``, ``dop``, ``unobservable``,
        ``residuals_m``, ``gates_m``, ``used``, ``alternatives_m``; ``message`` says it in a sentence.

    Raises
    ------
    ValueError
        For lengths that differ, nodes that are not finite, options out of range. Too few nodes, or nodes that do not
        determine a position, are no error but a ``status``.
    """
    return _navigation.position_fix(
        nodes_enu_m,
        toas_s,
        sigmas_s,
        clock_offsets_s=clock_offsets_s,
        node_sigmas_s=node_sigmas_s,
        dimensions=dimensions,
        height_m=height_m,
        near_m=near_m,
        period_s=period_s,
        reject_outliers=reject_outliers,
        false_alarm_probability=false_alarm_probability,
        max_iterations=max_iterations,
    )
