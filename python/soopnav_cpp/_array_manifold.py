"""Manifolds: ideal, measured, with errors; read from and written to files."""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import array as _array
from soopnav_cpp._core.array import ArrayGeometry
from soopnav_cpp._extras import require

_COLUMNS = ("frequency_hz", "azimuth_deg", "elevation_deg", "element", "gain_db", "phase_deg")
_LIGHT_MPS = 299_792_458.0
Reals = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]


class Manifold:
    """How the elements of an array answer a plane wave: ``a(u, f)``, one complex number per element.

    Model: ``C diag(errors) diag(measured) exp(+j 2 pi r . u f / c)``. Ideal when made from a geometry; measured
    responses come from files (`load`) or arrays (`measured`); errors and coupling are added by ``with_...``, which
    leave this one alone. A measured response is interpolated linearly in real and imaginary part after the geometry's
    own phase is taken out of it; directions it does not cover raise ValueError in `steering` and are left out of a
    search. It can be pickled.

    Parameters
    ----------
    geometry : ArrayGeometry
    """

    def __init__(self, geometry: ArrayGeometry) -> None:
        self._core = _array.Manifold(geometry)
        self._grid: tuple[Reals, Reals, Reals, Complexes] | None = None
        self._gain_db = np.zeros(len(geometry))
        self._phase_rad = np.zeros(len(geometry))
        self._coupling: Complexes | None = None

    def _with(self, core: _array.Manifold) -> Manifold:
        out = Manifold.__new__(Manifold)
        out.__dict__.update(self.__dict__)
        out._core = core
        return out

    def __getstate__(self) -> dict[str, Any]:
        geometry = self.geometry
        return {
            "geometry": (geometry.positions_m, geometry.frequency_hz, geometry.name),
            "grid": self._grid,
            "errors": (self._gain_db, self._phase_rad),
            "coupling": self._coupling,
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        geometry = ArrayGeometry(*state["geometry"])
        made = Manifold(geometry) if state["grid"] is None else Manifold.measured(geometry, *state["grid"])
        if any(np.any(part) for part in state["errors"]):
            made = made.with_errors(*state["errors"])
        if state["coupling"] is not None:
            made = made.with_coupling(state["coupling"])
        self.__dict__.update(made.__dict__)

    @classmethod
    def measured(
        cls,
        geometry: ArrayGeometry,
        frequency_hz: npt.ArrayLike,
        azimuth_rad: npt.ArrayLike,
        elevation_rad: npt.ArrayLike,
        response: npt.ArrayLike,
    ) -> Manifold:
        """Make a manifold of measured responses.

        Parameters
        ----------
        geometry : ArrayGeometry
        frequency_hz : array_like, shape (F,)
            Ascending.
        azimuth_rad : array_like, shape (A,)
            Evenly spaced and ascending; a whole turn less one step is periodic.
        elevation_rad : array_like, shape (E,)
            Evenly spaced and ascending.
        response : array_like, shape (M, F, E, A), complex
            Of each element, with the phase of its position in it (as measured in a chamber that turns the array about
            its origin).

        Raises
        ------
        ValueError
            For sizes that do not fit, grids that are not regular, and holes (NaN): how many, and the first.
        """
        frequency = np.atleast_1d(np.asarray(frequency_hz, dtype=np.float64))
        azimuth = np.atleast_1d(np.asarray(azimuth_rad, dtype=np.float64))
        elevation = np.atleast_1d(np.asarray(elevation_rad, dtype=np.float64))
        values = np.asarray(response, dtype=np.complex128)
        expected = (len(geometry), len(frequency), len(elevation), len(azimuth))
        if values.shape != expected:
            raise ValueError(f"response: shape {values.shape}; {expected} expected: elements, F, E, A")
        u = _unit_vectors(azimuth[None, :], elevation[:, None])
        path = np.einsum("mi,eai->mea", geometry.positions_m, u)
        correction = values * np.exp(-2j * np.pi / _LIGHT_MPS * frequency[None, :, None, None] * path[:, None])
        out = cls(geometry)
        out._grid = (frequency, azimuth, elevation, values)
        rows = np.ascontiguousarray(np.moveaxis(correction, 0, -1)).reshape(-1, len(geometry))
        out._core = _array.Manifold.measured(geometry, frequency, azimuth, elevation, rows)
        return out

    @classmethod
    def load(cls, path: str | Path, geometry: ArrayGeometry) -> Manifold:
        """Read measured responses from a ``.csv`` or ``.npz`` file.

        CSV has a header and the columns frequency_hz, azimuth_deg, elevation_deg, element (0 ... M - 1), gain_db and
        phase_deg, in any order of columns and rows; every point of the grid that its values span; a gain of -inf dB is
        no response at all. NPZ has the arrays
        frequency_hz (F,), azimuth_rad (A,), elevation_rad (E,) and response (M, F, E, A).

        Raises
        ------
        ValueError
            Saying which file and where: a missing column or array, a number that is none, a point twice, holes.
        OSError
            When there is no such file.
        """
        path = Path(path)
        try:
            if path.suffix.lower() == ".npz":
                with path.open("rb") as file, np.load(file, allow_pickle=False) as data:
                    missing = [k for k in ("frequency_hz", "azimuth_rad", "elevation_rad", "response") if k not in data]
                    if missing:
                        raise ValueError(f"no array {missing[0]!r}")
                    arrays = [data[k] for k in ("frequency_hz", "azimuth_rad", "elevation_rad", "response")]
                return cls.measured(geometry, *arrays)
            if path.suffix.lower() == ".csv":
                return cls.measured(geometry, *_read_csv(path, len(geometry)))
        except OSError:
            raise
        except Exception as error:  # a damaged zip archive has exceptions of its own
            raise ValueError(f"{path}: {error}") from None
        raise ValueError(f"{path}: a manifold file ends in .csv or .npz")

    def save(
        self,
        path: str | Path,
        *,
        azimuth_rad: npt.ArrayLike | None = None,
        elevation_rad: npt.ArrayLike | None = None,
        frequency_hz: npt.ArrayLike | None = None,
    ) -> Path:
        """Write the responses on a grid, errors and coupling included: what `load` reads.

        Parameters
        ----------
        path : path-like
            ``.csv`` or ``.npz``.
        azimuth_rad, elevation_rad, frequency_hz : array_like, optional
            The grid; without one that of the measurement, or 5 degrees over the upper half at the geometry's frequency.
        """
        path = Path(path)
        grid = self._grid or (
            np.array([self.geometry.frequency_hz]),
            np.deg2rad(np.arange(-180.0, 180.0, 5.0)),
            np.deg2rad(np.arange(0.0, 90.1, 5.0)),
        )
        frequency, azimuth, elevation = (
            kept if given is None else np.atleast_1d(np.asarray(given, dtype=np.float64))
            for given, kept in zip((frequency_hz, azimuth_rad, elevation_rad), grid[:3], strict=True)
        )
        el, az = (part.ravel() for part in np.meshgrid(elevation, azimuth, indexing="ij"))
        shape = (len(self), len(elevation), len(azimuth))
        response = np.stack([self.steering(az, el, frequency_hz=f).reshape(shape) for f in frequency], axis=1)
        if path.suffix.lower() == ".npz":
            np.savez(path, frequency_hz=frequency, azimuth_rad=azimuth, elevation_rad=elevation, response=response)
        elif path.suffix.lower() == ".csv":
            with path.open("w", newline="", encoding="utf-8") as file:
                writer = csv.writer(file, lineterminator="\n")
                writer.writerow(_COLUMNS)
                for (m, f, e, a), value in np.ndenumerate(response):
                    gain = 20.0 * math.log10(abs(value)) if value != 0.0 else -math.inf
                    phase = math.degrees(np.angle(value))
                    place = (frequency[f], math.degrees(azimuth[a]), math.degrees(elevation[e]))
                    writer.writerow([repr(float(x)) for x in place] + [m, repr(gain), repr(phase)])
        else:
            raise ValueError(f"{path}: a manifold file ends in .csv or .npz")
        return path

    def with_errors(self, gain_db: npt.ArrayLike, phase_rad: npt.ArrayLike) -> Manifold:
        """Add a gain [dB] and a phase [rad] error to each element, shapes (M,); a new manifold."""
        gains, phases = np.asarray(gain_db, dtype=np.float64), np.asarray(phase_rad, dtype=np.float64)
        out = self._with(self._core.with_errors(gains, phases))
        out._gain_db, out._phase_rad = self._gain_db + gains, self._phase_rad + phases
        return out

    def with_random_errors(self, gain_sigma_db: float, phase_sigma_rad: float, seed: int) -> Manifold:
        """Add independent normal errors of these standard deviations, named by a seed; a new manifold."""
        for name, sigma in (("gain_sigma_db", gain_sigma_db), ("phase_sigma_rad", phase_sigma_rad)):
            if not (math.isfinite(sigma) and sigma >= 0.0):
                raise ValueError(f"{name}: {sigma}; a finite number >= 0 expected")
        draws = np.random.default_rng(seed).standard_normal((2, len(self)))
        return self.with_errors(gain_sigma_db * draws[0], phase_sigma_rad * draws[1])

    def with_coupling(self, coupling: npt.ArrayLike) -> Manifold:
        """Put a coupling matrix (M, M) before the steering vectors; a new manifold."""
        matrix = np.asarray(coupling, dtype=np.complex128)
        out = self._with(self._core.with_coupling(matrix))
        out._coupling = matrix if self._coupling is None else matrix @ self._coupling
        return out

    @property
    def geometry(self) -> ArrayGeometry:
        """The elements."""
        return self._core.geometry

    @property
    def ideal(self) -> bool:
        """Isotropic elements without errors or coupling."""
        return self._core.ideal

    @property
    def gain_db(self) -> Reals:
        """Injected gain errors, shape (M,)."""
        return np.array(self._gain_db, dtype=np.float64)

    @property
    def phase_rad(self) -> Reals:
        """Injected phase errors, shape (M,)."""
        return np.array(self._phase_rad, dtype=np.float64)

    def __len__(self) -> int:
        return len(self._core)

    def __repr__(self) -> str:
        kind = "ideal" if self.ideal else "measured" if self._grid is not None else "with errors"
        return f"Manifold({kind}, {self.geometry!r})"

    def reaches(self, azimuth_rad: npt.ArrayLike, elevation_rad: npt.ArrayLike = 0.0) -> npt.NDArray[np.bool_]:
        """Whether responses are there for directions, broadcast against each other; always for what is not measured."""
        azimuth, elevation = np.broadcast_arrays(
            np.asarray(azimuth_rad, dtype=np.float64), np.asarray(elevation_rad, dtype=np.float64)
        )
        inside = np.isfinite(azimuth) & np.isfinite(elevation)
        if self._grid is None:
            return np.asarray(inside)
        _, columns, rows, _ = self._grid
        inside &= (elevation >= rows[0] - 1e-9) & (elevation <= rows[-1] + 1e-9)
        turn = 2.0 * np.pi
        if columns[-1] - columns[0] + (columns[1] - columns[0]) < turn * (1.0 - 1e-9):
            offset = np.mod(azimuth - columns[0] + 1e-9, turn)
            pole = np.abs(elevation) > np.pi / 2 - 1e-9
            inside &= pole | (offset <= columns[-1] - columns[0] + 2e-9)
        return np.asarray(inside)

    def steering(
        self, azimuth_rad: npt.ArrayLike, elevation_rad: npt.ArrayLike = 0.0, frequency_hz: float | None = None
    ) -> Complexes:
        """Steering vectors.

        Parameters
        ----------
        azimuth_rad, elevation_rad : array_like
            Broadcast against each other and taken in C order.
        frequency_hz : float, optional
            Of the signal; without one the geometry's.

        Returns
        -------
        ndarray, shape (M, n), complex128

        Raises
        ------
        ValueError
            For a direction that is not finite or that the measured responses do not reach.
        """
        azimuth, elevation = np.broadcast_arrays(
            np.asarray(azimuth_rad, dtype=np.float64), np.asarray(elevation_rad, dtype=np.float64)
        )
        if frequency_hz is not None and not (math.isfinite(frequency_hz) and frequency_hz > 0.0):
            raise ValueError(f"frequency_hz: {frequency_hz}; a positive finite frequency expected")
        return self._core.steering(azimuth.ravel(), elevation.ravel(), frequency_hz or 0.0)


def _unit_vectors(azimuth: npt.ArrayLike, elevation: npt.ArrayLike) -> Reals:
    flat = np.cos(elevation)
    parts = np.broadcast_arrays(flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation))
    return np.stack(parts, axis=-1)


