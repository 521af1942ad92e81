"""Figures: they can be drawn for every outcome, and show what they are given."""

import numpy as np
import pytest

import soopnav_cpp as sn

pytest.importorskip("matplotlib")
pytestmark = pytest.mark.unit

RATE = 1.92e6
C = 299_792_458.0
NODES = np.array([[150.0, 620.0, 35.0], [900.0, 240.0, 42.0], [520.0, -780.0, 28.0], [-640.0, -510.0, 31.0]])


def texts(axes):
    return [text.get_text() for text in axes.texts]


@pytest.mark.parametrize(
    "changes", [{}, {"duplex": sn.lte.Duplex.TDD}, {"cp": sn.lte.CyclicPrefix.EXTENDED}], ids=["FDD", "TDD", "extended"]
)
def test_the_mark_of_a_cell_is_on_its_correlation(changes):
    cell = sn.lte.CellParameters(cell_id=200, delay_s=3.3e-3, cfo_hz=800.0, **changes)
    iq = sn.lte.synthesize(cell, RATE, 115_200, snr_db=15.0, seed=1)
    found = sn.lte.search(iq, RATE, max_cfo_hz=5e3)
    assert [c.cell_id for c in found] == [200]
    figure = sn.plotting.scan(iq, RATE, found, [sn.lte.time_of_arrival(iq, RATE, found[0])], title="x")
    correlation = figure.axes[0]
    lines = correlation.get_lines()
    peaks = [line.get_ydata().max() for line in lines[:3]]
    assert int(np.argmax(peaks)) == 200 % 3
    mark = lines[3]
    assert mark.get_ydata()[0] == pytest.approx(max(peaks))
    strongest = lines[200 % 3]
    assert mark.get_xdata()[0] == pytest.approx(strongest.get_xdata()[strongest.get_ydata().argmax()], abs=2e-3)
    assert "cell 200" in texts(correlation)


def test_axes_are_labelled_with_units(tmp_path):
    iq = sn.lte.synthesize(sn.lte.CellParameters(cell_id=7, n_rb=15), 3.84e6, 153_600, snr_db=15.0)
    found = sn.lte.search(iq, 3.84e6, max_cfo_hz=5e3)
    arrivals = [sn.lte.time_of_arrival(iq, 3.84e6, c) for c in found]
    path = tmp_path / "x.png"
    figure = sn.plotting.scan(iq, 3.84e6, found, arrivals, center_frequency_hz=806e6, path=path)
    assert path.read_bytes().startswith(b"\x89PNG")
    for axes in figure.axes:
        assert "[" in axes.get_xlabel()
        assert axes.get_title(loc="left")
    spectrum = figure.axes[1]
    assert spectrum.get_xlim()[0] == pytest.approx(804.08, abs=0.01)
    assert "15 RB" in texts(spectrum)


@pytest.mark.parametrize("samples", [9_984, 20_000, 400_000])
def test_nothing_found(samples, tmp_path):
    noise = sn.simulation.add_awgn(np.zeros(samples, np.complex64), 1.0, seed=1)
    figure = sn.plotting.scan(noise, RATE, [], [], path=tmp_path / "x.svg")
    assert "no cell" in texts(figure.axes[2])
    assert (tmp_path / "x.svg").read_text().startswith("<?xml")


def test_silence_and_a_cell_without_arrival():
    known = sn.lte.Detection(cell_id=3, frame_start_s=0.0)
    figure = sn.plotting.scan(np.zeros(20_000, np.complex64), RATE, [known], [None])
    assert "cell 3" in texts(figure.axes[0])


def fix(toa_error_m=0.0, nodes=NODES, **options):
    toas = np.linalg.norm(nodes - [180.0, -120.0, 1.5], axis=1) / C
    toas[-1] += toa_error_m / C
    return sn.navigation.position_fix(
        nodes, toas, np.full(len(nodes), 3e-9), **({"height_m": 1.5, "dimensions": 2} | options)
    )


def test_a_position_among_its_nodes(tmp_path):
    five = np.vstack([NODES, [[-760.0, 410.0, 45.0]]])
    names = [f"cell {i} (x)" for i in range(5)]
    result = fix(60.0, five)
    figure = sn.plotting.position_map(result, five, names, title="here", path=tmp_path / "x.png")
    chart, error, residuals = figure.axes
    assert "cell 4\n(x)\n(rejected)" in texts(chart)
    assert "cell 0\n(x)" in texts(chart)
    low, high = chart.get_xlim()
    assert low < five[:, 0].min() < five[:, 0].max() < high
    assert abs(chart.get_aspect() - 1.0) < 1e-12
    assert "[m]" in chart.get_xlabel()
    assert "[m]" in error.get_xlabel()
    assert [t.get_text() for t in residuals.get_yticklabels()] == [f"cell {i}" for i in range(5)]


def test_every_outcome_can_be_drawn():
    three = NODES[:3]
    for result, nodes in ((fix(), NODES), (fix(nodes=three), three), (fix(dimensions=3, height_m=None), NODES)):
        figure = sn.plotting.position_map(result, nodes, [str(i) for i in range(len(nodes))])
        figure.canvas.draw()


def test_points_of_an_ellipse_lie_on_it():
    covariance = np.array([[9.0, 2.0], [2.0, 4.0]])
    points = sn.plotting.ellipse_points(sn.estimation.error_ellipse(covariance))
    np.testing.assert_allclose(np.einsum("ni,ij,nj->n", points, np.linalg.inv(covariance), points), 1.0, rtol=1e-9)
