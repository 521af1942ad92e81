"""
The compiled engine of soopnav. Use it through the modules of soopnav_cpp, which document it.
"""

from __future__ import annotations
from . import array
from . import cdma
from . import clock
from . import dsp
from . import estimation
from . import geometry
from . import gnss
from . import gps
from . import iridium
from . import inertial
from . import lte
from . import measurement
from . import ofdm
from . import process
from . import simulation
from . import tracking
from . import vision
from . import navigation

__all__: list[str] = [
    "array",
    "cdma",
    "clock",
    "dsp",
    "estimation",
    "geometry",
    "gnss",
    "gps",
    "inertial",
    "iridium",
    "lte",
    "measurement",
    "navigation",
    "ofdm",
    "process",
    "simulation",
    "tracking",
    "vision",
]
