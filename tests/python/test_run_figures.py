"""Figures of navigation runs: they show the numbers that they are given, and refuse what lacks them."""

import math

import numpy as np
import pytest

import soopnav_cpp as sn
from soopnav_cpp.scenarios import SystemRun, Truth, Updates

pytest.importorskip("matplotlib")
pytestmark = pytest.mark.unit


def test_errors_are_drawn_in_their_bands(tmp_path):
    rng = np.random.default_rng(2)
    truth = rng.normal(size=(50, 2))
    error = rng.normal(size=(50, 2))
    given = {
        "t_s": np.arange(50.0),
        "position_m": truth + error,
        "position_covariance_m2": np.tile(np.diag([1.0, 4.0]), (50, 1, 1)),
    }
    figure = sn.plotting.errors(SystemRun(**given), truth, path=tmp_path / "x.png")
    assert (tmp_path / "x.png").read_bytes().startswith(b"\x89PNG")
    for k, axes in enumerate(figure.axes):
        drawn = [line.get_ydata() for line in axes.get_lines()]
        np.testing.assert_allclose(drawn[2], error[:, k])
        np.testing.assert_array_equal(drawn[1], np.full(50, (1.0, 2.0)[k]))
        assert f"{100 * np.mean(np.abs(error[:, k]) <= (1.0, 2.0)[k]):.1f} % inside" in axes.get_title(loc="left")
    same = sn.plotting.errors(SystemRun(**given, truth=Truth(position_m=truth)))
    np.testing.assert_array_equal(same.axes[0].get_lines()[2].get_ydata(), figure.axes[0].get_lines()[2].get_ydata())
    with pytest.raises(ValueError, match="truth: needed, for the run has none"):
        sn.plotting.errors(SystemRun(**given))
    with pytest.raises(ValueError, match=r"truth: expected shape \(50, 2\)"):
        sn.plotting.errors(SystemRun(**given), truth[:3])
    with pytest.raises(ValueError, match=r"run: positions expected in run\.position_m"):
        sn.plotting.errors(type("Bare", (), {"t_s": [0.0]})(), truth)


def test_errors_of_the_state_are_drawn_in_their_units():
    n = 10
    given = {
        "t_s": np.arange(n),
        "position_m": np.zeros((n, 2)),
        "position_covariance_m2": np.zeros((n, 2, 2)),
        "state_names": ("x_m", "vx_mps", "heading_rad"),
        "state": np.tile([1.0, 2.0, math.pi - 0.1], (n, 1)),
        "covariance": np.tile(np.diag([4.0, 1.0, 0.01]), (n, 1, 1)),
    }
    truth = Truth(position_m=np.zeros((n, 2)), state=np.tile([0.0, 0.0, -math.pi + 0.1], (n, 1)))
    figure = sn.plotting.state_errors(SystemRun(**given, truth=truth))
    assert [axes.get_ylabel() for axes in figure.axes] == ["[m]", "[m/s]", "[deg]"]
    assert [axes.get_title(loc="left") for axes in figure.axes] == [
        "x: RMS 1, 100 % inside", "vx: RMS 2, 0 % inside", "heading: RMS 11.5, 0 % inside",
    ]  # fmt: skip
    assert figure.axes[2].get_lines()[2].get_ydata() == pytest.approx(np.full(n, math.degrees(-0.2)))
    with pytest.raises(ValueError, match=r"run: state, covariance and truth\.state needed"):
        sn.plotting.state_errors(SystemRun(**given))


@pytest.mark.parametrize(("sigma_m", "label"), [(20.0, "95 % ellipse"), (0.5, "95 % ellipse, 20 × enlarged")])
def test_small_ellipses_are_enlarged_and_say_so(sigma_m, label):
    n = 40
    run_ = SystemRun(
        t_s=np.arange(n),
        position_m=np.column_stack([np.linspace(0.0, 1000.0, n), np.zeros(n)]),
        position_covariance_m2=np.tile(sigma_m**2 * np.eye(2), (n, 1, 1)),
        sources={"far": [9000.0, 0.0]},
    )
    figure = sn.plotting.trajectory(run_)
    assert len(figure.axes) == 2  # the source is far: a map of its own
    patch = next(p for p in figure.axes[0].patches if p.get_label() == label)
    reach = np.ptp(patch.get_xy()[:, 0]) / 2.0
    scale = 1.0 if label.endswith("ellipse") else 20.0
    assert reach == pytest.approx(scale * sigma_m * math.sqrt(5.991), rel=1e-3)
    assert "far" in [text.get_text() for text in figure.axes[1].texts]


