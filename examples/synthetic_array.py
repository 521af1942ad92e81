"""A phone that is moved by a hand's breadth knows which way it points.

Five LTE nodes around a hall, ranges of a metre's noise and an unknown clock. Ranges say where a handset is, never which
way it points. Its antenna is led once around a circle of 24 cm while a camera follows the floor: the carriers' phases
along that path are bearings, although a TCXO turns the receiver's own phase by radians between two of them. A straight
pull needs a quiet clock and leaves two answers per node; the locator sorts them out.

python examples/synthetic_array.py
"""

import numpy as np

import soopnav_cpp as sn

WAVELENGTH_M = 0.15
nodes_m = np.array([[38.0, 6.0], [4.0, 41.0], [-30.0, 22.0], [-21.0, -28.0], [17.0, -35.0]])
place_m, heading = np.array([3.0, -2.0]), np.deg2rad(70.0)
rng = np.random.default_rng(7)

# The path in the handset's axes, as the camera measures it: 50 steps of 15 mm, each half a millimetre off.
turn = 2.0 * np.pi * np.arange(50) / 50
loop = 5.0 * WAVELENGTH_M / (2.0 * np.pi) * np.column_stack((np.cos(turn), np.sin(turn)))
pull = np.column_stack((np.linspace(0.0, 5.0 * WAVELENGTH_M, 50), np.zeros(50)))
time_s = 0.04 * np.arange(50)
towards = nodes_m - place_m
bearing = np.arctan2(towards[:, 1], towards[:, 0]) - heading  # in the handset's axes

tcxo = sn.clock.TwoState(h0=7.2e-19, h_minus_2=1e-22)  # 6e-10 at 1 s: 7.5 rad per root second at 2 GHz
heard = sn.simulation.aperture_snapshots(
    loop, bearing, WAVELENGTH_M, snr_db=10.0, frequency_hz=rng.uniform(-3.0, 3.0, 5), time_s=time_s, clock=tcxo,
    path_sigma_m_per_sqrt_step=5e-4, seed=1,
)  # fmt: skip
aperture = sn.array.SyntheticAperture(path_sigma_m_per_sqrt_step=5e-4)
around = aperture.bearings(heard.phasors, heard.path_m, WAVELENGTH_M, time_s=time_s)
print("loop:    ", around)

# With the TCXO a straight pull tells nothing; with a quiet clock, both sides.
heard = sn.simulation.aperture_snapshots(pull, bearing, WAVELENGTH_M, snr_db=10.0, time_s=time_s, clock=tcxo, seed=2)
refused = aperture.bearings(heard.phasors, pull, WAVELENGTH_M, time_s=time_s)
print("pull:    ", refused.message)
heard = sn.simulation.aperture_snapshots(pull, bearing, WAVELENGTH_M, snr_db=10.0, time_s=time_s, seed=2)
quiet = sn.array.SyntheticAperture(phase="known", frequency_offsets=False)
straight = quiet.bearings(heard.phasors, pull, WAVELENGTH_M, time_s=time_s)
print("quiet:   ", straight, "or", np.round(np.rad2deg(straight.mirror_rad), 1))

errors = {}
for name, found in (("ranges", None), ("with the loop", around), ("with the quiet pull", straight)):
    locator = sn.navigation.HandsetLocator(
        nodes_m, start_heading_sigma_rad=3.2, clock_sigma_m=100.0, nlos=False, particles=1000, seed=3
    )
    noise = np.random.default_rng(11)
    for t in 0.1 * np.arange(21):
        ranges = np.linalg.norm(towards, axis=1) + 25.0 + noise.normal(0.0, 1.0, 5)
        locator.update_ranges(ranges, 1.0, t)
        locator.move([0.0, 0.0, 0.0], t, track_covariance=[1e-8, 1e-8, 1e-8])
    if found is not None:
        locator.update_bearings(found.bearing_rad, found.sigma_rad, 2.0, mirror_rad=found.mirror_rad)
    at = locator.estimate()
    off = np.angle(np.exp(1j * (at.heading_rad - heading)))
    errors[name] = (float(np.linalg.norm(at.position_m - place_m)), float(np.abs(off)))
    print(
        f"{name:20s} {errors[name][0]:.2f} m off, heading "
        + (f"{np.rad2deg(off):+.1f}° off ± {np.rad2deg(at.heading_sigma_rad):.1f}°" if found else "unknown")
    )

assert around.status is sn.array.ApertureStatus.OK
assert not refused.ok
assert np.isfinite(straight.mirror_rad).all()
assert errors["with the loop"][1] < np.deg2rad(4.0)
assert errors["with the quiet pull"][1] < np.deg2rad(6.0)
