"""Samples of every band of a receiver with one oscillator: satellites and base stations, ranges and clocks exact."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from soopnav_cpp import gps as _gps
from soopnav_cpp._core import geometry as _geometry
from soopnav_cpp._core import simulation as _simulation
from soopnav_cpp.clock import TwoState

__all__ = ["LinkBand", "LinkSource", "OpportunityLink"]

_Array = npt.NDArray[np.float64]
_Iq = npt.NDArray[np.complex64]
_PERFECT = TwoState(0.0, 0.0)


class LinkBand(NamedTuple):
    """One of a receiver's front ends.

    Attributes
    ----------
    carrier_hz, sample_rate_hz : float
    intermediate_hz : float
        Where `carrier_hz` lies in the samples.
    """

    carrier_hz: float
    sample_rate_hz: float
    intermediate_hz: float = 0.0


@dataclass(frozen=True)
class LinkSource:
    """A transmitter of a spread signal; `gps` and `pilot` make the usual ones.

    Attributes
    ----------
    name : str
    band : int
        In which it is heard, on that band's carrier.
    chips : ndarray, shape (n,), complex64
        One code period of unit power. It begins anew at whole multiples of its period of the source's clock.
    chip_rate_hz : float
    orbit : orbits.SampledOrbit
        In system time; ``SampledOrbit.fixed`` for a base station.
    cn0_dbhz : float
        At the receiver, beside noise of variance 1 a sample.
    clock : clock.TwoState
        Noise of its clock.
    clock_bias_s, clock_drift : float
        Its clock at the start: bias positive when it is ahead.
    bits : sequence of int
        +1 or -1, `symbol_s` each from clock time 0 on, repeated; empty: none.
    symbol_s : float
    """

    name: str
    band: int
    chips: _Iq
    chip_rate_hz: float
    orbit: _geometry.SampledOrbit
    cn0_dbhz: float = 45.0
    clock: TwoState = _PERFECT
    clock_bias_s: float = 0.0
    clock_drift: float = 0.0
    bits: Sequence[int] = ()
    symbol_s: float = 0.0

    @classmethod
    def gps(
        cls,
        prn: int,
        band: int,
        orbit: _geometry.SampledOrbit,
        *,
        cn0_dbhz: float = 45.0,
        clock: TwoState = _PERFECT,
        clock_bias_s: float = 0.0,
        clock_drift: float = 0.0,
        bits: Sequence[int] = (),
    ) -> LinkSource:
        """L1 C/A of a satellite; attributes as the class'."""
        chips = np.asarray(_gps.ca_code(prn), np.complex64)
        return cls(
            f"G{prn:02d}",
            band,
            chips,
            _gps.CHIP_RATE_HZ,
            orbit,
            cn0_dbhz,
            clock,
            clock_bias_s,
            clock_drift,
            tuple(bits),
            20e-3 if len(bits) else 0.0,
        )

    @classmethod
    def pilot(
        cls,
        name: str,
        band: int,
        chips: _Iq,
        position_e_m: npt.ArrayLike,
        *,
        chip_rate_hz: float = 1.2288e6,
        cn0_dbhz: float = 55.0,
        clock: TwoState = _PERFECT,
        clock_bias_s: float = 0.0,
        clock_drift: float = 0.0,
    ) -> LinkSource:
        """A base station's pilot without data, at rest.

        Parameters
        ----------
        chips : ndarray, shape (n,), complex64
            Such as `cdma.pilot_code` of its offset.
        position_e_m : array_like, shape (3,)
            ECEF.
        name, band, chip_rate_hz, cn0_dbhz, clock, clock_bias_s, clock_drift
            As the class'.
        """
        orbit = _geometry.SampledOrbit.fixed(np.asarray(position_e_m, np.float64))
        return cls(name, band, chips, chip_rate_hz, orbit, cn0_dbhz, clock, clock_bias_s, clock_drift)

    def _core(self) -> _simulation.OpportunitySource:
        return _simulation.OpportunitySource(
            band=self.band,
            chips=np.ascontiguousarray(self.chips, np.complex64),
            chip_rate_hz=self.chip_rate_hz,
            bits=list(self.bits),
            symbol_s=self.symbol_s,
            orbit=self.orbit,
            h0=self.clock.h0,
            h_minus_2=self.clock.h_minus_2,
            bias_s=self.clock_bias_s,
            drift=self.clock_drift,
            cn0_dbhz=self.cn0_dbhz,
        )


