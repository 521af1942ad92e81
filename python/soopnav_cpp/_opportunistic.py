"""The tightly-coupled opportunistic navigator (pesyna): one estimator for the receiver and every signal it hears."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import navigation as _navigation
from soopnav_cpp._core.geometry import SampledOrbit
from soopnav_cpp._core.navigation import ObservableUse
from soopnav_cpp._opportunistic_results import (
    OpportunisticReport,
    OpportunisticRun,
    OpportunisticSmoothed,
    OpportunisticSourceState,
)
from soopnav_cpp._source_inputs import floats, named
from soopnav_cpp.clock import ClockNoise, TwoState

__all__ = [
    "ObservableUse",
    "OpportunisticNavigator",
    "OpportunisticReport",
    "OpportunisticRun",
    "OpportunisticSmoothed",
    "OpportunisticSourceState",
]

_Array = npt.NDArray[np.float64]
_LIGHT_MPS = 299_792_458.0
_MOTIONS = {"known": 0, "static": 1, "velocity": 2}
_FORMS = {"square_root": 0, "joseph": 1}
_TAGS = {"receiver": 0, "system": 1}
_KINDS = {"phase": 0, "pseudorange": 1}

Motion = Literal["known", "static", "velocity"]
Form = Literal["square_root", "joseph"]


def _noise(clock: ClockNoise | TwoState | npt.ArrayLike) -> tuple[float, float]:
    densities = floats("clock", np.asarray(clock))
    if densities.shape != (2,):
        raise ValueError(f"clock: two power densities expected, got shape {densities.shape}")
    return float(densities[0]), float(densities[1])


def _square(name: str, given: npt.ArrayLike, size: int) -> _Array:
    """A covariance from a standard deviation, one for each axis, or the whole of it."""
    values = floats(name, given)
    if values.shape in ((), (size,)):
        return np.diag(np.broadcast_to(values, (size,)) ** 2)
    if values.shape != (size, size):
        raise ValueError(f"{name}: shape (), ({size},) or ({size}, {size}) expected, got {values.shape}")
    return values


def _vector(name: str, given: npt.ArrayLike, size: int = 3) -> _Array:
    values = floats(name, given)
    if values.shape != (size,):
        raise ValueError(f"{name}: shape ({size},) expected, got {values.shape}")
    return values


def _clock_covariance(bias_sigma_s: float, drift_sigma: float, covariance: npt.ArrayLike | None) -> _Array:
    if covariance is not None:
        return _square("clock_covariance", covariance, 2) * _LIGHT_MPS**2
    return np.diag(np.array([bias_sigma_s, drift_sigma]) * _LIGHT_MPS) ** 2


def _rows(observations: Sequence[Mapping[str, Any]]) -> _Array:
    """What the engine takes, shape (n, 9)."""
    rows = np.full((len(observations), 9), np.nan)
    allowed = {"source", "kind", "value", "sigma", "correction_m", "source_position_e_m", "source_clock_s"}
    for i, (row, given) in enumerate(zip(rows, observations, strict=True)):
        unknown = set(given) - allowed
        missing = {"source", "kind", "value", "sigma"} - set(given)
        if unknown or missing:
            what = "unknown" if unknown else "missing"
            raise ValueError(f"observations[{i}]: {what} {', '.join(sorted(unknown or missing))}")
        row[:4] = (given["source"], named("kind", given["kind"], _KINDS), given["value"], given["sigma"])
        row[4] = given.get("correction_m", 0.0)
        if given.get("source_position_e_m") is not None:
            row[5:8] = _vector("source_position_e_m", given["source_position_e_m"])
        row[8] = given.get("source_clock_s", np.nan) * _LIGHT_MPS
    return rows


class OpportunisticNavigator:
    """One estimator for the receiver and every signal it hears (pesyna eqs. 1 to 11).

    State: position, velocity, clock bias and drift of the receiver (what `motion` says), and of each source what is not
    known of its position, clock and carrier-phase ambiguity. Sources join and leave at any time. Carrier phases grow
    with range; a clock bias is clock minus system time; a fast receiver clock lengthens pseudoranges:

        phase [cycles]  = (|p - q(t_tx)| + c dt - c dt_source(t_tx) + correction_m) / wavelength + ambiguity
        pseudorange [m] =  |p - q(t_tx)| + c dt - c dt_source(t_tx) + correction_m

    Light time is solved and the Earth turns during the flight. Cycle slips, outliers and clock jumps are told apart by
    which single fault explains most of a step's innovations; see the user page "Opportunistic navigation".

    Parameters
    ----------
    position_e_m : array_like, shape (3,)
        Start, ECEF.
    position_sigma_m : float or array_like, shape (3,) or (3, 3)
        Standard deviation, of each axis, or the covariance.
    clock : ClockNoise, TwoState or (S_f, S_g)
        Noise of the receiver's clock.
    clock_bias_s, clock_drift, clock_bias_sigma_s, clock_drift_sigma : float
        Its start; seconds and seconds per second.
    clock_covariance : array_like, shape (2, 2), optional
        Of bias [s] and drift, instead of the two sigmas.
    motion : "static", "velocity" or "known"
        "known": the position is not estimated.
    velocity_e_mps, velocity_sigma_mps : array_like
        Start of "velocity".
    position_walk_m2ps : float
        Random walk of a "static" receiver, each axis.
    acceleration_psd_m2ps3 : float
        White acceleration of "velocity", each axis.
    max_sources, max_observables : int
        Room: sources present at a time, observables in one step (0: two for each source).
    form : "square_root" or "joseph"
        How the covariance is carried. The root keeps its digits in ill-conditioned runs (phases of 1e-3 cycles beside
        a clock known to 1 ms).
    time_tags : "receiver" or "system"
        Whether `t_s` is what the receiver's clock reads (geometry is then that of t_s - dt), or system time.
    fault_probability : float
        At which a good observable is taken for a fault.
    suspend_share, suspend_memory : float
        A source that contradicts in more than this share of the last so many epochs is not listened to any more.

    Raises
    ------
    ValueError
        For numbers out of range, naming the parameter.
    """

    def __init__(
        self,
        position_e_m: npt.ArrayLike,
        *,
        clock: ClockNoise | TwoState | npt.ArrayLike,
        position_sigma_m: npt.ArrayLike = 100.0,
        clock_bias_s: float = 0.0,
        clock_drift: float = 0.0,
        clock_bias_sigma_s: float = 1e-3,
        clock_drift_sigma: float = 1e-6,
        clock_covariance: npt.ArrayLike | None = None,
        motion: Motion = "static",
        velocity_e_mps: npt.ArrayLike = (0.0, 0.0, 0.0),
        velocity_sigma_mps: npt.ArrayLike = 1.0,
        position_walk_m2ps: float = 0.0,
        acceleration_psd_m2ps3: float = 1.0,
        max_sources: int = 16,
        max_observables: int = 0,
        form: Form = "square_root",
        time_tags: Literal["receiver", "system"] = "receiver",
        fault_probability: float = 1e-7,
        suspend_share: float = 0.6,
        suspend_memory: float = 20.0,
    ) -> None:
        self._kinds: dict[int, tuple[str, str]] = {}
        self._navigator = _navigation._OpportunisticNavigator(
            position=_vector("position_e_m", position_e_m),
            position_covariance=_square("position_sigma_m", position_sigma_m, 3),
            velocity=_vector("velocity_e_mps", velocity_e_mps),
            velocity_covariance=_square("velocity_sigma_mps", velocity_sigma_mps, 3),
            clock_bias_m=clock_bias_s * _LIGHT_MPS,
            clock_drift_mps=clock_drift * _LIGHT_MPS,
            clock_covariance=_clock_covariance(clock_bias_sigma_s, clock_drift_sigma, clock_covariance),
            clock=_noise(clock),
            motion=named("motion", motion, _MOTIONS),
            form=named("form", form, _FORMS),
            time_tag=named("time_tags", time_tags, _TAGS),
            position_walk_m2ps=position_walk_m2ps,
            acceleration_psd_m2ps3=acceleration_psd_m2ps3,
            max_sources=max_sources,
            max_observables=max_observables,
            fault_probability=fault_probability,
            suspend_share=suspend_share,
            suspend_memory=suspend_memory,
        )

    def add_source(
        self,
        name: str,
        kind: str,
        *,
        carrier_hz: float,
        position_e_m: npt.ArrayLike | None = None,
        position_sigma_m: npt.ArrayLike | None = None,
        orbit: SampledOrbit | None = None,
        clock: ClockNoise | TwoState | npt.ArrayLike | None = None,
        clock_bias_s: float = 0.0,
        clock_drift: float = 0.0,
        clock_bias_sigma_s: float = 1e-5,
        clock_drift_sigma: float = 1e-9,
        clock_covariance: npt.ArrayLike | None = None,
        clock_epoch_s: float = 0.0,
        ambiguity: Literal["estimated", "known"] = "estimated",
        ambiguity_cycles: float = 0.0,
        ambiguity_sigma_cycles: float = 1e4,
        ambiguity_walk_cycles2ps: float = 0.0,
        position_walk_m2ps: float = 0.0,
    ) -> int:
        """Lets a source join; its prior is of the time of the last step.

        Parameters
        ----------
        name : str
            Unique among the sources present, 1 to 20 characters.
        kind : str
            "gps", "cdma", "iridium" or what it is: kept for reports, no model depends on it.
        carrier_hz : float
        position_e_m : array_like, shape (3,), optional
            Of a source at rest. Without it and without `orbit`, each observation brings it.
        position_sigma_m : float or array_like, shape (3,) or (3, 3), optional
            Given: the position is estimated from this prior (standard deviation or covariance). Else it is known.
        orbit : geometry.SampledOrbit, optional
        clock : ClockNoise, TwoState or (S_f, S_g), optional
            Given: the clock is estimated from the prior below. Else it is known: bias and drift at `clock_epoch_s`.
        clock_bias_s, clock_drift : float
            Source minus system time, and its rate.
        clock_bias_sigma_s, clock_drift_sigma : float
        clock_covariance : array_like, shape (2, 2), optional
            Of bias [s] and drift, instead of the sigmas: a catalogue's answer.
        clock_epoch_s : float
            Of a known clock.
        ambiguity : "estimated" or "known"
        ambiguity_cycles, ambiguity_sigma_cycles : float
        ambiguity_walk_cycles2ps : float
            Random walk of the ambiguity.
        position_walk_m2ps : float
            Random walk of an estimated position.

        Returns
        -------
        int
            Its id, never used again.

        Raises
        ------
        ValueError
            For numbers out of range, a name that is present already, or no room.
        """
        position = None if position_e_m is None else _vector("position_e_m", position_e_m)
        sigma = None if position_sigma_m is None else _square("position_sigma_m", position_sigma_m, 3)
        known = named("ambiguity", ambiguity, {"estimated": False, "known": True})
        source = self._navigator.add_source(
            name=name,
            carrier_hz=carrier_hz,
            orbit=orbit,
            position=position,
            position_covariance=sigma,
            clock=None if clock is None else _noise(clock),
            clock_bias_m=clock_bias_s * _LIGHT_MPS,
            clock_drift_mps=clock_drift * _LIGHT_MPS,
            clock_epoch_s=clock_epoch_s,
            clock_covariance=_clock_covariance(clock_bias_sigma_s, clock_drift_sigma, clock_covariance),
            ambiguity_estimated=not known,
            ambiguity_cycles=ambiguity_cycles,
            ambiguity_sigma_cycles=ambiguity_sigma_cycles,
            ambiguity_walk_cycles2ps=ambiguity_walk_cycles2ps,
            position_walk_m2ps=position_walk_m2ps,
        )
        self._kinds[source] = (name, kind)
        return int(source)

    def remove_source(self, source: int) -> bool:
        """Marginalises a source away: what it taught the others stays. False for an id that is not present."""
        return bool(self._navigator.remove_source(source))

    @property
    def sources(self) -> tuple[int, ...]:
        """Ids of the sources present, in the order of their joining."""
        return tuple(self._navigator.sources())

    def find_source(self, name: str) -> int | None:
        """The id of a source present, None when there is none of that name."""
        source = self._navigator.find_source(name)
        return None if source < 0 else int(source)

    def source(self, source: int) -> OpportunisticSourceState:
        """What is known of a source that is present. ValueError for an id that is not."""
        found = self._navigator.source(source)
        if found is None:
            raise ValueError(f"source = {source}: not present")
        name, kind = self._kinds[source]
        found["clock_bias_s"] = found.pop("clock_bias_m") / _LIGHT_MPS
        found["clock_drift"] = found.pop("clock_drift_mps") / _LIGHT_MPS
        found["clock_covariance"] = found["clock_covariance"] / _LIGHT_MPS**2
        return OpportunisticSourceState(name=name, kind=kind, **found)

    def step(self, t_s: float, observations: Sequence[Mapping[str, Any]]) -> OpportunisticReport:
        """Moves to `t_s` and uses what was observed then. The first step moves nothing.

        Parameters
        ----------
        t_s : float
            Seconds from a reference of the caller's choice, the orbits' own.
        observations : sequence of mappings
            ``source`` (id), ``kind`` ("phase" [cycles] or "pseudorange" [m]), ``value``, ``sigma``; optional
            ``correction_m`` (added to the model), ``source_position_e_m`` (at transmission, in the ECEF axes of
            reception; for a source that has no position), ``source_clock_s`` (known, at transmission).

        Returns
        -------
        OpportunisticReport

        Raises
        ------
        ValueError
            For a key or kind that is not known or one that is missing. What the data hold gives statuses.
        """
        out = self._navigator.step(t_s, _rows(observations))
        uses = tuple(ObservableUse(int(use)) for use in out.pop("uses"))
        return OpportunisticReport(uses=uses, **out)

    def expected(self, t_s: float, observation: Mapping[str, Any]) -> tuple[float, _Array] | None:
        """What an observable should be at the present state, as if it were of `t_s`, and its derivatives.

        Parameters
        ----------
        t_s : float
        observation : mapping
            As for `step`; ``value`` and ``sigma`` are not read.

        Returns
        -------
        value : float
            Cycles or metres.
        jacobian : ndarray, shape (dim,)
            By the components of `component_names`.

        None where there is no value: outside an orbit, no position, a source that is not present.
        """
        found = self._navigator.expected(t_s, _rows([{"value": 0.0, "sigma": 1.0, **observation}]))
        return None if found is None else (float(found[0]), found[1])

    def run(
        self,
        t_s: npt.ArrayLike,
        phase_cycles: npt.ArrayLike | None = None,
        phase_sigma_cycles: npt.ArrayLike | None = None,
        *,
        pseudorange_m: npt.ArrayLike | None = None,
        pseudorange_sigma_m: npt.ArrayLike | None = None,
        phase_correction_m: npt.ArrayLike | None = None,
        range_correction_m: npt.ArrayLike | None = None,
        source_position_e_m: npt.ArrayLike | None = None,
        source_clock_s: npt.ArrayLike | None = None,
        sources: Sequence[int] | None = None,
        record: bool = False,
        covariance: bool = False,
    ) -> OpportunisticRun:
        """Runs `step` over a batch, in C++ and without the GIL.

        Parameters
        ----------
        t_s : array_like, shape (n,)
        phase_cycles, pseudorange_m : array_like, shape (n, s)
            NaN: not observed, and counted as such. At least one of the two.
        phase_sigma_cycles, pseudorange_sigma_m : array_like, shape (), (s,) or (n, s)
        phase_correction_m, range_correction_m : array_like, shape (n, s), optional
            Added to the models of the phase and of the pseudorange.
        source_position_e_m : array_like, shape (n, s, 3), optional
        source_clock_s : array_like, shape (n, s), optional
        sources : sequence of int, optional
            Id of each column; all present, in the order of their joining, when not given.
        record : bool
            Records for `smooth`: adds to what is recorded, or starts with room for these epochs.
        covariance : bool
            Whether whole covariances are returned.

        Returns
        -------
        OpportunisticRun

        Raises
        ------
        ValueError
            For shapes that do not fit.
        """
        t = floats("t_s", t_s)
        ids = np.array(self.sources if sources is None else sources, np.int32)
        n, s = t.size, ids.size
        if t.ndim != 1:
            raise ValueError(f"t_s: shape (n,) expected, got {t.shape}")

        def table(name: str, given: npt.ArrayLike | None, *tail: int) -> _Array:
            if given is None:
                return np.empty(0)
            values = floats(name, given)
            if values.shape != (n, s, *tail):
                raise ValueError(f"{name}: shape {(n, s, *tail)} expected, got {values.shape}")
            return values

        def sigmas(name: str, given: npt.ArrayLike | None, needed: bool) -> _Array:
            if given is None:
                if needed:
                    raise ValueError(f"{name}: expected with its observables")
                return np.empty(0)
            values = floats(name, given)
            if values.shape not in ((), (s,), (n, s)):
                raise ValueError(f"{name}: shape (), ({s},) or ({n}, {s}) expected, got {values.shape}")
            return np.ascontiguousarray(np.broadcast_to(values, (s,)) if values.ndim < 2 else values)

        if phase_cycles is None and pseudorange_m is None:
            raise ValueError("phase_cycles, pseudorange_m: at least one expected")
        clocks = table("source_clock_s", source_clock_s)
        result = self._navigator.run(
            t_s=t,
            sources=[int(k) for k in ids],
            phase=table("phase_cycles", phase_cycles),
            phase_sigma=sigmas("phase_sigma_cycles", phase_sigma_cycles, phase_cycles is not None),
            pseudorange=table("pseudorange_m", pseudorange_m),
            pseudorange_sigma=sigmas("pseudorange_sigma_m", pseudorange_sigma_m, pseudorange_m is not None),
            phase_correction=table("phase_correction_m", phase_correction_m),
            range_correction=table("range_correction_m", range_correction_m),
            source_position=table("source_position_e_m", source_position_e_m, 3),
            source_clock=clocks * _LIGHT_MPS,
            record=record,
            covariance=covariance,
        )
        return OpportunisticRun(t, self.component_names, result)

    def start_recording(self, epochs: int) -> None:
        """Room for so many steps and a fresh record; steps beyond are not recorded."""
        self._navigator.start_recording(epochs)

    @property
    def recorded(self) -> int:
        """Steps recorded."""
        return int(self._navigator.recorded)

    def smooth(self, *, gains: bool = False) -> OpportunisticSmoothed:
        """The Rauch-Tung-Striebel smoother over what was recorded; `gains`: for covariances between epochs."""
        return OpportunisticSmoothed(self._navigator.smooth(gains))

    def open_ambiguity(self, source: int, sigma_cycles: float) -> bool:
        """Opens an ambiguity again, as after a loss of lock. False when it is not estimated."""
        return bool(self._navigator.open_ambiguity(source, sigma_cycles))

    def open_clock(self, source: int | None, bias_sigma_s: float, drift_sigma: float = 0.0) -> bool:
        """Adds noise to a clock, after an announced jump; None: the receiver's. False when it is not estimated."""
        number = -1 if source is None else source
        return bool(self._navigator.open_clock(number, bias_sigma_s * _LIGHT_MPS, drift_sigma * _LIGHT_MPS))

    def set_clock_noise(self, source: int | None, clock: ClockNoise | TwoState | npt.ArrayLike) -> bool:
        """Replaces the noise of a clock from the next step on; None: the receiver's."""
        return bool(self._navigator.set_clock_noise(-1 if source is None else source, *_noise(clock)))

    def readmit(self, source: int) -> bool:
        """Listens to a suspended source again."""
        return bool(self._navigator.readmit(source))

    def unobservable(self, epochs: int = 32, *, tolerance: float = 1e-13) -> tuple[str, ...]:
        """Directions of the state that the last steps (at most 64) say nothing of, in words; empty when there is none.

        "clock bias", or "0.71 clock bias + 0.71 A ambiguity"; ambiguities count in metres.
        """
        return tuple(self._navigator.unobservable(epochs, tolerance))

    @property
    def component_names(self) -> tuple[str, ...]:
        """Of `mean`: the receiver's, then each source's."""
        return tuple(self._navigator.component_names())

    @property
    def mean(self) -> _Array:
        """The state, in metres, m/s and cycles."""
        return self._navigator.mean()

    @property
    def covariance(self) -> _Array:
        """Of `mean`, shape (dim, dim)."""
        return self._navigator.covariance()

    @property
    def t_s(self) -> float:
        """Time of the last step; NaN before the first."""
        return float(self._navigator.t_s)

    @property
    def position_e_m(self) -> _Array:
        """Receiver, ECEF."""
        return self._navigator.position()

    @property
    def position_covariance_m2(self) -> _Array:
        """Zero when it is known."""
        return self._navigator.position_covariance()

    @property
    def clock_bias_s(self) -> float:
        """Receiver minus system time."""
        return float(self._navigator.clock_bias_m) / _LIGHT_MPS

    @property
    def clock_drift(self) -> float:
        """Its rate."""
        return float(self._navigator.clock_drift_mps) / _LIGHT_MPS

    @property
    def clock_covariance(self) -> _Array:
        """Of bias [s] and drift."""
        return self._navigator.clock_covariance() / _LIGHT_MPS**2

    def __repr__(self) -> str:
        names = ", ".join(self._kinds[k][0] for k in self.sources)
        return f"OpportunisticNavigator({len(self.mean)} components; sources: {names or 'none'})"
