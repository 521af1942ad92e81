"""Find two cells in samples, and measure how much later one arrives than the other.

python examples/scan_and_time.py
"""

import soopnav_cpp as sn

SAMPLE_RATE_HZ = 15.36e6
SPEED_OF_LIGHT_MPS = 299_792_458.0

# Two base stations on one carrier, 1500 m apart in range, as a receiver 1.2 kHz off would record them.
near = sn.lte.CellParameters(cell_id=301, n_rb=50, n_ports=2, delay_s=2.1e-3, cfo_hz=1200.0)
far = sn.lte.CellParameters(
    cell_id=115, n_rb=50, n_ports=2, delay_s=2.1e-3 + 1500.0 / SPEED_OF_LIGHT_MPS, cfo_hz=1200.0, power_db=-8.0
)
iq = sn.lte.synthesize([near, far], SAMPLE_RATE_HZ, 614_400, snr_db=20.0, seed=1)

toas_s = {}
for cell in sn.lte.search(iq, SAMPLE_RATE_HZ, max_cfo_hz=20e3):
    toa = sn.lte.time_of_arrival(iq, SAMPLE_RATE_HZ, cell)
    toas_s[cell.cell_id], sigma_s = sn.lte.arrival_at(toa)
    print(cell)
    print(f"  first path {1e3 * toas_s[cell.cell_id]:.6f} ms +- {sigma_s * SPEED_OF_LIGHT_MPS:.2f} m")

difference_m = (toas_s[115] - toas_s[301]) * SPEED_OF_LIGHT_MPS
print(f"cell 115 is {difference_m:.2f} m farther than cell 301")
assert abs(difference_m - 1500.0) < 2.0
