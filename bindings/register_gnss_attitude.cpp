#include <pybind11/native_enum.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "array.hpp"
#include "register.hpp"
#include "soopnav/geometry/wgs84.hpp"
#include "soopnav/gnss/attitude.hpp"
#include "soopnav/gnss/baseline.hpp"
#include "soopnav/gnss/lambda.hpp"
#include "soopnav/gnss/receiver_differences.hpp"

namespace soopnav::python {

namespace {

using gnss::AttitudeFilter;
using gnss::AttitudeFix;
using gnss::AttitudeModel;
using gnss::PathMatrix;
using PathMap = Eigen::Map<const PathMatrix>;

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

void require(bool met, const std::string& sentence) {
  if (!met) throw std::invalid_argument(sentence);
}

std::string text(std::initializer_list<std::size_t> shape) {
  std::string out = "(";
  for (const std::size_t n : shape) out += (out.size() > 1 ? ", " : "") + std::to_string(n);
  return out + ")";
}

void require_shape(const char* name, const NumbersBase& values, std::initializer_list<std::size_t> shape) {
  bool same = values.shape().size() == shape.size();
  std::size_t i = 0;
  for (const std::size_t n : shape) same = same && values.shape()[i++] == static_cast<py::ssize_t>(n);
  require(same, std::string(name) + ": shape " + text(shape) + " expected");
}

Eigen::Vector3d row_of(std::span<const double> values, std::size_t row) {
  return {values[3 * row], values[3 * row + 1], values[3 * row + 2]};
}

// Columns of results, filled row by row and handed over at the end.
struct Column {
  std::vector<double> values;
  std::vector<py::ssize_t> tail;
};

class Columns {
 public:
  explicit Columns(std::size_t rows) : rows_(static_cast<py::ssize_t>(rows)) {}
  void add(std::initializer_list<py::ssize_t> tail) {
    std::size_t size = static_cast<std::size_t>(rows_);
    for (const py::ssize_t n : tail) size *= static_cast<std::size_t>(n);
    columns_.push_back({std::vector<double>(size, kNan), tail});
  }
  [[nodiscard]] double* at(std::size_t column, std::size_t row) {
    auto& values = columns_[column].values;
    return values.data() + row * (values.size() / static_cast<std::size_t>(rows_));
  }
  template <class Matrix>
  void put(std::size_t column, std::size_t row, const Matrix& m) {
    for (Eigen::Index i = 0; i < m.size(); ++i) at(column, row)[i] = m.coeff(i / m.cols(), i % m.cols());
  }
  void put(std::size_t column, std::size_t row, double value) { *at(column, row) = value; }
  [[nodiscard]] py::tuple finish() {
    py::tuple out(columns_.size());
    for (std::size_t i = 0; i < columns_.size(); ++i) {
      std::vector<py::ssize_t> shape{rows_};
      shape.insert(shape.end(), columns_[i].tail.begin(), columns_[i].tail.end());
      out[i] = to_array(std::move(columns_[i].values), std::move(shape));
    }
    return out;
  }

