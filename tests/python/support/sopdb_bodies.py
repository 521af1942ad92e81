"""Characterisations that the signal database believes, and empty databases to put them into.

Importing it skips a module of tests where the extra ``sopdb`` is not installed.
"""

from __future__ import annotations

from datetime import datetime, timedelta, timezone
from typing import Any

import numpy as np
import pytest

from soopnav_cpp import geometry

__all__ = ["characterization", "clock", "noise", "position"]

for _module in ("alembic", "fastapi", "httpx", "sqlalchemy", "uvicorn"):
    pytest.importorskip(_module)


def position(
    latitude_deg: float = 60.17, longitude_deg: float = 24.94, height_m: float = 35.0, sigma_m: float = 5.0
) -> dict[str, Any]:
    """A place with the same sigma in each direction."""
    p_e = geometry.geodetic_to_ecef(np.radians(latitude_deg), np.radians(longitude_deg), height_m)
    return {"p_e_m": p_e.tolist(), "covariance_m2": (sigma_m**2 * np.eye(3)).tolist()}


def clock(age_s: float = 60.0, bias_s: float = 1.2e-6, drift: float = 2e-11) -> dict[str, Any]:
    """An offset as it stood some time ago."""
    epoch = datetime.now(timezone.utc) - timedelta(seconds=age_s)
    return {
        "epoch": epoch.isoformat().replace("+00:00", "Z"),
        "bias_s": bias_s,
        "drift": drift,
        "covariance": [[4e-16, 0.0], [0.0, 1e-22]],
    }


def noise() -> dict[str, Any]:
    """An ovenised oscillator's."""
    return {"h0_s": 1e-23, "h_minus2_per_s": 1e-25, "ln_covariance": [[0.09, 0.01], [0.01, 0.16]]}


def characterization(name: str = "PN 12", kind: str = "cdma", **given: Any) -> dict[str, Any]:
    """A body of ``POST /v1/characterizations``; `given` replaces its parts, None where it is None."""
    body: dict[str, Any] = {
        "source": {"kind": kind, "name": name, "carrier_hz": given.pop("carrier_hz", 881.52e6)},
        "position": position(),
        "clock": clock(),
        "noise": noise(),
        "provenance": {
            "receiver": "roof",
            "software": "soopnav",
            "method": "innovation_likelihood",
            "independent": True,
        },
        "quality": {"duration_s": 240.0, "cn0_dbhz": 55.0, "nis": 1.02},
    }
    return body | given


def tower(epoch: str) -> dict[str, Any]:
    """A basestation of which everything is known, its clock at `epoch`."""
    return {
        "source": {"kind": "cdma", "name": "PN 168", "carrier_hz": 881.52e6},
        "position": {"p_e_m": [6378137.0, 10.0, 20.0], "covariance_m2": [[4, 1, 0], [1, 9, 0], [0, 0, 1]]},
        "clock": {
            "epoch": epoch,
            "bias_s": 1e-7,
            "drift": -1e-10,
            "covariance": [[1e-18, 1e-22], [1e-22, 1e-22]],
        },
        "noise": {"h0_s": 1e-23, "h_minus2_per_s": 1e-25, "ln_covariance": [[0.02, 0], [0, 0.2]]},
        "provenance": {
            "receiver": "roof",
            "software": "soopnav",
            "method": "innovation_likelihood",
            "independent": True,
        },
        "quality": {"duration_s": 240, "cn0_dbhz": 55, "nis": None},
    }