def _read_csv(path: Path, elements: int) -> tuple[Reals, Reals, Reals, Complexes]:
    with path.open(newline="", encoding="utf-8") as file:
        reader = csv.reader(file)
        header = [name.strip() for name in next(reader, [])]
        for column in _COLUMNS:
            if column not in header:
                raise ValueError(f"line 1: no column {column!r}")
        places = [header.index(column) for column in _COLUMNS]
        rows, lines = [], []  # blank lines count where a line is named
        for row in reader:
            if not row:
                continue
            lines.append(reader.line_num)
            try:
                rows.append([float(row[place]) for place in places])
            except (ValueError, IndexError):
                raise ValueError(f"line {lines[-1]}: six numbers expected, got {','.join(row)!r}") from None
    if not rows:
        raise ValueError("no responses below the header")
    table = np.array(rows)
    if not np.isfinite(table[:, :4]).all():
        line = lines[int(np.flatnonzero(~np.isfinite(table[:, :4]).all(axis=1))[0])]
        raise ValueError(f"line {line}: frequency, angles and element must be finite")
    element = table[:, 3].astype(np.int64)
    wrong = np.flatnonzero((element != table[:, 3]) | (element < 0) | (element >= elements))
    if len(wrong):
        raise ValueError(f"line {lines[wrong[0]]}: element {table[wrong[0], 3]:g}; 0 to {elements - 1} expected")
    axes: list[Reals] = []
    index: list[npt.NDArray[np.int64]] = []
    for angle in range(3):
        rounded = np.round(table[:, angle], 9)
        axes.append(np.unique(rounded))
        index.append(np.searchsorted(axes[-1], rounded).astype(np.int64))
    points = elements * math.prod(len(axis) for axis in axes)
    if points > max(1_000_000, 4 * len(table)):
        sizes = " x ".join(str(len(axis)) for axis in axes)
        raise ValueError(
            f"holes: frequencies, azimuths and elevations span {sizes} points for {elements} elements, "
            f"of which {len(table)} are there"
        )
    response = np.full((elements, *(len(axis) for axis in (axes[0], axes[2], axes[1]))), np.nan, dtype=np.complex128)
    place = (element, index[0], index[2], index[1])
    if len(np.unique(np.ravel_multi_index(place, response.shape))) < len(table):
        raise ValueError("a point of the grid stands there twice")
    with np.errstate(over="ignore", invalid="ignore"):  # what is not finite then is a hole
        response[place] = 10.0 ** (table[:, 4] / 20.0) * np.exp(1j * np.deg2rad(table[:, 5]))
    return axes[0], np.deg2rad(axes[1]), np.deg2rad(axes[2]), response