def test_rms_is_logarithmic_when_curves_are_far_apart():
    t = np.arange(10.0)
    near = sn.plotting.rms(t, {"aided": np.ones(10), "INS alone": 3.0 * np.ones(10)}, sigma_m=np.ones(10), runs=5)
    far = sn.plotting.rms(t, {"aided": np.ones(10), "INS alone": 100.0 * np.ones(10)})
    assert (near.axes[0].get_yscale(), far.axes[0].get_yscale()) == ("linear", "log")
    assert "5 runs" in near.axes[0].get_title(loc="left")


def test_consistency_counts_what_is_inside():
    t = np.arange(100.0)
    value = np.where(t < 25, 50.0, 2.0)
    figure = sn.plotting.consistency((t, value, 2), (t, np.ones(100)), runs=10)
    assert "75 % inside" in figure.axes[0].get_title(loc="left")
    assert "100 accepted" in figure.axes[1].get_title(loc="left")
    assert "0 accepted" in sn.plotting.consistency(None, ([], [])).axes[0].get_title(loc="left")
    with pytest.raises(ValueError, match="nees, nis: at least one expected"):
        sn.plotting.consistency()


def test_innovations_tell_what_was_refused():
    given = Updates(
        t_s=np.arange(6.0),
        source=[0, 0, 0, 1, 1, 1],
        innovation=[1.0, -1.0, 900.0, 0.5, np.nan, 0.1],
        variance=np.ones(6),
        status=["accepted", "accepted", "gated", "accepted", "non_finite", "accepted"],
        source_names=("A", "B"),
    )
    figure = sn.plotting.innovations(given)
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert titles == ["A: 3 measured, 1 refused", "B: 2 measured, 0 refused"]
    marks = {line.get_label(): line for line in figure.axes[0].get_lines()}
    beyond = marks["refused, further out"]
    assert beyond.get_xdata().tolist() == [2.0]
    assert 1.0 < beyond.get_ydata()[0] <= figure.axes[0].get_ylim()[1]  # at the edge, not 900 m away
    nothing = Updates(t_s=[], source=[], innovation=[], variance=[], status=[])
    assert "no measurement" in [text.get_text() for text in sn.plotting.innovations(nothing).axes[0].texts]


def test_a_trajectory_is_a_truth():
    """Errors of a run against what knows any time: the same as against its positions at the times of the run."""
    way = sn.simulation.PlanarTrajectory.continuous_turn(duration_s=20.0)
    imu = way.imu(50.0, gyro_sigma_radps=0.1, accelerometer_sigma_mps2=0.1, seed=1)
    run = sn.navigation.OfdmInertialNavigator([[1000.0, 1500.0]], sn.navigation.PlanarStart()).run(imu=imu)
    figure = sn.plotting.errors(run, way)
    for k, axes in enumerate(figure.axes):
        drawn = axes.get_lines()[2].get_ydata()
        np.testing.assert_array_equal(drawn, run.position_m[:, k] - way.at(run.t_s).position_m[:, k])
        assert np.abs(drawn).max() > 0.1


def test_maps_of_north_east_down_have_north_up():
    t = np.arange(5.0)
    north, east = 10.0 * t, -3.0 * t
    given = {
        "t_s": t,
        "position_m": np.column_stack([north, east, 0.0 * t]),
        "position_covariance_m2": np.tile(np.diag([1.0, 4.0, 9.0]), (5, 1, 1)),
        "axes": "ned",
        "sources": {"mast": [100.0, 7.0, -30.0]},
        "truth": Truth(position_m=np.column_stack([north + 1.0, east, 0.0 * t])),
    }
    figure = sn.plotting.trajectory(SystemRun(**given))
    lines = {line.get_label(): line.get_xydata() for line in figure.axes[0].get_lines()}
    np.testing.assert_array_equal(lines["estimate"], np.column_stack([east, north]))
    np.testing.assert_array_equal(lines["truth"], np.column_stack([east, north + 1.0]))
    assert figure.axes[0].get_ylabel() == "x (north) [m]"
    assert any(line.get_xydata().tolist() == [[7.0, 100.0]] for axes in figure.axes for line in axes.get_lines())
    titles = [axes.get_title(loc="left") for axes in sn.plotting.errors(SystemRun(**given)).axes]
    assert [title.split(":")[0] for title in titles] == ["north", "east", "down"]