 private:
  py::ssize_t rows_;
  std::vector<Column> columns_;
};

Eigen::MatrixXd square_of(const TableBase& table, const char* name) {
  require(table.rows() == table.columns(),
          std::string(name) + ": a square matrix expected, got shape " + text({table.rows(), table.columns()}));
  const auto n = static_cast<Eigen::Index>(table.rows());
  Eigen::MatrixXd out(n, n);
  for (Eigen::Index i = 0; i < n; ++i) {
    for (Eigen::Index j = 0; j < n; ++j)
      out(i, j) = table.row(static_cast<std::size_t>(i))[static_cast<std::size_t>(j)];
  }
  const double scale = out.size() > 0 ? out.cwiseAbs().maxCoeff() : 0.0;
  require(!(out.size() > 0) || !((out - out.transpose()).cwiseAbs().maxCoeff() > 1e-9 * scale),
          std::string(name) + ": a symmetric matrix expected");
  return out;
}

void require_solved(gnss::IntegerStatus status, const gnss::IntegerLeastSquares& ils, Eigen::Index n) {
  using gnss::IntegerStatus;
  switch (status) {
    case IntegerStatus::kSolved:
      return;
    case IntegerStatus::kNonFinite:
      throw std::invalid_argument("a, Q: finite numbers expected");
    case IntegerStatus::kNotPositiveDefinite:
      throw std::invalid_argument("Q: not positive definite");
    case IntegerStatus::kWrongSize:
      throw std::invalid_argument("Q: 1 ... " + std::to_string(gnss::kMaxAmbiguities) + " integers expected, got " +
                                  std::to_string(n));
    case IntegerStatus::kSearchLimit:
      throw std::invalid_argument("Q: too uncertain, the search was given up after " + std::to_string(ils.nodes()) +
                                  " partial vectors");
    case IntegerStatus::kTooLarge:
      throw std::invalid_argument("a, Q: integers of at most 2^52 expected, larger ones are not told apart");
  }
}

py::tuple lambda_ils(const RealArray<"a">& a, const Table<"Q">& covariance, int n_candidates) {
  const Eigen::MatrixXd Q = square_of(covariance, "Q");
  require(static_cast<Eigen::Index>(a.size()) == Q.rows(),
          "a: " + std::to_string(Q.rows()) + " numbers expected, as Q has rows, got " + std::to_string(a.size()));
  gnss::IntegerLeastSquares ils(n_candidates);
  const Eigen::Map<const Eigen::VectorXd> estimate(a.span().data(), Q.rows());
  gnss::IntegerStatus status{};
  {
    const py::gil_scoped_release release;
    status = ils.solve(estimate, Q);
  }
  require_solved(status, ils, Q.rows());
  std::vector<std::int64_t> fixed;
  std::vector<double> norms;
  for (int k = 0; k < ils.count(); ++k) {
    for (const double z : ils.candidate(k)) fixed.push_back(static_cast<std::int64_t>(z));
    norms.push_back(ils.squared_norm(k));
  }
  return py::make_tuple(to_array(std::move(fixed), {ils.count(), Q.rows()}), to_array(std::move(norms)));
}

double success_rate(const Table<"Q">& covariance) {
  const Eigen::MatrixXd Q = square_of(covariance, "Q");
  gnss::IntegerLeastSquares ils;
  require_solved(ils.decorrelate(Q), ils, Q.rows());
  return ils.success_rate();
}

gnss::BaselineOptions baseline_options(double wavelength_m, double phase_sigma_m, double code_phase_ratio,
                                       double mask_rad, double ratio, std::optional<double> length_m,
                                       const std::string& search, int candidates, double max_pitch_rad,
                                       int max_satellites) {
  require(search == "sphere" || search == "candidates",
          "search: expected one of 'sphere', 'candidates', got '" + search + "'");
  const gnss::BaselineOptions options{
      .wavelength_m = wavelength_m,
      .phase_sigma_m = phase_sigma_m,
      .code_phase_ratio = code_phase_ratio,
      .mask_rad = mask_rad,
      .ratio = ratio,
      .length_m = length_m,
      .search = search == "sphere" ? gnss::ConstraintSearch::kSphere : gnss::ConstraintSearch::kCandidates,
      .candidates = candidates,
      .max_pitch_rad = max_pitch_rad,
      .max_satellites = max_satellites};
  options.check();
  return options;
}

// (directions (n, s, 3), code_m (n, s), phase_cycles (n, s)), rover minus base.
py::tuple receiver_differences(const gnss::EphemerisTable& table, const RealArray<"base_position_m">& base,
                               double wavelength_m, const RealArray<"prn">& prn, const RealArray<"week">& week,
                               const Table<"time_of_week_s">& second, const Numbers<"code_m">& code,
                               const Numbers<"phase_cycles">& phase) {
  const std::size_t n = week.size(), s = prn.size();
  require(base.size() == 3, "base_position_m: three numbers expected");
  const auto place = geometry::ecef_to_geodetic({base[0], base[1], base[2]});
  require(place.has_value(), "base_position_m: an ECEF position is expected, at least 1e6 m from the centre");
  require(second.rows() == n && second.columns() == 2, "time_of_week_s: shape " + text({n, 2}) + " expected");
  require_shape("code_m", code, {2, n, s});
  require_shape("phase_cycles", phase, {2, n, s});
  const geometry::LocalFrame frame(*place);
  Columns out(n);
  const auto each = static_cast<py::ssize_t>(s);
  out.add({each, 3});
  out.add({each});
  out.add({each});
  {
    const py::gil_scoped_release release;
    for (std::size_t k = 0; k < n; ++k) {
      if (!(std::abs(week[k]) < 1e9)) continue;
      const auto number = static_cast<std::int64_t>(week[k]);
      const Epoch base_clock = gnss::gps_epoch(number, second.row(k)[0]);
      const Epoch rover_clock = gnss::gps_epoch(number, second.row(k)[1]);
      for (std::size_t i = 0; i < s; ++i) {
        if (!(std::abs(prn[i]) < 1e6)) continue;
        const std::size_t here = k * s + i, there = (n + k) * s + i;
        const auto satellite = gnss::difference_receivers(table, base_clock, rover_clock, frame,
                                                          {.prn = static_cast<int>(prn[i]),
                                                           .base_code_m = code.span()[here],
                                                           .rover_code_m = code.span()[there],
                                                           .base_phase_cycles = phase.span()[here],
                                                           .rover_phase_cycles = phase.span()[there]},
                                                          wavelength_m);
        if (!satellite) continue;
        for (Eigen::Index j = 0; j < 3; ++j)
          out.at(0, k)[3 * i + static_cast<std::size_t>(j)] = satellite->direction[j];
        out.at(1, k)[i] = satellite->code_m;
        out.at(2, k)[i] = satellite->phase_cycles;
      }
    }
  }
  return out.finish();
}

// Baselines of n epochs of s satellites, NaN where one is not seen; see `BaselineRun` in Python for the columns.
py::tuple baselines(const gnss::BaselineOptions& options, bool track, const Numbers<"directions">& directions,
                    const Numbers<"code_m">& code, const Numbers<"phase_cycles">& phase,
                    const Numbers<"lost_lock">& lost) {
  require(code.shape().size() == 2, "code_m: two axes expected, epochs and satellites");
  const auto n = static_cast<std::size_t>(code.shape()[0]), s = static_cast<std::size_t>(code.shape()[1]);
  require(s <= gnss::kMaxBaselineSatellites,
          "code_m: at most " + std::to_string(gnss::kMaxBaselineSatellites) + " satellites, got " + std::to_string(s));
  require_shape("directions", directions, {n, s, 3});
  require_shape("phase_cycles", phase, {n, s});
  require_shape("lost_lock", lost, {n, s});
  const auto each = static_cast<py::ssize_t>(s);
  Columns out(n);
  for (int i = 0; i < 8; ++i) out.add({});      // status, heading, sigma, pitch, sigma, ratio, success rate, satellites
  for (int i = 0; i < 3; ++i) out.add({3});     // baseline, best, float
  out.add({3, 3});                              // covariance
  for (int i = 0; i < 3; ++i) out.add({each});  // integers, residuals, slips
  {
    const py::gil_scoped_release release;
    gnss::BaselineSolver solver(options);
    gnss::BaselineTracker tracker(options);
    std::vector<gnss::BaselineSatellite> satellites;
    satellites.reserve(s);
    for (std::size_t k = 0; k < n; ++k) {
      satellites.clear();
      for (std::size_t i = 0; i < s; ++i) {
        const std::size_t at = k * s + i;
        satellites.push_back({.id = static_cast<int>(i),
                              .direction = row_of(directions.span(), at),
                              .code_m = code.span()[at],
                              .phase_cycles = phase.span()[at],
                              .lost_lock = lost.span()[at] != 0.0});
      }
      const gnss::BaselineFix fix = track ? tracker.step(satellites) : solver.solve(satellites);
      const std::array numbers{static_cast<double>(fix.status),
                               fix.heading_rad,
                               fix.heading_sigma_rad,
                               fix.pitch_rad,
                               fix.pitch_sigma_rad,
                               fix.ratio,
                               fix.success_rate,
                               static_cast<double>(fix.ids.size())};
      for (std::size_t j = 0; j < numbers.size(); ++j) out.put(j, k, numbers[j]);
      out.put(8, k, fix.baseline_m);
      out.put(9, k, fix.best_m);
      out.put(10, k, fix.float_m);
      out.put(11, k, fix.covariance_m2);
      for (std::size_t i = 0; i < fix.integers.size(); ++i) {
        const auto id = static_cast<std::size_t>(fix.ids[i]);
        out.at(12, k)[id] = fix.integers[i];
        out.at(13, k)[id] = fix.residuals_m[i];
      }
      for (std::size_t i = 0; i < s; ++i) out.at(14, k)[i] = 0.0;
      for (const int id : fix.slips) out.at(14, k)[id] = 1.0;
    }
  }
  return out.finish();
}

AttitudeModel attitude_model(const Table<"baselines_m">& rows, double sigma_m, bool common_clock,
                             bool shared_reference) {
  require(rows.columns() == 3, "baselines_m: shape (k, 3) expected, got " + text({rows.rows(), rows.columns()}));
  AttitudeModel model{
      .baselines_m = {}, .sigma_m = sigma_m, .common_clock = common_clock, .shared_reference = shared_reference};
  for (std::size_t i = 0; i < rows.rows(); ++i) model.baselines_m.push_back(row_of(rows.row(i), 0));
  model.check();
  return model;
}

// Epochs of (k, m) numbers under (m, 3) directions each, or one set of directions for all.
class Epochs {
 public:
  Epochs(const AttitudeModel& model, const NumbersBase& directions, const NumbersBase& path) : path_(path.span()) {
    require(path.shape().size() == 3, "path differences: three axes expected: epochs, baselines, satellites");
    n_ = static_cast<std::size_t>(path.shape()[0]);
    k_ = path.shape()[1];
    m_ = path.shape()[2];
    require(k_ == static_cast<Eigen::Index>(model.baselines_m.size()),
            "path differences: " + std::to_string(model.baselines_m.size()) + " baselines expected, got " +
                std::to_string(k_));
    require(m_ <= gnss::kMaxAttitudeSatellites, "path differences: at most " +
                                                    std::to_string(gnss::kMaxAttitudeSatellites) + " satellites, got " +
                                                    std::to_string(m_));
    moving_ = directions.shape().size() == 3;
    const auto m = static_cast<std::size_t>(m_);
    if (moving_) {
      require_shape("directions", directions, {n_, m, 3});
    } else {
      require_shape("directions", directions, {m, 3});
    }
    for (std::size_t i = 0; i < directions.span().size() / 3; ++i) all_.push_back(row_of(directions.span(), i));
  }
  [[nodiscard]] std::size_t size() const { return n_; }
  [[nodiscard]] Eigen::Index baselines() const { return k_; }
  [[nodiscard]] Eigen::Index satellites() const { return m_; }
  [[nodiscard]] std::span<const Eigen::Vector3d> directions(std::size_t epoch) const {
    const auto m = static_cast<std::size_t>(m_);
    return {all_.data() + (moving_ ? epoch * m : 0), m};
  }
  [[nodiscard]] PathMap path(std::size_t epoch) const {
    return {path_.data() + epoch * static_cast<std::size_t>(k_ * m_), k_, m_};
  }

