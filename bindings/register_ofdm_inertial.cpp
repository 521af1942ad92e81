#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "array.hpp"
#include "register.hpp"
#include "soopnav/navigation/ofdm_inertial_navigator.hpp"
#include "soopnav/navigation/ofdm_inertial_run.hpp"

namespace soopnav::python {

namespace {

using navigation::OfdmInertialNavigator;
using navigation::OfdmInertialOptions;
using navigation::RangeChange;
using navigation::RangeChangeReport;

std::unique_ptr<OfdmInertialNavigator> make_navigator(
    const TableBase& transmitters_m, const TableBase& starts, double gyro_sigma_radps, double accelerometer_sigma_mps2,
    double ambiguity_m, double gate_m, double gate_sigmas, std::optional<double> gate_probability,
    std::optional<std::pair<double, double>> clock_psd, double clock_drift_sigma_mps,
    std::optional<std::pair<double, double>> multipath, bool reference_receiver, bool literal_transition,
    std::pair<double, double> unmodelled, double yaw_rate_range_radps, double specific_force_range_mps2) {
  if (transmitters_m.rows() > 0 && transmitters_m.columns() != 2) {
    throw std::invalid_argument("transmitters_m: rows of two numbers expected, got " +
                                std::to_string(transmitters_m.columns()));
  }
  if (starts.columns() != 8) throw std::invalid_argument("starts: rows of eight numbers expected");
  std::vector<Eigen::Vector2d> sources;
  for (std::size_t i = 0; i < transmitters_m.rows(); ++i) {
    sources.emplace_back(transmitters_m.row(i)[0], transmitters_m.row(i)[1]);
  }
  std::vector<navigation::PlanarStart> from;
  for (std::size_t i = 0; i < starts.rows(); ++i) {
    const auto s = starts.row(i);
    from.push_back({s[0], {s[1], s[2]}, {s[3], s[4]}, s[5], s[6], s[7]});
  }
  OfdmInertialOptions options;
  options.imu = {gyro_sigma_radps, accelerometer_sigma_mps2};
  options.ambiguity_m = ambiguity_m;
  if (gate_probability) options.gate = Gate::probability(*gate_probability, 1);
  options.gate.residual = gate_m;
  options.gate.residual_sigmas = gate_sigmas;
  if (clock_psd) options.transmitter_clock = clock::ClockNoise{clock_psd->first, clock_psd->second};
  options.clock_drift_sigma_mps = clock_drift_sigma_mps;
  if (multipath) options.multipath = navigation::MultipathBias{multipath->first, multipath->second};
  options.reference_receiver = reference_receiver;
  options.coupling = literal_transition ? navigation::HeadingCoupling::kLiteral : navigation::HeadingCoupling::kFull;
  options.unmodelled = {unmodelled.first, unmodelled.second};
  options.yaw_rate_range_radps = yaw_rate_range_radps;
  options.specific_force_range_mps2 = specific_force_range_mps2;
  return std::make_unique<OfdmInertialNavigator>(sources, from, options);
}

// Columns of the reports: status, innovation, its variance, NIS.
py::dict columns(std::span<const RangeChangeReport> reports, const std::vector<py::ssize_t>& shape) {
  const std::size_t n = reports.size();
  std::vector<std::uint8_t> status(n);
  std::vector<double> innovation(n);
  std::vector<double> variance(n);
  std::vector<double> nis(n);
  for (std::size_t i = 0; i < n; ++i) {
    status[i] = static_cast<std::uint8_t>(reports[i].status);
    innovation[i] = reports[i].innovation_m;
    variance[i] = reports[i].variance_m2;
    nis[i] = reports[i].nis;
  }
  py::dict out;
  out["status"] = to_array(std::move(status), shape);
  out["innovation_m"] = to_array(std::move(innovation), shape);
  out["variance_m2"] = to_array(std::move(variance), shape);
  out["nis"] = to_array(std::move(nis), shape);
  return out;
}

py::dict run(const OfdmInertialNavigator& start, double start_s, const RealArrayBase& imu_t_s,
             const NumbersBase& yaw_rate_radps, const NumbersBase& specific_force_b_mps2, double imu_period_s,
             const RealArrayBase& epoch_t_s, const NumbersBase& range_change_m, const NumbersBase& range_sigma_m,
             const NumbersBase& reference_range_change_m, const NumbersBase& reference_sigma_m,
             std::size_t record_every, double max_gap_s, const py::object& ask) {
  const navigation::OfdmInertialData data{.start_s = start_s,
                                          .imu_t_s = imu_t_s.span(),
                                          .yaw_rate_radps = yaw_rate_radps.span(),
                                          .specific_force_b_mps2 = specific_force_b_mps2.span(),
                                          .imu_period_s = imu_period_s,
                                          .epoch_t_s = epoch_t_s.span(),
                                          .range_change_m = range_change_m.span(),
                                          .range_sigma_m = range_sigma_m.span(),
                                          .reference_range_change_m = reference_range_change_m.span(),
                                          .reference_sigma_m = reference_sigma_m.span(),
                                          .record_every = record_every,
                                          .max_gap_s = max_gap_s};
  navigation::RangeTiming timing;
  if (!ask.is_none()) {
    timing = [&ask](std::size_t epoch, const RangeChange& predicted) {
      const py::gil_scoped_acquire acquire;
      const py::object answer =
          ask(epoch, predicted.receiver, predicted.transmitter, predicted.range_change_m, predicted.sigma_m);
      const auto [value, sigma] = answer.cast<std::pair<double, double>>();
      return RangeChange{predicted.receiver, predicted.transmitter, value, sigma};
    };
  }
  navigation::OfdmInertialHistory history;
  OfdmInertialNavigator navigator = start;  // before the lock is given away: others may move `start`
  {
    const py::gil_scoped_release release;
    history = navigation::run(navigator, data, timing);
  }
  const auto rows = static_cast<py::ssize_t>(history.t_s.size());
  const auto dim = static_cast<py::ssize_t>(history.dim);
  const auto epochs = static_cast<py::ssize_t>(epoch_t_s.size());
  const std::vector<py::ssize_t> links{epochs, start.receivers(), start.transmitters()};
  py::dict out = columns(history.reports, links);
  out["range_change_m"] = to_array(std::move(history.range_change_m), links);
  out["t_s"] = to_array(std::move(history.t_s));
  out["state"] = to_array(std::move(history.state), {rows, dim});
  out["covariance"] = to_array(std::move(history.covariance), {rows, dim, dim});
  std::vector<std::uint8_t> reference;
  for (const UpdateStatus status : history.reference) reference.push_back(static_cast<std::uint8_t>(status));
  const py::ssize_t references = reference.empty() ? 0 : epochs;
  out["reference_status"] = to_array(std::move(reference), {references, start.transmitters()});
  out["run_status"] = static_cast<int>(history.status);
  out["imu_used"] = history.imu.used;
  out["imu_not_after"] = history.imu.not_after;
  out["imu_not_finite"] = history.imu.not_finite;
  out["imu_saturated"] = history.imu.saturated;
  out["imu_gaps"] = history.imu.gaps;
  out["imu_gap_s"] = history.imu.gap_s;
  return out;
}

}  // namespace

void register_ofdm_inertial(py::module_& m) {
  py::class_<OfdmInertialNavigator>(m, "OfdmInertialNavigator",
                                    "Planar inertial navigation aided by OFDM block boundaries; the engine of "
                                    "soopnav_cpp.navigation.OfdmInertialNavigator.")
      .def(py::init([](const Table<"transmitters_m">& transmitters_m, const Table<"starts">& starts,
                       double gyro_sigma_radps, double accelerometer_sigma_mps2, double ambiguity_m, double gate_m,
                       double gate_sigmas, std::optional<double> gate_probability,
                       std::optional<std::pair<double, double>> clock_psd, double clock_drift_sigma_mps,
                       std::optional<std::pair<double, double>> multipath, bool reference_receiver,
                       bool literal_transition, std::pair<double, double> unmodelled, double yaw_rate_range_radps,
                       double specific_force_range_mps2) {
             return make_navigator(transmitters_m, starts, gyro_sigma_radps, accelerometer_sigma_mps2, ambiguity_m,
                                   gate_m, gate_sigmas, gate_probability, clock_psd, clock_drift_sigma_mps, multipath,
                                   reference_receiver, literal_transition, unmodelled, yaw_rate_range_radps,
                                   specific_force_range_mps2);
           }),
           py::arg("transmitters_m"), py::arg("starts"), py::kw_only(), py::arg("gyro_sigma_radps"),
           py::arg("accelerometer_sigma_mps2"), py::arg("ambiguity_m"), py::arg("gate_m"), py::arg("gate_sigmas"),
           py::arg("gate_probability"), py::arg("clock_psd"), py::arg("clock_drift_sigma_mps"), py::arg("multipath"),
           py::arg("reference_receiver"), py::arg("literal_transition"), py::arg("unmodelled"),
           py::arg("yaw_rate_range_radps"), py::arg("specific_force_range_mps2"))
      .def("__copy__", [](const OfdmInertialNavigator& self) { return std::make_unique<OfdmInertialNavigator>(self); })
      .def_property_readonly(
          "dim", [](const OfdmInertialNavigator& self) { return self.state().dim(); }, "Number of states.")
      .def_property_readonly(
          "names",
          [](const OfdmInertialNavigator& self) {
            std::vector<std::string> names;
            for (int i = 0; i < self.state().dim(); ++i) names.push_back(self.state().component_name(i));
            return names;
          },
          "What each state is.")
      .def_property_readonly(
          "state",
          [](const OfdmInertialNavigator& self) {
            const auto x = self.state().x();
            return to_array(std::vector<double>(x.data(), x.data() + x.size()));
          },
          "The states; shape (n,).")
      .def_property_readonly(
          "covariance",
          [](const OfdmInertialNavigator& self) {
            const Eigen::MatrixXd P = self.covariance();  // symmetric: the order of its axes does not matter
            return to_array(std::vector<double>(P.data(), P.data() + P.size()), {P.rows(), P.cols()});
          },
          "Of the states; shape (n, n).")
      .def("receiver_at", &OfdmInertialNavigator::receiver_at, py::arg("receiver"), "First state of a receiver, or -1.")
      .def("clock_at", &OfdmInertialNavigator::clock_at, py::arg("transmitter"), "State of its clock bias, or -1.")
      .def("multipath_at", &OfdmInertialNavigator::multipath_at, py::arg("receiver"), py::arg("transmitter"),
           "State of the link's bias, or -1.")
      .def(
          "predict",
          [](OfdmInertialNavigator& self, int receiver, double yaw_rate_radps, double forward_mps2, double left_mps2,
             double dt_s) {
            return static_cast<int>(self.predict(receiver, {yaw_rate_radps, {forward_mps2, left_mps2}}, dt_s));
          },
          py::arg("receiver"), py::arg("yaw_rate_radps"), py::arg("forward_mps2"), py::arg("left_mps2"),
          py::arg("dt_s"), "Carries a receiver through one sample; an UpdateStatus' number.")
      .def(
          "coast",
          [](OfdmInertialNavigator& self, int receiver, double dt_s) {
            return static_cast<int>(self.coast(receiver, dt_s));
          },
          py::arg("receiver"), py::arg("dt_s"), "Carries a receiver without a sample.")
      .def(
          "predict_links",
          [](OfdmInertialNavigator& self, double dt_s) { return static_cast<int>(self.predict_links(dt_s)); },
          py::arg("dt_s"), "Carries clocks and multipath biases.")
      .def(
          "update",
          [](OfdmInertialNavigator& self, const std::vector<int>& receiver, const std::vector<int>& transmitter,
             const RealArray<"range_change_m">& range_change_m, const RealArray<"range_sigma_m">& range_sigma_m) {
            const std::size_t n = receiver.size();
            if (transmitter.size() != n || range_change_m.size() != n || range_sigma_m.size() != n) {
              throw std::invalid_argument("range_change_m: one number for each receiver and transmitter expected");
            }
            std::vector<RangeChange> rows(n);
            for (std::size_t i = 0; i < n; ++i) {
              rows[i] = {receiver[i], transmitter[i], range_change_m[i], range_sigma_m[i]};
            }
            std::vector<RangeChangeReport> reports(n);
            self.update(rows, reports);
            return columns(reports, {static_cast<py::ssize_t>(n)});
          },
          py::arg("receiver"), py::arg("transmitter"), py::arg("range_change_m"), py::arg("range_sigma_m"),
          "Takes the boundaries of one epoch.")
      .def(
          "run",
          [](const OfdmInertialNavigator& self, double start_s, const RealArray<"imu_t_s">& imu_t_s,
             const Numbers<"yaw_rate_radps">& yaw_rate_radps, const Numbers<"specific_force_b_mps2">& force,
             double imu_period_s, const RealArray<"epoch_t_s">& epoch_t_s,
             const Numbers<"range_change_m">& range_change_m, const Numbers<"range_sigma_m">& range_sigma_m,
             const Numbers<"reference_range_change_m">& reference_range_change_m,
             const Numbers<"reference_sigma_m">& reference_sigma_m, std::size_t record_every, double max_gap_s,
             const py::object& timing) {
            return run(self, start_s, imu_t_s, yaw_rate_radps, force, imu_period_s, epoch_t_s, range_change_m,
                       range_sigma_m, reference_range_change_m, reference_sigma_m, record_every, max_gap_s, timing);
          },
          py::arg("start_s"), py::arg("imu_t_s"), py::arg("yaw_rate_radps"), py::arg("specific_force_b_mps2"),
          py::arg("imu_period_s"), py::arg("epoch_t_s"), py::arg("range_change_m"), py::arg("range_sigma_m"),
          py::arg("reference_range_change_m"), py::arg("reference_sigma_m"), py::arg("record_every"),
          py::arg("max_gap_s"), py::arg("timing"), "A whole run, on a copy.");
}

}  // namespace soopnav::python
