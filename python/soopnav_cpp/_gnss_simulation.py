"""Simulated GNSS observables: the face of the engine's simulator."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import simulation as _simulation
from soopnav_cpp.gnss import Ephemerides, Observations

_Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class GnssObservables:
    """What one or more antennas receive, and the truth; arrays are read-only, NaN below the mask.

    Attributes
    ----------
    antennas : tuple of Observations, length a
        One for each antenna, all of the same epochs and satellites.
    integers : ndarray, shape (a, s)
        Whole cycles in the phases.
    range_m, range_rate_mps : ndarray, shape (a, n, s)
        Geometric, positive when receding.
    azimuth_rad, elevation_rad : ndarray, shape (a, n, s)
        Azimuth from north towards east.
    clock_bias_m : ndarray, shape (a, n)
        c times what each receiver's clock is ahead of GPS time.
    """

    antennas: tuple[Observations, ...]
    integers: _Array
    range_m: _Array
    range_rate_mps: _Array
    azimuth_rad: _Array
    elevation_rad: _Array
    clock_bias_m: _Array

    def __repr__(self) -> str:
        visible = np.isfinite(self.range_m).sum(axis=-1)
        mean = f"{visible.mean():.1f}" if visible.size else "no"
        return (
            f"GnssObservables({len(self.antennas)} antennas, {self.range_m.shape[1]} epochs, {mean} satellites in view)"
        )


def simulate_gnss(
    ephemerides: Ephemerides,
    positions_m: npt.ArrayLike,
    time_of_week_s: npt.ArrayLike,
    week: npt.ArrayLike | None = None,
    *,
    seed: int,
    stream: int = 0,
    velocities_mps: npt.ArrayLike = 0.0,
    clock_bias_m: npt.ArrayLike = 0.0,
    clock_drift_mps: npt.ArrayLike = 0.0,
    elevation_mask_rad: float = np.deg2rad(5.0),
    cn0_zenith_dbhz: float = 47.0,
    cn0_drop_db: float = 8.0,
    noise: bool = True,
    code_sigma_m: float | None = None,
    phase_sigma_m: float | None = None,
    doppler_sigma_hz: float = 0.05,
    phase_bandwidth_hz: float = 15.0,
    code_bandwidth_hz: float = 0.5,
    early_late_chips: float = 0.5,
    integration_s: float = 20e-3,
    multipath_sigma_m: float = 0.0,
    multipath_time_s: float = 30.0,
    multipath_phase_ratio: float = 0.01,
    ionosphere: bool | npt.ArrayLike = False,
    troposphere: bool = False,
    relative_humidity: float = 0.7,
    integers: bool = True,
    max_age_s: float = 0.0,
) -> GnssObservables:
    """Pseudorange, carrier phase and Doppler of a constellation at one or more antennas.

    The model is carter eq. 2.11 and 2.21: P = ρ + b - c dt + I + T + M + v, λφ = ρ + b - c dt - I + T + λN + μM + w,
    D = -(ρ' + b' - c dt') / λ + n, with exact ranges and range rates. The constellation is that of the ephemerides:
    real ones (`gnss.read_navigation`) or synthetic ones (`gnss.walker_constellation`).

    Parameters
    ----------
    ephemerides : Ephemerides
    positions_m : array_like, shape (3,), (n, 3) or (a, n, 3)
        Antennas, ECEF, when the receiver's clock shows the epochs.
    time_of_week_s : array_like, shape (n,)
        Epochs on the receiver's clock.
    week : array_like, shape (n,) or (), optional
        Without it that of the first message.
    seed, stream : int
        Name noise, multipath and integers. The noise of one antenna and satellite does not depend on the others.
    velocities_mps : array_like, broadcast to the positions
    clock_bias_m, clock_drift_mps : array_like, shape (), (n,) or (a, n)
        c times what the receiver's clock is ahead, and its rate; without an axis for antennas they share it.
    elevation_mask_rad : float
    cn0_zenith_dbhz, cn0_drop_db : float
        Carrier to noise density overhead, and how much less it is at the horizon, in proportion to 1 - sin(elevation).
    noise : bool
        Thermal noise.
    code_sigma_m, phase_sigma_m : float, optional
        Standard deviations instead of those that the loops have at the C/N0.
    doppler_sigma_hz : float
    phase_bandwidth_hz : float
        Carrier loop (carter eq. 2.24).
    code_bandwidth_hz, early_late_chips, integration_s : float
        Code loop.
    multipath_sigma_m, multipath_time_s : float
        Of the code, times cos(elevation): first-order Gauss-Markov.
    multipath_phase_ratio : float
        The phase has this part of it.
    ionosphere : bool or array_like, shape (8,)
        True: the ephemerides' coefficients; or others.
    troposphere : bool
        Saastamoinen's model at `relative_humidity`.
    integers : bool
        A whole number of cycles, within 1e6, to each antenna's phase of each satellite; otherwise none.
    max_age_s : float
        Of ephemerides; 0: half their fit interval.

    Returns
    -------
    GnssObservables

    Raises
    ------
    ValueError
        For an option out of range or shapes that do not fit.
    """
    coefficients: Any = None
    if isinstance(ionosphere, bool):
        coefficients = ephemerides.klobuchar if ionosphere else None
        if ionosphere and coefficients is None:
            raise ValueError("ionosphere = True: the ephemerides have no coefficients; give eight numbers")
    else:
        coefficients = np.asarray(ionosphere, dtype=np.float64)
    options = _simulation.GnssObservableOptions(
        elevation_mask_rad=elevation_mask_rad,
        cn0_zenith_dbhz=cn0_zenith_dbhz,
        cn0_drop_db=cn0_drop_db,
        noise=noise,
        phase_bandwidth_hz=phase_bandwidth_hz,
        code_bandwidth_hz=code_bandwidth_hz,
        early_late_chips=early_late_chips,
        integration_s=integration_s,
        code_sigma_m=code_sigma_m,
        phase_sigma_m=phase_sigma_m,
        doppler_sigma_hz=doppler_sigma_hz,
        multipath_sigma_m=multipath_sigma_m,
        multipath_time_s=multipath_time_s,
        multipath_phase_ratio=multipath_phase_ratio,
        ionosphere=coefficients,
        troposphere=troposphere,
        relative_humidity=relative_humidity,
        integers=integers,
        max_age_s=max_age_s,
    )
    seconds = np.atleast_1d(np.asarray(time_of_week_s, dtype=np.float64))
    if week is None:
        week = int(ephemerides.records["week"][0]) if len(ephemerides) else 0
    weeks = np.ascontiguousarray(np.broadcast_to(np.asarray(week, dtype=np.float64), seconds.shape))
    places = np.asarray(positions_m, dtype=np.float64)
    antennas = places.shape[0] if places.ndim == 3 else 1
    shape = (antennas, len(seconds), 3)

    def spread(name: str, values: npt.ArrayLike, target: tuple[int, ...]) -> _Array:
        try:
            return np.ascontiguousarray(np.broadcast_to(np.asarray(values, dtype=np.float64), target))
        except ValueError:
            raise ValueError(f"{name}: shape {target} expected, got {np.shape(values)}") from None

    biases = spread("clock_bias_m", clock_bias_m, shape[:2])
    tables, prns, whole = _simulation.simulate_gnss(
        ephemerides._table,
        options,
        spread("positions_m", places, shape),
        spread("velocities_mps", velocities_mps, shape),
        weeks,
        seconds,
        biases,
        spread("clock_drift_mps", clock_drift_mps, shape[:2]),
        seed,
        stream,
    )
    for array in (*tables, whole, biases):
        array.flags.writeable = False
    code, phase, doppler, cn0, ranges, rates, azimuth, elevation = tables
    names = tuple(f"G{prn:02d}" for prn in prns)
    lli = np.zeros(code.shape[1:], dtype=np.uint8)
    lli.flags.writeable = False
    return GnssObservables(
        tuple(
            Observations(
                week=weeks.astype(np.int64),
                time_of_week_s=seconds,
                satellites=names,
                code_m=code[a],
                phase_cycles=phase[a],
                doppler_hz=doppler[a],
                cn0_dbhz=cn0[a],
                lli=lli,
                approximate_position_ecef_m=spread("positions_m", places, shape)[a, 0]
                if len(seconds)
                else np.full(3, np.nan),
            )
            for a in range(antennas)
        ),
        integers=whole,
        range_m=ranges,
        range_rate_mps=rates,
        azimuth_rad=azimuth,
        elevation_rad=elevation,
        clock_bias_m=biases,
    )
