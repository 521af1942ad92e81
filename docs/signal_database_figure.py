"""Makes docs/images/signal_database.png: the page of a signal database with invented sources about Helsinki.

    python docs/signal_database_figure.py

Needs Chromium and its driver (Debian: chromium, chromium-driver) and the extras sopdb and dev.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from selenium import webdriver
from selenium.webdriver.common.by import By

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests/python/support"))

from sopdb_server import body, database  # noqa: E402

from soopnav_cpp.sopdb.contributing import Contributor  # noqa: E402
from soopnav_cpp.sopdb.records import Characterization  # noqa: E402

#: Kind, name, carrier [MHz], latitude, longitude [deg], h0 [s], h-2 [Hz], receivers.
SOURCES = [
    ("cdma", "PN 12 Pasila", 881.52, 60.203, 24.935, 3e-25, 3e-27, 3),
    ("cdma", "PN 168 Kallio", 881.52, 60.184, 24.951, 1e-23, 1e-25, 3),
    ("cdma", "PN 204 Munkkiniemi", 882.75, 60.197, 24.878, 2e-23, 4e-25, 2),
    ("cdma", "PN 336 Herttoniemi", 881.52, 60.195, 25.031, 8e-24, 2e-25, 1),
    ("lte", "cell 301 Otaniemi", 1815.3, 60.187, 24.827, 4e-23, 1e-24, 2),
    ("lte", "cell 7 Ruoholahti", 1815.3, 60.164, 24.912, 3e-23, 2e-24, 3),
    ("lte", "cell 112 Malmi", 806.0, 60.250, 25.011, 6e-23, 1e-24, 1),
    ("lte", "cell 88 Lauttasaari", 1815.3, 60.158, 24.872, 5e-23, 1e-24, 2),
    ("fm", "Espoo mast 94.0", 94.0, 60.178, 24.640, 1e-21, 1e-23, 2),
    ("ofdm", "DVB-T Espoo", 562.0, 60.178, 24.641, 2e-23, 1e-25, 1),
    ("ofdm", "DVB-T Santahamina", 658.0, 60.148, 25.050, 2e-23, 2e-25, 1),
    ("gps", "PRN 7", 1575.42, None, None, 1e-23, 1e-25, 3),
    ("gps", "PRN 19", 1575.42, None, None, 1e-23, 1e-25, 3),
    ("iridium", "IRIDIUM 109", 1626.2708, None, None, 1e-21, 1e-23, 1),
    ("other", "time signal 77.5", 0.0775, 60.31, 24.97, 1e-23, 1e-27, 1),
]


def main() -> None:
    rng = np.random.default_rng(4)
    with tempfile.TemporaryDirectory() as folder, database(Path(folder), public_read=True) as running:
        for kind, name, carrier_mhz, latitude, longitude, h0, h_minus_2, receivers in SOURCES:
            place = None if latitude is None else (latitude, longitude)
            bias_s = float(rng.normal(0.0, 2e-6))
            for k in range(receivers):
                one = body(name, kind, carrier_hz=1e6 * carrier_mhz, place_deg=place, noise=(h0, h_minus_2),
                           receiver=("roof 1", "car 3", "harbour")[k], bias_s=bias_s,
                           age_s=float(rng.uniform(100.0, 7000.0)))  # fmt: skip
                one["clock"]["covariance"] = [[1e-16, 0.0], [0.0, 1e-20]]
                running.store.contribute(Characterization.model_validate(one), Contributor(f"r{k}")).result()
        options = webdriver.ChromeOptions()
        options.binary_location = str(shutil.which("chromium"))
        for argument in ("--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--hide-scrollbars"):
            options.add_argument(argument)
        driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(shutil.which("chromedriver")))
        try:
            metrics = {"width": 1560, "height": 900, "deviceScaleFactor": 1, "mobile": False}
            driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
            driver.get(running.url)
            time.sleep(1.5)
            row = driver.find_element(By.XPATH, "//tbody//button[text()='PN 168 Kallio']")
            driver.execute_script("arguments[0].click()", row)
            time.sleep(1.5)
            driver.save_screenshot(str(ROOT / "docs/images/signal_database.png"))
        finally:
            driver.quit()


if __name__ == "__main__":
    main()