 private:
  std::span<const double> path_;
  std::size_t n_ = 0;
  Eigen::Index k_ = 0, m_ = 0;
  bool moving_ = false;
  std::vector<Eigen::Vector3d> all_;
};

Eigen::Vector4d numbers_of(const Eigen::Quaterniond& q) { return {q.w(), q.x(), q.y(), q.z()}; }
Eigen::Vector3d numbers_of(const geometry::Euler& e) { return {e.yaw_rad, e.pitch_rad, e.roll_rad}; }

std::optional<Eigen::Quaterniond> start_of(const std::optional<RealArray<"start">>& start) {
  if (!start) return std::nullopt;
  require(start->size() == 4, "start: four numbers w, x, y, z expected");
  const Eigen::Quaterniond q((*start)[0], (*start)[1], (*start)[2], (*start)[3]);
  require(std::abs(q.norm() - 1.0) < 1e-6, "start: a unit quaternion expected");
  return q.normalized();
}

// Least squares of each epoch, or with a wavelength the acquisition from phases known up to whole cycles:
// status, chi-square, degrees of freedom, iterations, ratio, quaternion, Euler angles, both covariances, free axis.
py::tuple attitude_fixes(const AttitudeModel& model, const Numbers<"directions">& directions,
                         const Numbers<"path_differences_m">& path, const std::optional<RealArray<"start">>& start,
                         double wavelength_m, double min_ratio) {
  const Epochs epochs(model, directions, path);
  const auto from = start_of(start);
  Columns out(epochs.size());
  for (int i = 0; i < 5; ++i) out.add({});
  out.add({4});
  out.add({3});
  out.add({3, 3});
  out.add({3, 3});
  out.add({3});
  {
    const py::gil_scoped_release release;
    for (std::size_t i = 0; i < epochs.size(); ++i) {
      const AttitudeFix fix =
          wavelength_m > 0.0
              ? gnss::acquire_attitude(model, epochs.directions(i), epochs.path(i), wavelength_m, min_ratio)
              : gnss::attitude_fix(model, epochs.directions(i), epochs.path(i), from);
      const std::array numbers{static_cast<double>(fix.status), fix.chi_square,
                               static_cast<double>(fix.degrees_of_freedom), static_cast<double>(fix.iterations),
                               fix.ratio};
      for (std::size_t j = 0; j < numbers.size(); ++j) out.put(j, i, numbers[j]);
      out.put(5, i, numbers_of(fix.q_n_b));
      out.put(6, i, numbers_of(fix.euler));
      out.put(7, i, fix.covariance_rad2);
      out.put(8, i, fix.euler_covariance_rad2);
      out.put(9, i, fix.unobservable_b);
    }
  }
  return out.finish();
}

// The filter over epochs `steps_s` apart: status, NIS, rows, farthest fraction, quaternion, Euler angles, covariance.
// With a wavelength the numbers are phases in cycles, whose integers are resolved about each prediction.
py::tuple attitude_run(const AttitudeModel& model, bool euler, double rate_noise, double false_alarm,
                       const RealArray<"start">& start, const Table<"covariance_rad2">& covariance,
                       const RealArray<"steps_s">& steps, const Numbers<"directions">& directions,
                       const Numbers<"path_differences_m">& path, const std::optional<Table<"rates_radps">>& rates,
                       double wavelength_m) {
  using gnss::AttitudeParameters;
  const Epochs epochs(model, directions, path);
  const std::size_t n = epochs.size();
  require(steps.size() == n, "times: " + std::to_string(n) + " expected, as path differences have epochs, got " +
                                 std::to_string(steps.size()));
  require(!rates || (rates->rows() == n && rates->columns() == 3), "rates_radps: shape " + text({n, 3}) + " expected");
  const Eigen::MatrixXd P = square_of(covariance, "covariance_rad2");
  require(P.rows() == 3, "covariance_rad2: shape (3, 3) expected");
  AttitudeFilter filter(model,
                        {.parameters = euler ? AttitudeParameters::kEuler : AttitudeParameters::kQuaternion,
                         .rate_noise_rad_rts = rate_noise,
                         .false_alarm_probability = false_alarm},
                        *start_of(start), P);
  Columns out(n);
  for (int i = 0; i < 4; ++i) out.add({});
  out.add({4});
  out.add({3});
  out.add({3, 3});
  {
    const py::gil_scoped_release release;
    PathMatrix resolved(epochs.baselines(), epochs.satellites());
    for (std::size_t i = 0; i < n; ++i) {
      const Eigen::Vector3d rate = rates ? row_of(rates->row(i), 0) : Eigen::Vector3d::Zero();
      const auto moved = filter.predict(steps[i], rate);
      gnss::AttitudeUpdate report;
      report.status = moved;
      double farthest = kNan;
      if (moved == gnss::AttitudeStatus::kSolved) {
        if (wavelength_m > 0.0) {
          farthest = gnss::resolve_cycles(model, filter.attitude(), epochs.directions(i), epochs.path(i), wavelength_m,
                                          resolved);
          report = filter.update(epochs.directions(i), resolved);
        } else {
          report = filter.update(epochs.directions(i), epochs.path(i));
        }
      }
      const std::array numbers{static_cast<double>(report.status), report.nis, static_cast<double>(report.rows),
                               farthest};
      for (std::size_t j = 0; j < numbers.size(); ++j) out.put(j, i, numbers[j]);
      out.put(4, i, numbers_of(filter.attitude()));
      out.put(5, i, numbers_of(filter.euler()));
      out.put(6, i, filter.covariance_rad2());
    }
  }
  return out.finish();
}

py::tuple resolve_cycles(const AttitudeModel& model, const RealArray<"start">& quaternion,
                         const Numbers<"directions">& directions, const Numbers<"phase_cycles">& phase,
                         double wavelength_m) {
  const Epochs epochs(model, directions, phase);
  require(epochs.size() == 1, "phase_cycles: one epoch expected");
  Columns out(1);
  out.add({epochs.baselines(), epochs.satellites()});
  PathMatrix path(epochs.baselines(), epochs.satellites());
  const double farthest =
      gnss::resolve_cycles(model, *start_of(quaternion), epochs.directions(0), epochs.path(0), wavelength_m, path);
  out.put(0, 0, path);
  return py::make_tuple(out.finish()[0], farthest);
}

template <class Function>
py::array_t<double> each(std::span<const double> values, Function function) {
  std::vector<double> out;
  out.reserve(values.size());
  for (const double value : values) out.push_back(function(value));
  return to_array(std::move(out));
}

void register_attitude(py::module_& m) {
  using gnss::AttitudeStatus;
  py::native_enum<AttitudeStatus>(m, "AttitudeStatus", "enum.IntEnum", "How an attitude ended.")
      .value("SOLVED", AttitudeStatus::kSolved)
      .value("TOO_FEW_SATELLITES", AttitudeStatus::kTooFewSatellites)
      .value("SATELLITES_IN_PLANE", AttitudeStatus::kSatellitesInPlane)
      .value("UNOBSERVABLE", AttitudeStatus::kUnobservable)
      .value("NOT_CONVERGED", AttitudeStatus::kNotConverged)
      .value("NON_FINITE", AttitudeStatus::kNonFinite)
      .value("GATED", AttitudeStatus::kGated)
      .value("GIMBAL_LOCK", AttitudeStatus::kGimbalLock)
      .value("AMBIGUOUS", AttitudeStatus::kAmbiguous)
      .finalize();
  py::class_<AttitudeModel>(m, "AttitudeModel", "Antennas on a body and the noise of their path differences.")
      .def(py::init(&attitude_model), py::arg("baselines_m"), py::arg("sigma_m"), py::arg("common_clock"),
           py::arg("shared_reference"));
  m.def("attitude_fixes", &attitude_fixes, py::arg("model"), py::arg("directions"), py::arg("path_differences_m"),
        py::arg("start"), py::arg("wavelength_m"), py::arg("min_ratio"), "Attitudes epoch by epoch, column by column.");
  m.def("attitude_run", &attitude_run, py::arg("model"), py::arg("euler"), py::arg("rate_noise_rad_rts"),
        py::arg("false_alarm_probability"), py::arg("start"), py::arg("covariance_rad2"), py::arg("steps_s"),
        py::arg("directions"), py::arg("path_differences_m"), py::arg("rates_radps"), py::arg("wavelength_m"),
        "The attitude filter over many epochs, column by column.");
  m.def("resolve_cycles", &resolve_cycles, py::arg("model"), py::arg("quaternion"), py::arg("directions"),
        py::arg("phase_cycles"), py::arg("wavelength_m"), "(path differences, greatest distance in cycles).");
  m.def(
      "arrival_angle",
      [](const RealArray<"path_m">& path, double baseline_m) {
        return each(path.span(), [&](double x) { return gnss::arrival_angle(x, baseline_m); });
      },
      py::arg("path_m"), py::arg("baseline_m"), "Angles between a baseline and sources.");
  m.def(
      "arrival_angle_sigma",
      [](const RealArray<"angle_rad">& angle, double baseline_m, double sigma_m) {
        return each(angle.span(), [&](double x) { return gnss::arrival_angle_sigma(x, baseline_m, sigma_m); });
      },
      py::arg("angle_rad"), py::arg("baseline_m"), py::arg("path_sigma_m"), "Their first-order deviations.");
  m.def(
      "heading_error",
      [](double baseline_m, double sigma_m) {
        const auto error = gnss::heading_error(baseline_m, sigma_m);
        return py::make_tuple(error.linear_sigma_rad, error.rms_rad, error.inversion_probability);
      },
      py::arg("baseline_m"), py::arg("position_sigma_m"), "(linear sigma, rms, probability of inversion).");
  m.def(
      "heading_error_density",
      [](const RealArray<"error_rad">& error, double kappa) {
        return each(error.span(), [&](double x) { return gnss::heading_error_density(x, kappa); });
      },
      py::arg("error_rad"), py::arg("kappa"), "Probability density of a heading error.");
}

}  // namespace

void register_gnss_attitude(py::module_& m) {
  using gnss::BaselineStatus;
  m.def("lambda_ils", &lambda_ils, py::arg("a"), py::arg("Q"), py::arg("n_candidates"),
        "(integers (k, n), squared norms (k,)), the nearest first.");
  m.def("success_rate", &success_rate, py::arg("Q"), "Probability that integer bootstrapping is right.");
  py::native_enum<BaselineStatus>(m, "BaselineStatus", "enum.IntEnum", "What became of an epoch.")
      .value("FIXED", BaselineStatus::kFixed)
      .value("TRACKED", BaselineStatus::kTracked)
      .value("FLOAT", BaselineStatus::kFloat)
      .value("TOO_FEW_SATELLITES", BaselineStatus::kTooFewSatellites)
      .value("DEGENERATE", BaselineStatus::kDegenerate)
      .finalize();
  py::class_<gnss::BaselineOptions>(m, "BaselineOptions", "What a baseline may assume.")
      .def(py::init(&baseline_options), py::kw_only(), py::arg("wavelength_m"), py::arg("phase_sigma_m"),
           py::arg("code_phase_ratio"), py::arg("mask_rad"), py::arg("ratio"), py::arg("length_m"), py::arg("search"),
           py::arg("candidates"), py::arg("max_pitch_rad"), py::arg("max_satellites"));
  m.def("receiver_differences", &receiver_differences, py::arg("table"), py::arg("base_position_m"),
        py::arg("wavelength_m"), py::arg("prn"), py::arg("week"), py::arg("time_of_week_s"), py::arg("code_m"),
        py::arg("phase_cycles"), "(directions, code_m, phase_cycles), rover minus base.");
  m.def("baselines", &baselines, py::arg("options"), py::arg("track"), py::arg("directions"), py::arg("code_m"),
        py::arg("phase_cycles"), py::arg("lost_lock"), "Baselines epoch by epoch, column by column.");
  register_attitude(m);
}

}  // namespace soopnav::python