_KEYS = {
    "name", "kind", "frequency_hz", "elements_m", "n", "nx", "ny", "spacing_wavelengths", "radius_wavelengths",
    "spacing_m", "radius_m", "manifold", "gain_db", "phase_deg", "calibration",
}  # fmt: skip
_USES = {
    "elements": {"elements_m"},
    "ula": {"n", "spacing_wavelengths", "spacing_m"},
    "uca": {"n", "radius_wavelengths", "radius_m"},
    "planar": {"nx", "ny", "spacing_wavelengths", "spacing_m"},
}


def load_array(path: str | Path) -> Manifold:
    """Read an array's description from a TOML file.

    Keys: ``name``; ``frequency_hz``; ``kind``, one of "elements" (with ``elements_m``, a list of positions), "ula"
    (``n``), "uca" (``n``) or "planar" (``nx``, ``ny``), with ``spacing_wavelengths`` (0.5 without) or ``spacing_m``,
    "uca" with ``radius_wavelengths`` or ``radius_m``; ``manifold``, a file of measured responses beside this one;
    ``gain_db`` and ``phase_deg``, one error per element; ``calibration``, a file that the command line applies to
    samples before they come here.

    Returns
    -------
    Manifold
        Whose ``geometry.name`` is the description's.

    Raises
    ------
    ValueError
        Naming the file, the key, its value and the rule.
    OSError
        When there is no such file.
    """
    path = Path(path)
    tomlkit = require("tomlkit", "cli", "reading an array's description")
    try:
        text = tomlkit.parse(path.read_text(encoding="utf-8")).unwrap()
    except (tomlkit.exceptions.TOMLKitError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: {error}") from None
    try:
        return _from_description(text, path)
    except KeyError as error:
        raise ValueError(f"{path}: {error.args[0]} is missing") from None
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path}: {error}") from None


