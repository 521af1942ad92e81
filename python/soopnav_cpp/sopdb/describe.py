"""From what a receiver found out to what it contributes."""

from __future__ import annotations

from datetime import datetime
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from soopnav_cpp.sopdb.records import Characterization, Clock, Kind, Noise, Position, Provenance, Quality, Source

if TYPE_CHECKING:
    from soopnav_cpp import clock as _clock

__all__ = ["describe"]


def _rows(matrix: npt.ArrayLike) -> list[list[float]]:
    square = np.asarray(matrix, dtype=float)
    rows: list[list[float]] = (0.5 * (square + square.T)).tolist()
    return rows


def describe(
    kind: Kind,
    name: str,
    carrier_hz: float,
    *,
    receiver: str,
    noise: _clock.Characterization | None = None,
    index: int = 0,
    epoch: datetime | None = None,
    clock: tuple[npt.ArrayLike, npt.ArrayLike] | None = None,
    position: tuple[npt.ArrayLike, npt.ArrayLike] | None = None,
    duration_s: float | None = None,
    cn0_dbhz: float | None = None,
    independent: bool = True,
) -> Characterization:
    """The contribution of a receiver that has characterised a source.

    Parameters
    ----------
    kind, name, carrier_hz
        Which source.
    receiver : str
        Who says so.
    noise : soopnav_cpp.clock.Characterization, optional
        By innovation likelihood, as `soopnav_cpp.clock.characterize` gives it.
    index : int
        Which of its estimated clocks.
    epoch : datetime, optional
        Of `clock`.
    clock : (value, covariance), optional
        Offset [s] and drift [s/s] of the source's clock, shapes (2,) and (2, 2).
    position : (value, covariance), optional
        ECEF [m], shapes (3,) and (3, 3).
    duration_s : float, optional
        Of the observations; that of `noise` without it.
    cn0_dbhz : float, optional
    independent : bool
        Nothing downloaded is in it.

    Raises
    ------
    ValueError
        For what is no characterisation (``pydantic.ValidationError``).
    """
    if duration_s is None and noise is None:
        raise ValueError("duration_s: expected where noise does not say it")
    if (clock is None) != (epoch is None):
        raise ValueError("clock and epoch: both or neither expected")
    k = slice(2 * index, 2 * index + 2)
    return Characterization(
        source=Source(kind=kind, name=name, carrier_hz=carrier_hz),
        position=None
        if position is None
        else Position.model_validate({"p_e_m": np.asarray(position[0]).tolist(), "covariance_m2": _rows(position[1])}),
        clock=None
        if clock is None
        else Clock.model_validate(
            {
                "epoch": epoch,
                "bias_s": float(np.asarray(clock[0])[0]),
                "drift": float(np.asarray(clock[0])[1]),
                "covariance": _rows(clock[1]),
            }
        ),
        noise=None
        if noise is None
        else Noise.model_validate(
            {
                "h0_s": float(noise.h0[index]),
                "h_minus2_per_s": float(noise.h_minus_2[index]),
                "ln_covariance": _rows(noise.ln_covariance[k, k]),
            }
        ),
        provenance=Provenance(
            receiver=receiver,
            software="soopnav",
            method="manual" if noise is None else "innovation_likelihood",
            independent=independent,
        ),
        quality=Quality(
            duration_s=float(
                noise.epochs * noise.dt_s if duration_s is None and noise is not None else duration_s or 0
            ),
            cn0_dbhz=cn0_dbhz,
            nis=None if noise is None else float(noise.mean_nis),
        ),
    )
