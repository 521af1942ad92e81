#include <pybind11/native_enum.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <cmath>
#include <cstdint>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "array.hpp"
#include "cooperative_options.hpp"
#include "register.hpp"
#include "soopnav/navigation/cooperative_group.hpp"
#include "soopnav/navigation/cooperative_inertial.hpp"
#include "soopnav/navigation/cooperative_manoeuvre.hpp"

namespace soopnav::python {

using navigation::CooperativeGroup;
using navigation::CooperativeTracker;
using navigation::GroupBurst;
using navigation::GroupRow;
using navigation::GroupStatus;
using navigation::InertialFilter;
using navigation::InertialPairEstimate;
using navigation::ManoeuvreFilter;

namespace {

// The engine of a tracker that was made with one.
template <class Engine>
Engine& engine_of(CooperativeTracker& tracker, const char* expected) {
  auto* const engine = dynamic_cast<Engine*>(&tracker.engine());
  if (engine == nullptr) throw std::invalid_argument(std::string("tracker: one with ") + expected + " expected");
  return *engine;
}

clock::ClockNoise sum_of_clocks(const navigation::CooperativeOptions& options) {
  return options.target_clock + options.anchor_clock;
}

CooperativeTracker make_manoeuvring(const py::list& orbits, const RealArray<"epoch_s">& epoch_s,
                                    const py::dict& options, const RealArray<"manoeuvres">& m) {
  if (m.size() != 7) throw py::value_error("manoeuvres: seven numbers expected");
  const auto given = pair_options(options);
  return {pair_beacons(orbits, epoch_s.span()), given,
          navigation::manoeuvre_filter({sum_of_clocks(given), m[0], m[1], m[2], m[3], m[4], m[5], m[6]})};
}

CooperativeTracker make_inertial(const py::list& orbits, const RealArray<"epoch_s">& epoch_s, const py::dict& options,
                                 const RealArray<"noise">& noise, const RealArray<"quaternion">& quaternion,
                                 const RealArray<"start">& start, const RealArray<"limits">& limits, int coning_samples,
                                 std::size_t waiting_samples, int smoother_steps) {
  if (noise.size() != 6) throw py::value_error("noise: six numbers expected");
  if (quaternion.size() != 4) throw py::value_error("quaternion: four numbers w, x, y, z expected");
  if (start.size() != 4) throw py::value_error("start: four numbers expected");
  if (limits.size() != 6) throw py::value_error("limits: six numbers expected");
  const auto given = pair_options(options);
  navigation::InertialPairOptions o;
  o.clock_noise = sum_of_clocks(given);
  o.noise = {noise[0], noise[1], noise[2], noise[3], noise[4], noise[5]};
  o.limits.period_s = limits[0];
  o.limits.gap_periods = limits[1];
  o.limits.gyro_range_radps = limits[2];
  o.limits.accelerometer_range_mps2 = limits[3];
  o.gap = {limits[4], limits[5]};
  o.coning_samples = coning_samples;
  o.q_n_b = Eigen::Quaterniond(quaternion[0], quaternion[1], quaternion[2], quaternion[3]);
  o.tilt_sigma_rad = start[0];
  o.heading_sigma_rad = start[1];
  o.gyro_bias_sigma_radps = start[2];
  o.accelerometer_bias_sigma_mps2 = start[3];
  o.waiting_samples = waiting_samples;
  o.smoother_steps = smoother_steps;
  return {pair_beacons(orbits, epoch_s.span()), given, navigation::inertial_filter(o)};
}

// Estimates one below the other: t_s, mean, quaternion, gyro and accelerometer biases, covariance.
py::tuple arrays_of_inertial(const std::vector<InertialPairEstimate>& all) {
  std::vector<double> t, mean, q, gyro, force, covariance;
  const auto put = [](std::vector<double>& out, const auto& values) {
    out.insert(out.end(), values.data(), values.data() + values.size());
  };
  for (const auto& one : all) {
    t.push_back(one.t_s);
    put(mean, one.mean);
    q.insert(q.end(), {one.q_e_b.w(), one.q_e_b.x(), one.q_e_b.y(), one.q_e_b.z()});
    put(gyro, one.gyro_bias);
    put(force, one.accelerometer_bias);
    put(covariance, one.covariance);
  }
  const auto n = static_cast<py::ssize_t>(all.size());
  return py::make_tuple(to_array(std::move(t)), to_array(std::move(mean), {n, 8}), to_array(std::move(q), {n, 4}),
                        to_array(std::move(gyro), {n, 3}), to_array(std::move(force), {n, 3}),
                        to_array(std::move(covariance), {n, 17, 17}));
}

py::array_t<std::uint8_t> add_samples(CooperativeTracker& tracker, const RealArray<"t_s">& t_s,
                                      const Numbers<"delta_theta_b">& theta,
                                      const Numbers<"delta_velocity_b">& velocity) {
  InertialFilter& engine = engine_of<InertialFilter>(tracker, "an inertial unit");
  if (theta.span().size() != 3 * t_s.size() || velocity.span().size() != 3 * t_s.size()) {
    throw py::value_error("delta_theta_b, delta_velocity_b: three numbers for each of " + std::to_string(t_s.size()) +
                          " times expected");
  }
  std::vector<std::uint8_t> out(t_s.size());
  {
    const py::gil_scoped_release release;
    using Row = Eigen::Map<const Eigen::Vector3d>;
    for (std::size_t k = 0; k < out.size(); ++k) {
      out[k] = static_cast<std::uint8_t>(
          engine.add_imu(t_s[k], Row(theta.span().data() + 3 * k), Row(velocity.span().data() + 3 * k)));
    }
  }
  return to_array(std::move(out));
}

// ---- Several targets

CooperativeGroup make_group(const py::list& orbits, double start_s, std::pair<double, double> anchor_clock,
                            std::pair<double, double> target_clock, double horizontal_psd, double vertical_psd,
                            double gate_probability, int max_targets, bool shared_noise, bool shared_clock) {
  std::vector<geometry::SampledOrbit> beacons;
  for (auto& one : pair_beacons(orbits, {})) beacons.push_back(std::move(one.orbit));
  navigation::GroupOptions o;
  o.anchor_clock = {anchor_clock.first, anchor_clock.second};
  o.target_clock = {target_clock.first, target_clock.second};
  o.horizontal_psd_m2ps3 = horizontal_psd;
  o.vertical_psd_m2ps3 = vertical_psd;
  o.gate_probability = gate_probability;
  o.max_targets = max_targets;
  o.shared_anchor_noise = shared_noise;
  o.shared_anchor_clock = shared_clock;
  return {std::move(beacons), start_s, o};
}

std::int64_t join_group(CooperativeGroup& self, const RealArray<"mean">& mean, const Numbers<"covariance">& P) {
  if (mean.size() != 8) throw py::value_error("mean: eight numbers expected");
  P.require_axes({2}, "shape (8, 8)");
  if (P.span().size() != 64) throw py::value_error("covariance: shape (8, 8) expected");
  return self.join(Eigen::Map<const navigation::PairVector>(mean.span().data()),
                   Eigen::Map<const navigation::PairSquare>(P.span().data()));
}

py::tuple run_group(CooperativeGroup& self, const Numbers<"bursts">& bursts, const Numbers<"rows">& rows,
                    const std::vector<std::pair<std::int64_t, std::int64_t>>& pairs, bool covariance) {
  // Of a burst: t_s, beacon, carrier, anchor's p and v. Of a row: tdoa, fdoa, covariance's four, both SNR.
  constexpr std::size_t kBurst = 9;
  constexpr std::size_t kRow = 8;
  const std::size_t n = bursts.span().size() / kBurst;
  if (bursts.span().size() != n * kBurst || rows.span().size() != n * pairs.size() * kRow) {
    throw py::value_error("bursts, rows: sizes do not fit");
  }
  const std::size_t states = 8 * self.targets().size();
  std::vector<double> mean, P;
  std::vector<std::uint8_t> status(n * pairs.size());
  mean.reserve(n * states);
  if (covariance) P.reserve(n * states * states);
  {
    const py::gil_scoped_release release;
    std::vector<GroupRow> now(pairs.size());
    std::vector<GroupStatus> became(pairs.size());
    for (std::size_t k = 0; k < n; ++k) {
      const double* const b = bursts.span().data() + kBurst * k;
      const GroupBurst burst{
          b[0], std::abs(b[1]) < 1e9 ? static_cast<int>(b[1]) : -1, b[2], {b[3], b[4], b[5]}, {b[6], b[7], b[8]}};
      for (std::size_t i = 0; i < pairs.size(); ++i) {
        const double* const r = rows.span().data() + kRow * (k * pairs.size() + i);
        now[i] = {pairs[i].first, pairs[i].second, r[0], r[1], Eigen::Matrix2d::Zero(), r[6], r[7]};
        now[i].covariance << r[2], r[3], r[4], r[5];
      }
      static_cast<void>(self.update(burst, now, became));
      for (std::size_t i = 0; i < pairs.size(); ++i) {
        status[k * pairs.size() + i] = static_cast<std::uint8_t>(became[i]);
      }
      const Eigen::VectorXd x = self.mean();
      mean.insert(mean.end(), x.data(), x.data() + x.size());
      if (covariance) {
        const Eigen::MatrixXd all = self.covariance();
        P.insert(P.end(), all.data(), all.data() + all.size());
      }
    }
  }
  const auto count = static_cast<py::ssize_t>(n);
  const auto dim = static_cast<py::ssize_t>(states);
  return py::make_tuple(to_array(std::move(mean), {count, dim}),
                        to_array(std::move(P), {covariance ? count : 0, dim, dim}),
                        to_array(std::move(status), {count, static_cast<py::ssize_t>(pairs.size())}));
}

}  // namespace

void register_cooperative_group(py::module_& m) {
  m.def("manoeuvring_tracker", &make_manoeuvring, py::arg("beacons"), py::arg("epoch_s"), py::arg("options"),
        py::arg("manoeuvres"), "A CooperativeTracker over two modes of motion.");
  m.def("inertial_tracker", &make_inertial, py::arg("beacons"), py::arg("epoch_s"), py::arg("options"), py::kw_only(),
        py::arg("noise"), py::arg("quaternion"), py::arg("start"), py::arg("limits"), py::arg("coning_samples"),
        py::arg("waiting_samples"), py::arg("smoother_steps"), "A CooperativeTracker with an inertial unit.");
  m.def(
      "tracker_modes",
      [](CooperativeTracker& tracker) {
        const auto p = engine_of<ManoeuvreFilter>(tracker, "modes").probabilities();
        return std::pair{p[0], p[1]};
      },
      py::arg("tracker"), "Probabilities of being calm and of manoeuvring.");
  m.def("tracker_add_imu", &add_samples, py::arg("tracker"), py::arg("t_s"), py::arg("delta_theta_b"),
        py::arg("delta_velocity_b"), "Increments that end at the times; ImuStatus of each as numbers.");
  m.def(
      "tracker_inertial",
      [](CooperativeTracker& tracker) {
        return arrays_of_inertial({engine_of<InertialFilter>(tracker, "an inertial unit").estimate()});
      },
      py::arg("tracker"), "t_s, mean, quaternion, gyro and accelerometer biases, covariance; one row each.");
  m.def(
      "tracker_inertial_smooth",
      [](CooperativeTracker& tracker) {
        return arrays_of_inertial(engine_of<InertialFilter>(tracker, "an inertial unit").smooth());
      },
      py::arg("tracker"), "The same of all steps, smoothed; no rows when there was no room for them.");

  py::native_enum<GroupStatus>(m, "GroupStatus", "enum.Enum", "What became of a row of a burst.")
      .value("ACCEPTED", GroupStatus::kAccepted)
      .value("GATED", GroupStatus::kGated)
      .value("NON_FINITE", GroupStatus::kNonFinite)
      .value("UNKNOWN_TARGET", GroupStatus::kUnknownTarget)
      .value("UNKNOWN_BEACON", GroupStatus::kUnknownBeacon)
      .value("OUTSIDE_ORBIT", GroupStatus::kOutsideOrbit)
      .value("REFUSED", GroupStatus::kRefused)
      .value("TIME_NOT_ADVANCING", GroupStatus::kTimeNotAdvancing)
      .value("CLOCK_JUMP", GroupStatus::kClockJump)
      .value("BELOW_HORIZON", GroupStatus::kBelowHorizon)
      .finalize();
  m.def(
      "pair_noise_shares",
      [](double first, double second) {
        const auto shares = navigation::pair_noise_shares(first, second);
        return py::make_tuple(shares.first, shares.second, shares.both);
      },
      py::arg("first_snr"), py::arg("second_snr"), "Of the first recording, the second, and the product of both.");
  py::class_<CooperativeGroup>(m, "CooperativeGroup", "Several targets and one anchor.")
      .def(py::init(&make_group), py::arg("beacons"), py::arg("start_s"), py::kw_only(), py::arg("anchor_clock"),
           py::arg("target_clock"), py::arg("horizontal_psd_m2ps3"), py::arg("vertical_psd_m2ps3"),
           py::arg("gate_probability"), py::arg("max_targets"), py::arg("shared_anchor_noise"),
           py::arg("shared_anchor_clock"))
      .def("join", &join_group, py::arg("mean"), py::arg("covariance"), "The target's name, or -1.")
      .def("leave", &CooperativeGroup::leave, py::arg("target"), "False when it is not here.")
      .def("run", &run_group, py::arg("bursts"), py::arg("rows"), py::arg("pairs"), py::arg("covariance"),
           "Each burst in turn: means, covariances, statuses.")
      .def_property_readonly("time_s", &CooperativeGroup::time_s, "Of the state.")
      .def_property_readonly(
          "targets",
          [](const CooperativeGroup& self) {
            return std::vector<std::int64_t>(self.targets().begin(), self.targets().end());
          },
          "Names, in the order of joining.")
      .def_property_readonly(
          "mean",
          [](const CooperativeGroup& self) {
            const Eigen::VectorXd x = self.mean();
            return to_array(std::vector<double>(x.data(), x.data() + x.size()));
          },
          "Eight numbers for each target.")
      .def_property_readonly(
          "covariance",
          [](const CooperativeGroup& self) {
            const Eigen::MatrixXd P = self.covariance();
            return to_array(std::vector<double>(P.data(), P.data() + P.size()),
                            {static_cast<py::ssize_t>(P.rows()), static_cast<py::ssize_t>(P.cols())});
          },
          "Of all of them together.");
}

}  // namespace soopnav::python