class OpportunityLink:
    """Samples of every band of a receiver whose one oscillator drives mixers and converters (tight coupling).

    A receiver clock that is ahead delays the codes and lowers the carriers of all bands alike: a signal that left Δ =
    light time + receiver's bias - source's bias ago, by the source's clock, has the carrier phase f Δ, which grows with
    range. Everything is a function of seed and sample number: blocks of any sizes have the same bits.

    Parameters
    ----------
    bands : sequence of LinkBand
    sources : sequence of LinkSource
    position_e_m : array_like, shape (3,)
        Of the antenna at the start, ECEF.
    duration_s : float
        Of the samples that can be made.
    clock : clock.TwoState
        Noise of the receiver's oscillator.
    clock_bias_s : float or array_like
        The receiver's bias at the start, positive when ahead; or at every node, in place of noise: ``ceil(duration_s /
        step_s) + 2`` numbers.
    clock_drift : float
    velocity_e_mps : array_like, shape (3,)
        Constant.
    start_s : float
        What the receiver's clock reads at its first sample, in seconds of the system time of the orbits.
    step_s : float
        Between nodes: clocks and ranges run on straight lines from one to the next.
    seed, stream : int

    Raises
    ------
    ValueError
        Naming the parameter that breaks its rule, also where an orbit does not cover the time.
    """

    def __init__(
        self,
        bands: Sequence[LinkBand],
        sources: Sequence[LinkSource],
        *,
        position_e_m: npt.ArrayLike,
        duration_s: float,
        clock: TwoState = _PERFECT,
        clock_bias_s: float | npt.ArrayLike = 0.0,
        clock_drift: float = 0.0,
        velocity_e_mps: npt.ArrayLike = (0.0, 0.0, 0.0),
        start_s: float = 0.0,
        step_s: float = 1e-3,
        seed: int,
        stream: int = 0,
    ) -> None:
        bias = np.asarray(clock_bias_s, np.float64)
        self.bands = tuple(LinkBand(*band) for band in bands)
        self.sources = tuple(sources)
        self.start_s = start_s
        self.step_s = step_s
        self._core = _simulation.OpportunityLink(
            np.array(self.bands, np.float64).reshape(-1, 3),
            [source._core() for source in self.sources],
            position_e_m=position_e_m,
            velocity_e_mps=velocity_e_mps,
            start_s=start_s,
            duration_s=duration_s,
            step_s=step_s,
            h0=clock.h0,
            h_minus_2=clock.h_minus_2,
            bias_s=float(bias) if bias.ndim == 0 else 0.0,
            drift=clock_drift,
            clock_bias_s=bias if bias.ndim else np.empty(0),
            seed=seed,
            stream=stream,
        )

    def samples(self, band: int) -> int:
        """Samples of a band, `duration_s` of them."""
        return self._core.samples(band)

    def render(self, band: int, first: int = 0, count: int | None = None, *, noise: bool = True) -> _Iq:
        """Samples of a band.

        Parameters
        ----------
        band, first : int
        count : int, optional
            All that are left by default.
        noise : bool
            Complex, of variance 1 a sample.

        Returns
        -------
        ndarray, shape (count,), complex64

        Raises
        ------
        ValueError
            For a band or samples that are not there.
        """
        left = self.samples(band) - first if count is None else count
        if first < 0 or left < 0:
            raise ValueError(f"first = {first}, count = {count}: samples of the {self.samples(band)} expected")
        return self._core.render(band, first, left, noise=noise)

    @property
    def node_s(self) -> _Array:
        """Receiver times of the nodes since the first sample."""
        return self.step_s * np.arange(len(self._core.receiver_bias_s()), dtype=np.float64)

    @property
    def receiver_bias_s(self) -> _Array:
        """The receiver's clock at the nodes."""
        return self._core.receiver_bias_s()

    def delay_s(self, source: int) -> _Array:
        """Δ of a source at the nodes: light time and clocks; its carrier phase is the carrier times that."""
        return self._core.delay_s(source)

    def source_bias_s(self, source: int) -> _Array:
        """A source's clock at the nodes, as what arrives left it."""
        return self._core.source_bias_s(source)

    def delay_at(self, source: int, t_s: npt.ArrayLike) -> _Array:
        """Δ of a source at receiver times since the first sample, as the samples have it."""
        found: _Array = np.interp(np.asarray(t_s, np.float64), self.node_s, self.delay_s(source)).astype(np.float64)
        return found

    def __repr__(self) -> str:
        length = max((self.samples(i) / band.sample_rate_hz for i, band in enumerate(self.bands)), default=math.nan)
        return f"OpportunityLink({len(self.sources)} sources in {len(self.bands)} bands, {length:g} s)"
