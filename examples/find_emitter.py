"""From antenna samples to "the emitter is here, within this ellipse".

A car with four antennas on its roof drives past a transmitter; every second it takes 2500 samples.

python examples/find_emitter.py
"""

import math

import numpy as np

import soopnav_cpp as sn

emitter_m = np.array([0.0, 0.0, 30.0])
east = np.linspace(-400.0, 400.0, 80)
places_m = np.column_stack([east, -150.0 + 1e-3 * east**2, np.zeros(80)])  # a bend
heading = np.arctan2(np.gradient(places_m[:, 1]), np.gradient(places_m[:, 0]))  # from east towards north

# What the antennas hear: 10 mW at L1, free space and 20 dB more, receivers of 20 MHz and 6 dB.
roof = sn.array.Manifold(sn.array.ArrayGeometry.planar(2, 2, 0.2))
link = sn.simulation.ArrayLink(roof, excess_loss_db=20.0)
turn = np.stack([[[math.cos(h), -math.sin(h), 0.0], [math.sin(h), math.cos(h), 0.0], [0.0, 0.0, 1.0]] for h in heading])
iq = link.observe(places_m, emitter_m, rotation=turn, n_samples=2500, seed=1)  # complex64 (80, 4, 2500)

# Directions in array axes, from forward to left; with the heading they are bearings from east towards north.
finder = sn.array.DirectionFinder(roof)
found = [finder.estimate(block) for block in iq]
bearing = np.array([one.azimuth_rad[0] for one in found]) + heading
sigma = np.sqrt([one.covariance_rad2[0, 0, 0] for one in found])

fix = sn.navigation.locate_source(places_m[:, :2], bearing, sigma, method="ml")
ellipse = sn.estimation.error_ellipse(fix.covariance_m2, probability=0.95)
error_m = np.linalg.norm(fix.position_m - emitter_m[:2])
print(fix)
print(f"bearings: σ from {math.degrees(sigma.min()):.2f}° to {math.degrees(sigma.max()):.2f}°")
print(f"95 %: {ellipse.semi_major_m:.2f} m x {ellipse.semi_minor_m:.2f} m; {error_m:.2f} m from the truth")
assert error_m < 2.5 * ellipse.semi_major_m < 10.0

# From one place only there is no position but a line.
parked = sn.navigation.locate_source(np.tile(places_m[:1, :2], (20, 1)), bearing[:1] + 0.01 * np.arange(20), 0.02)
print(parked)
assert parked.line is not None
