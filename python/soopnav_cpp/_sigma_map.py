"""From the eigenvalues of a sample covariance to the error of its bearing (carter 5.3, fig. 5.13)."""

from __future__ import annotations

import dataclasses
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import array as _array
from soopnav_cpp._core import simulation as _simulation

__all__ = ["SigmaMap"]

_Floats = npt.NDArray[np.float64]
_FORMAT, _VERSION = "soopnav-sigma-map", 1
_CURVES = ("azimuth", "elevation", "angle")
_COLUMNS = ("snr_db", "ratio", "azimuth_rms_rad", "elevation_rms_rad", "angle_rms_rad")


@dataclasses.dataclass(frozen=True, repr=False)
class SigmaMap:
    """Rms error of a bearing against the eigenvalue ratio, by Monte Carlo of one array and one source.

    The ratio is the largest eigenvalue over the mean of the others, each averaged over epochs. A single epoch's ratio
    is biased upwards and scatters where the signal is weak: `smooth` first.

    Attributes
    ----------
    snr_db, ratio : ndarray, shape (k,)
        Of one element; ascending.
    azimuth_rms_rad, elevation_rms_rad, angle_rms_rad : ndarray, shape (k,)
        Of MUSIC; `angle` is that between the directions.
    n_snapshots : int
        The map holds for sample covariances of as many.
    """

    snr_db: _Floats
    ratio: _Floats
    azimuth_rms_rad: _Floats
    elevation_rms_rad: _Floats
    angle_rms_rad: _Floats
    n_snapshots: int

    @classmethod
    def build(
        cls,
        manifold: Any,
        n_snapshots: int,
        *,
        snr_db: npt.ArrayLike | None = None,
        trials: int = 400,
        elevation_rad: tuple[float, float] = (0.02, 0.35),
        step_deg: float = 2.0,
        seed: int,
    ) -> SigmaMap:
        """Draw the map.

        Parameters
        ----------
        manifold : Manifold or ArrayGeometry
        n_snapshots : int
        snr_db : array_like, shape (k,), optional
            From -32 to 24 dB in steps of one by default.
        trials : int
            At each SNR; an rms is right to 1 / sqrt(2 trials).
        elevation_rad : (low, high)
            Directions are drawn evenly between, in all azimuths.
        step_deg : float
            Of the grid that MUSIC starts from.
        seed : int

        Raises
        ------
        ValueError
            For a value out of its range, naming it.
        """
        levels = np.arange(-32.0, 24.5, 1.0) if snr_db is None else np.sort(np.asarray(snr_db, float).reshape(-1))
        inner = getattr(manifold, "_core", manifold)
        if not isinstance(inner, _array.Manifold):
            inner = _array.Manifold(inner)
        low, high = elevation_rad
        drawn = _simulation.eigenvalue_map(
            inner,
            levels,
            snapshots=n_snapshots,
            trials=trials,
            elevation_low_rad=float(low),
            elevation_high_rad=float(high),
            step_rad=float(np.radians(step_deg)),
            seed=seed,
        )
        return cls(**dict(zip(_COLUMNS, drawn, strict=True)), n_snapshots=int(n_snapshots))

    def sigma(self, eigenvalue_ratio: npt.ArrayLike, of: str = "azimuth") -> Any:
        """Rms error at a ratio.

        Parameters
        ----------
        eigenvalue_ratio : array_like
            Of `smooth`. Below the weakest signal of the map its error; above the strongest, on along 1 / sqrt(ratio).
        of : {"azimuth", "elevation", "angle"}

        Returns
        -------
        float or ndarray of the shape of `eigenvalue_ratio`
            Radians; NaN for NaN.
        """
        if of not in _CURVES:
            raise ValueError(f"of: {of!r}; it must be one of {', '.join(_CURVES)}")
        given = np.asarray(eigenvalue_ratio, float)
        # Noise of the Monte Carlo must not make a stronger signal a worse one.
        curve = np.minimum.accumulate(getattr(self, f"{of}_rms_rad"))
        ratio = np.maximum.accumulate(self.ratio)
        keep = np.concatenate([[True], np.diff(ratio) > 0.0])
        x, y = np.log(np.maximum(ratio[keep] - 1.0, 1e-12)), np.log(curve[keep])
        at = np.log(np.maximum(given - 1.0, 1e-12))
        out = np.exp(np.interp(at, x, y) - 0.5 * np.maximum(at - x[-1], 0.0))
        out = np.where(np.isnan(given), np.nan, out)
        return float(out) if given.ndim == 0 else out

    def smooth(self, eigenvalues: npt.ArrayLike, epochs: int = 11) -> _Floats:
        """Ratio of the eigenvalues averaged over neighbouring epochs.

        Parameters
        ----------
        eigenvalues : array_like, shape (E, M)
            Descending in each row. Rows with NaN are left out.
        epochs : int
            Of a mean, odd: as many before as after; fewer at the ends.

        Returns
        -------
        ndarray, shape (E,)
            Largest over the mean of the others; NaN where no epoch near has eigenvalues.
        """
        values = np.asarray(eigenvalues, float)
        if values.ndim != 2 or values.shape[1] < 2:
            raise ValueError(
                f"eigenvalues: shape {values.shape}; (epochs, elements) with two elements at least expected"
            )
        if epochs < 1 or epochs % 2 == 0:
            raise ValueError(f"epochs: {epochs}; it must be odd and at least 1")
        good = np.isfinite(values).all(axis=1)
        pair = np.where(good[:, None], np.column_stack([values[:, 0], values[:, 1:].mean(axis=1)]), 0.0)
        sums = np.vstack([np.zeros(2), np.cumsum(pair, axis=0)])
        index = np.arange(len(values))
        first = np.maximum(index - epochs // 2, 0)
        last = np.minimum(index + epochs // 2 + 1, len(values))
        total = sums[last] - sums[first]
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(np.where(total[:, 1] > 0.0, total[:, 0] / total[:, 1], np.nan), dtype=np.float64)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the map as JSON; returns the path."""
        target = Path(path)
        document = {"format": _FORMAT, "version": _VERSION, "n_snapshots": self.n_snapshots}
        document |= {name: getattr(self, name).tolist() for name in _COLUMNS}
        target.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
        return target

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> SigmaMap:
        """Read what `save` wrote. Raises ValueError with the path for anything else."""
        given = Path(path)
        try:
            document = json.loads(given.read_text(encoding="utf-8"))
        except (json.JSONDecodeError, UnicodeDecodeError) as error:
            raise ValueError(f"{given}: not JSON ({error}); a sigma map expected") from error
        if not isinstance(document, dict) or (document.get("format"), document.get("version")) != (_FORMAT, _VERSION):
            raise ValueError(f"{given}: not a sigma map; 'format' must be {_FORMAT!r} and 'version' {_VERSION}")
        try:
            columns = [np.array(document[name], dtype=np.float64) for name in _COLUMNS]
            snapshots = int(document["n_snapshots"])
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(
                f"{given}: {error}; a list of numbers for each of {', '.join(_COLUMNS)} expected"
            ) from error
        if len({column.shape for column in columns}) != 1 or columns[0].ndim != 1 or not len(columns[0]):
            raise ValueError(f"{given}: lists of one length expected for {', '.join(_COLUMNS)}")
        if not all(np.isfinite(column).all() for column in columns) or min(column.min() for column in columns[1:]) <= 0:
            raise ValueError(f"{given}: ratios and errors must be finite and above zero")
        return cls(**dict(zip(_COLUMNS, columns, strict=True)), n_snapshots=snapshots)

    def __repr__(self) -> str:
        worst, best = np.degrees(self.azimuth_rms_rad[[0, -1]])
        return (
            f"SigmaMap({len(self.ratio)} ratios {self.ratio[0]:.3g} to {self.ratio[-1]:.3g}, azimuth {worst:.3g} to "
            f"{best:.3g} deg, {self.n_snapshots} snapshots)"
        )
