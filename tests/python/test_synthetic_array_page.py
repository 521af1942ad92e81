"""docs/synthetic_array.md: its Python runs as it stands, its links lead somewhere, its bearings enter the locator."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import soopnav_cpp as sn

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/synthetic_array.md").read_text(encoding="utf-8")


@pytest.mark.example
def test_page_runs_and_its_bearings_turn_the_locator() -> None:
    first, second, *more = re.findall(r"^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    assert not more
    scope: dict[str, Any] = {}
    exec(compile(first, "docs/synthetic_array.md", "exec"), scope)
    found = scope["found"]
    error = np.angle(np.exp(1j * (found.bearing_rad - np.array([0.4, 1.9, -2.6]))))
    assert (np.abs(error) < 5.0 * found.sigma_rad).all()
    assert np.rad2deg(found.sigma_rad).max() < 1.5

    # A handset at the origin, its first axis along x: nodes where the page's bearings say, heading unknown.
    nodes = 40.0 * np.column_stack((np.cos([0.4, 1.9, -2.6]), np.sin([0.4, 1.9, -2.6])))
    locator = sn.navigation.HandsetLocator(
        nodes, start_sigma_m=1.0, start_heading_sigma_rad=3.2, clock_sigma_m=50.0, nlos=False, particles=600, seed=1
    )
    locator.update_ranges(np.full(3, 50.0), 1.0, 0.0)
    before = locator.estimate().heading_sigma_rad
    scope |= {"locator": locator, "t_s": 0.1}
    exec(compile(second, "docs/synthetic_array.md", "exec"), scope)
    after = locator.estimate()
    assert before > 1.0
    assert after.heading_sigma_rad < 0.15
    assert abs(np.angle(np.exp(1j * after.heading_rad))) < 0.2


@pytest.mark.example
def test_links_and_names() -> None:
    targets = re.findall(r"\]\(([^)#:]+)[^)]*\)", PAGE)
    assert len(targets) >= 2
    for target in targets:
        assert (ROOT / "docs" / target).is_file(), target
    for name in re.findall(r"`(aperture_spectrum|aperture_directions|check_bearings|synthetic_aperture_crlb)", PAGE):
        assert hasattr(sn.array, name)
    assert (ROOT / "cpp/doc/synthetic_aperture.md").is_file()