def _from_description(text: dict[str, Any], path: Path) -> Manifold:
    unknown = sorted(set(text) - _KEYS)
    if unknown:
        raise ValueError(f"{unknown[0]}: no such key; known are {', '.join(sorted(_KEYS))}")
    kind = text.get("kind", "elements")
    if not isinstance(kind, str) or kind not in _USES:
        raise ValueError(f"kind: {kind!r}; one of {', '.join(_USES)} expected")
    useless = sorted(set(text) & set().union(*_USES.values()) - _USES[kind])
    if useless:
        raise ValueError(f"{useless[0]}: not for kind {kind!r}, which knows {', '.join(sorted(_USES[kind]))}")
    frequency_hz = float(text["frequency_hz"])
    if not (math.isfinite(frequency_hz) and frequency_hz > 0.0):
        raise ValueError(f"frequency_hz: {frequency_hz}; a positive finite frequency expected")
    wavelength_m = _LIGHT_MPS / frequency_hz

    def count(name: str) -> int:
        if isinstance(text[name], bool) or not isinstance(text[name], int):
            raise ValueError(f"{name}: {text[name]!r}; a whole number expected")
        return int(text[name])

    def length(name: str, default: float | None = None) -> float:
        if f"{name}_m" in text and f"{name}_wavelengths" in text:
            raise ValueError(f"{name}_m, {name}_wavelengths: both are given; one of them expected")
        if f"{name}_m" in text:
            return float(text[f"{name}_m"]) / wavelength_m
        if f"{name}_wavelengths" not in text and default is not None:
            return default
        return float(text[f"{name}_wavelengths"])

    if kind == "elements":
        geometry = ArrayGeometry(np.asarray(text["elements_m"], dtype=np.float64), frequency_hz)
    elif kind == "ula":
        geometry = ArrayGeometry.ula(count("n"), length("spacing", 0.5), frequency_hz=frequency_hz)
    elif kind == "uca":
        geometry = ArrayGeometry.uca(count("n"), length("radius"), frequency_hz=frequency_hz)
    else:
        geometry = ArrayGeometry.planar(count("nx"), count("ny"), length("spacing", 0.5), frequency_hz=frequency_hz)
    geometry = ArrayGeometry(geometry.positions_m, frequency_hz, str(text.get("name", path.stem)))
    manifold = Manifold(geometry)
    if "manifold" in text:
        manifold = Manifold.load(path.parent / str(text["manifold"]), geometry)
    if "gain_db" in text or "phase_deg" in text:
        zeros = np.zeros(len(geometry))
        manifold = manifold.with_errors(text.get("gain_db", zeros), np.deg2rad(text.get("phase_deg", zeros)))
    return manifold
