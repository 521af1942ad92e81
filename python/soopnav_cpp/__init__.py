"""Position, velocity and time from signals of opportunity.

The compiled engine does the work; these modules are its face:

======================  ===========================================================
`soopnav_cpp.io`        captures in and out: SigMF and raw samples
`soopnav_cpp.lte`       LTE downlink: cells, times of arrival, synthesis
`soopnav_cpp.ofdm`      OFDM: symbols, blind symbol boundaries, two-ray timing
`soopnav_cpp.array`     antenna arrays: manifolds, spectra, directions
`soopnav_cpp.navigation`  positions from observations
`soopnav_cpp.estimation`  filters, smoothers, bounds
`soopnav_cpp.measurement`  measurement models for filters
`soopnav_cpp.process`   process models for filters
`soopnav_cpp.clock`     oscillators, Allan deviations, fits
`soopnav_cpp.geometry`  Earth, local frames, directions
`soopnav_cpp.gnss`      satellite navigation: orbits, RINEX, positions
`soopnav_cpp.gps`       GPS L1 C/A: codes, signals, tracking noise
`soopnav_cpp.cdma`      cdma2000 and IS-95: pilots, signals, acquisition
`soopnav_cpp.tracking`  code and carrier tracking of spread signals
`soopnav_cpp.hf`        narrow-band receivers with GNSS time tags
`soopnav_cpp.iridium`   Iridium: channels, bursts, their detection
`soopnav_cpp.inertial`  inertial navigation: mechanisation, alignment, rest
`soopnav_cpp.orbits`  satellites: elements from files, constellations, passes
`soopnav_cpp.dsp`       transforms, correlation, delays, resampling
`soopnav_cpp.simulation`  channels, planar trajectories and inertial units
`soopnav_cpp.vision`    cameras, corners followed, motion over the ground
`soopnav_cpp.plotting`  figures
`soopnav_cpp.scenarios`  systems run from files (imported by itself, with the extra ``cli``)
======================  ===========================================================

Samples are ``complex64``, estimates ``float64``; units are in the names.
"""

from importlib.metadata import PackageNotFoundError as _PackageNotFoundError
from importlib.metadata import version as _version

from soopnav_cpp import (
    array,
    cdma,
    clock,
    dsp,
    estimation,
    geometry,
    gnss,
    gps,
    hf,
    inertial,
    io,
    iridium,
    lte,
    measurement,
    navigation,
    ofdm,
    orbits,
    plotting,
    process,
    simulation,
    tracking,
    vision,
)

__all__ = [
    "array",
    "cdma",
    "clock",
    "dsp",
    "estimation",
    "geometry",
    "gnss",
    "gps",
    "hf",
    "inertial",
    "io",
    "iridium",
    "lte",
    "measurement",
    "navigation",
    "ofdm",
    "orbits",
    "plotting",
    "process",
    "simulation",
    "tracking",
    "vision",
]

try:
    __version__ = _version("soopnav")
except _PackageNotFoundError:  # used from a build tree
    __version__ = "0+unknown"
