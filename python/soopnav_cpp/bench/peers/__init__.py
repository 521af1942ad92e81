"""The peers of ``soopnav bench``: each module needs NumPy and its package, nothing of soopnav.

A function gets the case's data and returns what is timed, and what makes comparable numbers of its result. Each is
written as its package's users would write it, with whatever makes it fast: arrays over particles, no Python loop where
the package has a call, resampling indices by NumPy where the package's own are a loop.
"""
