"""A position from times of arrival, with one that comes from around a corner.

python examples/locate.py
"""

import numpy as np

import soopnav_cpp as sn

SPEED_OF_LIGHT_MPS = 299_792_458.0

nodes_enu_m = np.array(
    [[150, 620, 35], [900, -250, 28], [-700, 500, 42], [-450, -900, 31], [1100, 900, 40]], dtype=float
)
here_m = np.array([180.0, -120.0, 1.5])
sigmas_s = np.full(5, 5e-9)

rng = np.random.default_rng(1)
toas_s = np.linalg.norm(nodes_enu_m - here_m, axis=1) / SPEED_OF_LIGHT_MPS
toas_s += 3.2e-3 + rng.normal(0.0, sigmas_s)  # the receiver's clock, and noise
toas_s[4] += 46.0 / SPEED_OF_LIGHT_MPS  # a detour

fix = sn.navigation.position_fix(nodes_enu_m, toas_s, sigmas_s, height_m=1.5, dimensions=2)
ellipse = sn.estimation.error_ellipse(fix.covariance_m2[:2, :2], probability=0.95)
print(fix)
print(fix.dop)
print(f"95 %: {ellipse.semi_major_m:.1f} m x {ellipse.semi_minor_m:.1f} m")
print(f"node 4: {fix.use[4].name.lower()}, {fix.residuals_m[4]:.1f} m against a gate of {fix.gates_m[4]:.1f} m")
assert not fix.used[4]
assert np.linalg.norm(fix.position_m - here_m) < 6.0
