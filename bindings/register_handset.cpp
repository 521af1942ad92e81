#include <pybind11/native_enum.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <limits>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "array.hpp"
#include "register.hpp"
#include "soopnav/core/angle.hpp"
#include "soopnav/navigation/handset_locator.hpp"
#include "soopnav/simulation/handset_world.hpp"

namespace soopnav::python {

namespace {

using navigation::HandsetClock;
using navigation::HandsetEstimate;
using navigation::HandsetFilter;
using navigation::HandsetLocator;
using navigation::HandsetMotion;
using navigation::HandsetOptions;
using navigation::HandsetReport;
using navigation::HandsetStatus;
using navigation::HandsetUse;
using simulation::HandsetWorld;
using simulation::HandsetWorldOptions;
using simulation::NlosOptions;
using simulation::NlosSchedule;
using Size = py::ssize_t;

// Reads each keyword it is asked for; what nobody asked for is an error.
class Keywords {
 public:
  explicit Keywords(const py::kwargs& given) : given_(given) {}
  template <class T>
  void operator()(const char* name, T& value) {
    known_.emplace_back(name);
    if (!given_.contains(name)) return;
    try {
      value = given_[name].cast<T>();
    } catch (const py::cast_error&) {
      throw std::invalid_argument(std::string(name) + ": a number of another kind expected, got " +
                                  py::repr(given_[name]).cast<std::string>());
    }
  }
  void done() const {
    for (const auto& item : given_) {
      const auto name = item.first.cast<std::string>();
      if (std::find(known_.begin(), known_.end(), name) != known_.end()) continue;
      std::string text = name + ": no such option; known are ";
      for (const std::string& k : known_) text += (&k == known_.data() ? "" : ", ") + k;
      throw std::invalid_argument(text);
    }
  }

 private:
  const py::kwargs& given_;
  std::vector<std::string> known_;
};

std::vector<Eigen::Vector3d> places_of(const TableBase& table, const char* name, double height_m) {
  if (table.columns() != 2 && table.columns() != 3) {
    throw std::invalid_argument(std::string(name) + ": two or three columns expected, got " +
                                std::to_string(table.columns()));
  }
  std::vector<Eigen::Vector3d> out(table.rows());
  for (std::size_t i = 0; i < out.size(); ++i) {
    const auto row = table.row(i);
    out[i] = {row[0], row[1], row.size() > 2 ? row[2] : height_m};
  }
  return out;
}

template <int N>
Eigen::Matrix<double, N, N> square_from(std::span<const double> numbers, const char* name) {
  if (numbers.size() != static_cast<std::size_t>(N * N)) {
    throw std::invalid_argument(std::string(name) + ": shape (" + std::to_string(N) + ", " + std::to_string(N) +
                                ") expected");
  }
  Eigen::Matrix<double, N, N> out;
  for (int i = 0; i < N; ++i) {
    for (int j = 0; j < N; ++j) out(i, j) = numbers[static_cast<std::size_t>(i * N + j)];
  }
  return out;
}

HandsetOptions options_of(const Table<"nodes_m">& nodes, HandsetFilter filter, HandsetClock clock, double height_m,
                          const RealArray<"start_m">& start, const RealArray<"node_sigma_m">& node_sigma,
                          const Numbers<"room_m">& room, const Numbers<"walls_m">& walls, bool alone,
                          const py::kwargs& more) {
  HandsetOptions o = alone ? HandsetOptions::lte_alone({}) : HandsetOptions{};
  o.nodes_m = places_of(nodes, "nodes_m", height_m);
  if (!alone) o.filter = filter;
  o.clock = clock;
  o.height_m = height_m;
  if (start.size() != 2) {
    throw std::invalid_argument("start_m: two numbers expected, got " + std::to_string(start.size()));
  }
  o.start_m = {start[0], start[1]};
  o.node_sigma_m.assign(node_sigma.span().begin(), node_sigma.span().end());
  if (!room.span().empty()) {
    room.require_axes({2}, "float64 with shape (n, 2)");
    if (room.shape()[1] != 2) throw std::invalid_argument("room_m: two columns expected");
    for (std::size_t i = 0; i + 1 < room.span().size(); i += 2)
      o.room_m.emplace_back(room.span()[i], room.span()[i + 1]);
  }
  if (!walls.span().empty()) {
    walls.require_axes({2}, "float64 with shape (n, 4)");
    if (walls.shape()[1] != 4) throw std::invalid_argument("walls_m: four columns expected");
    for (std::size_t i = 0; i + 3 < walls.span().size(); i += 4) {
      o.walls_m.emplace_back(walls.span()[i], walls.span()[i + 1], walls.span()[i + 2], walls.span()[i + 3]);
    }
  }
  Keywords read(more);
  long long particles = static_cast<long long>(o.particles);
  read("particles", particles);
  read("seed", o.seed);
  read("ess_threshold", o.ess_threshold);
  read("start_sigma_m", o.start_sigma_m);
  read("start_heading_rad", o.start_heading_rad);
  read("start_heading_sigma_rad", o.start_heading_sigma_rad);
  if (alone) o.kernel_m = std::max(o.kernel_m, o.start_sigma_m);
  read("kernel", o.kernel);
  read("kernel_m", o.kernel_m);
  read("kernel_rad", o.kernel_rad);
  read("clock_start_m", o.clock_start_m);
  read("clock_sigma_m", o.clock_sigma_m);
  read("clock_walk_m2ps", o.clock_noise.white_frequency_m2ps);
  read("clock_frequency_walk_m2ps3", o.clock_noise.frequency_walk_m2ps3);
  read("clock_drift_sigma_mps", o.clock_drift_sigma_mps);
  read("node_offset_sigma_m", o.node_offset_sigma_m);
  read("node_offset_walk_m2ps", o.node_offset_walk_m2ps);
  read("nlos", o.nlos);
  read("mean_los_s", o.mean_los_s);
  read("mean_nlos_s", o.mean_nlos_s);
  read("excess_min_m", o.excess_min_m);
  read("excess_max_m", o.excess_max_m);
  read("excess_walk_m2ps", o.excess_walk_m2ps);
  read("multipath_sigma_m", o.multipath_sigma_m);
  read("multipath_length_m", o.multipath_length_m);
  read("outlier_probability", o.outlier_probability);
  read("outlier_span_m", o.outlier_span_m);
  read("recover_after", o.recover_after);
  read("acceleration_psd_m2ps3", o.acceleration_psd_m2ps3);
  read("start_speed_sigma_mps", o.start_speed_sigma_mps);
  read("turn_psd_rad2ps", o.turn_psd_rad2ps);
  read("coast_psd_m2ps", o.coast_psd_m2ps);
  read("coast_turn_psd_rad2ps", o.coast_turn_psd_rad2ps);
  read("coast_after_s", o.coast_after_s);
  read("max_speed_mps", o.max_speed_mps);
  read("max_disagreement_s", o.max_disagreement_s);
  read.done();
  if (particles < 1)
    throw std::invalid_argument("particles: " + std::to_string(particles) + "; 1 ... 1 000 000 expected");
  o.particles = static_cast<std::size_t>(particles);
  return o;
}

HandsetMotion motion_of(const RealArrayBase& increment, const NumbersBase& track, const NumbersBase& previous,
                        const NumbersBase& foot) {
  if (increment.size() != 3) {
    throw std::invalid_argument("increment: three numbers expected, got " + std::to_string(increment.size()));
  }
  return {Eigen::Vector3d(increment[0], increment[1], increment[2]), square_from<3>(track.span(), "track_covariance"),
          square_from<2>(previous.span(), "foot_covariance_previous"), square_from<2>(foot.span(), "foot_covariance")};
}

template <class Member>
auto of_links(Member member) {
  return [member](const HandsetEstimate& e) {
    const auto& values = e.*member;
    return to_array(std::vector<double>(values.begin(), values.begin() + e.nodes));
  };
}
py::array_t<double> pair_of(const Eigen::Vector2d& v) { return to_array(std::vector<double>{v[0], v[1]}); }

void register_handset_results(py::module_& m) {
  py::native_enum<HandsetFilter>(m, "HandsetFilter", "enum.Enum", "The two filters of nielsen 4.2.3.")
      .value("CONTROL", HandsetFilter::kControl, "Type 1: the camera's increments move the particles.")
      .value("MEASUREMENT", HandsetFilter::kMeasurement, "Type 2: they are measurements.")
      .finalize();
  py::native_enum<HandsetClock>(m, "HandsetClock", "enum.Enum", "Whose clock the ranges carry.")
      .value("COMMON", HandsetClock::kCommon)
      .value("SEPARATE", HandsetClock::kSeparate)
      .finalize();
  py::native_enum<HandsetUse>(m, "HandsetUse", "enum.Enum", "What became of an observation.")
      .value("USED", HandsetUse::kUsed)
      .value("NOT_FINITE", HandsetUse::kNotFinite)
      .value("OUT_OF_ORDER", HandsetUse::kOutOfOrder)
      .value("CLOCKS_DISAGREE", HandsetUse::kClocksDisagree)
      .value("NOTHING_HEARD", HandsetUse::kNothingHeard)
      .value("COASTED", HandsetUse::kCoasted)
      .value("OUTLIERS", HandsetUse::kOutliers)
      .value("RECOVERED", HandsetUse::kRecovered)
      .value("WALLS", HandsetUse::kWalls)
      .value("TOO_FAST", HandsetUse::kTooFast)
      .finalize();
  py::native_enum<HandsetStatus>(m, "HandsetStatus", "enum.Enum", "What an estimate rests on.")
      .value("STARTING", HandsetStatus::kStarting)
      .value("TRACKING", HandsetStatus::kTracking)
      .value("COASTING", HandsetStatus::kCoasting)
      .value("CAMERA_ONLY", HandsetStatus::kCameraOnly)
      .value("DEAD_TIME", HandsetStatus::kDeadTime)
      .finalize();
  py::class_<HandsetReport>(m, "HandsetReport", "What came of an observation. Read-only.")
      .def_readonly("use", &HandsetReport::use, "What became of it.")
      .def_readonly("heard", &HandsetReport::heard, "Links.")
      .def_readonly("outliers", &HandsetReport::outliers, "Share of particles and links that took it for an outlier.")
      .def_readonly("ess", &HandsetReport::ess, "Effective number of particles.")
      .def_readonly("log_evidence", &HandsetReport::log_evidence, "Of this observation given those before.")
      .def("__repr__", [](const HandsetReport& r) {
        return "HandsetReport(" + std::string(to_string(r.use)) + ", " + std::to_string(r.heard) + " links)";
      });
  py::class_<HandsetEstimate>(m, "HandsetEstimate", "Where a handset is. Read-only; NaN where there is no value.")
      .def_readonly("status", &HandsetEstimate::status, "What it rests on.")
      .def_readonly("t_s", &HandsetEstimate::t_s, "Time of the last observation.")
      .def_property_readonly(
          "position_m", [](const HandsetEstimate& e) { return pair_of(e.position_m); }, "Mean; shape (2,).")
      .def_property_readonly(
          "covariance_m2",
          [](const HandsetEstimate& e) {
            const auto& c = e.covariance_m2;
            return to_array(std::vector<double>{c(0, 0), c(0, 1), c(1, 0), c(1, 1)}, {2, 2});
          },
          "Of the whole mixture; shape (2, 2).")
      .def_readonly("heading_rad", &HandsetEstimate::heading_rad, "Circular mean.")
      .def_readonly("heading_sigma_rad", &HandsetEstimate::heading_sigma_rad, "Circular standard deviation.")
      .def_property_readonly(
          "velocity_mps", [](const HandsetEstimate& e) { return pair_of(e.velocity_mps); }, "Shape (2,).")
      .def_readonly("clock_m", &HandsetEstimate::clock_m, "Common clock, or the first node's.")
      .def_readonly("clock_sigma_m", &HandsetEstimate::clock_sigma_m, "Of clock_m.")
      .def_property_readonly(
          "mode_m", [](const HandsetEstimate& e) { return pair_of(e.mode_m); },
          "Mean of the heaviest group of particles; shape (2,).")
      .def_readonly("mode_share", &HandsetEstimate::mode_share, "Weight of that group.")
      .def_readonly("multimodal", &HandsetEstimate::multimodal, "Whether that is less than 0.9.")
      .def_readonly("ess", &HandsetEstimate::ess, "Effective number of particles.")
      .def_property_readonly("p_los", of_links(&HandsetEstimate::p_los),
                             "Probability that a link has no excess delay; shape (links,).")
      .def_property_readonly("excess_m", of_links(&HandsetEstimate::excess_m),
                             "Excess delay where it has; shape (links,).")
      .def_property_readonly("offset_m", of_links(&HandsetEstimate::offset_m), "Nodes' own times; shape (links,).")
      .def_property_readonly(
          "nodes_m",
          [](const HandsetEstimate& e) {
            std::vector<double> out;
            for (int l = 0; l < e.nodes; ++l) {
              for (int k = 0; k < 2; ++k) out.push_back(e.node_m[static_cast<std::size_t>(l)][k]);
            }
            return to_array(std::move(out), {e.nodes, 2});
          },
          "Places of the nodes, estimated or given; shape (links, 2).")
      .def_property_readonly("node_sigma_m", of_links(&HandsetEstimate::node_sigma_m),
                             "Of each coordinate of them; shape (links,).")
      .def("__repr__", [](const HandsetEstimate& e) {
        char text[200];
        std::snprintf(text, sizeof text, "HandsetEstimate(%s, [%.2f, %.2f] m +- %.2g m, heading %.1f deg%s)",
                      std::string(to_string(e.status)).c_str(), e.position_m[0], e.position_m[1],
                      std::sqrt(0.5 * e.covariance_m2.trace()), degrees(e.heading_rad),
                      e.multimodal ? ", multimodal" : "");
        return std::string(text);
      });
}

// A whole run: frames and epochs in the order of their times, frames first; an estimate after every epoch.
py::tuple run_all(HandsetLocator& self, const RealArray<"frame_s">& frame_s, const Numbers<"increments">& increments,
                  const Numbers<"track_covariance">& track, const Numbers<"foot_covariance">& foot,
                  const RealArray<"epoch_s">& epoch_s, const Numbers<"ranges_m">& ranges,
                  const Numbers<"sigma_m">& sigma) {
  const std::size_t steps = frame_s.size() > 0 ? frame_s.size() - 1 : 0, n = epoch_s.size();
  const std::size_t L = self.options().nodes_m.size();
  const auto fits = [](std::size_t size, std::size_t count, std::size_t each) {
    return size == each || size == count * each;
  };
  if (increments.span().size() != steps * 3) {
    throw std::invalid_argument("increments: shape (frames - 1, 3) expected");
  }
  if (steps > 0 && !fits(track.span().size(), steps, 9)) {
    throw std::invalid_argument("track_covariance: shape (3, 3) or (frames - 1, 3, 3) expected");
  }
  if (steps > 0 && !fits(foot.span().size(), steps + 1, 4)) {
    throw std::invalid_argument("foot_covariance: shape (2, 2) or (frames, 2, 2) expected");
  }
  if (ranges.span().size() != n * L) throw std::invalid_argument("ranges_m: shape (epochs, links) expected");
  if (!fits(sigma.span().size(), n, L)) {
    throw std::invalid_argument("sigma_m: shape (links,) or (epochs, links) expected");
  }
  const auto at = [](std::span<const double> all, std::size_t k, std::size_t each) {
    return all.size() == each ? all : all.subspan(k * each, each);
  };
  std::vector<double> numbers(n * 13), p_los(n * L), excess(n * L);
  std::vector<std::int64_t> codes(n * 2), frame_use(steps);
  {
    const py::gil_scoped_release release;
    std::size_t k = 0;
    const auto frames_until = [&](double t) {
      for (; k < steps && !(frame_s[k + 1] > t); ++k) {
        const auto d = increments.span().subspan(3 * k, 3);
        HandsetMotion m;
        m.increment = {d[0], d[1], d[2]};
        m.track_covariance = square_from<3>(at(track.span(), k, 9), "track_covariance");
        m.foot_covariance_previous = square_from<2>(at(foot.span(), k, 4), "foot_covariance");
        m.foot_covariance = square_from<2>(at(foot.span(), k + 1, 4), "foot_covariance");
        const bool lost = !m.increment.allFinite();
        frame_use[k] =
            static_cast<std::int64_t>((lost ? self.coast(frame_s[k + 1]) : self.move(m, frame_s[k + 1])).use);
      }
    };
    for (std::size_t e = 0; e < n; ++e) {
      if (std::isfinite(epoch_s[e])) frames_until(epoch_s[e]);  // a refused epoch says nothing of frames
      const HandsetReport report =
          self.update_ranges(ranges.span().subspan(e * L, L), at(sigma.span(), e, L), epoch_s[e]);
      const HandsetEstimate x = self.estimate();
      const std::array<double, 13> row = {x.position_m[0],
                                          x.position_m[1],
                                          x.covariance_m2(0, 0),
                                          x.covariance_m2(0, 1),
                                          x.covariance_m2(1, 0),
                                          x.covariance_m2(1, 1),
                                          x.heading_rad,
                                          x.heading_sigma_rad,
                                          x.clock_m,
                                          x.clock_sigma_m,
                                          x.ess,
                                          x.mode_share,
                                          report.log_evidence};
      std::copy(row.begin(), row.end(), numbers.begin() + static_cast<std::ptrdiff_t>(e * row.size()));
      for (std::size_t l = 0; l < L; ++l) {
        p_los[e * L + l] = x.p_los[l];
        excess[e * L + l] = x.excess_m[l];
      }
      codes[2 * e] = static_cast<std::int64_t>(x.status);
      codes[2 * e + 1] = static_cast<std::int64_t>(report.use);
    }
    frames_until(std::numeric_limits<double>::infinity());
  }
  const auto rows = static_cast<Size>(n), columns = static_cast<Size>(L);
  return py::make_tuple(to_array(std::move(numbers), {rows, 13}), to_array(std::move(p_los), {rows, columns}),
                        to_array(std::move(excess), {rows, columns}), to_array(std::move(codes), {rows, 2}),
                        to_array(std::move(frame_use)));
}

void register_handset_locator(py::module_& m) {
  py::class_<HandsetLocator>(m, "HandsetLocator", "Ranges, bearings and camera steps in, a position out.")
      .def(py::init([](const Table<"nodes_m">& nodes, HandsetFilter filter, HandsetClock clock, double height_m,
                       const RealArray<"start_m">& start, const RealArray<"node_sigma_m">& node_sigma,
                       const Numbers<"room_m">& room, const Numbers<"walls_m">& walls, bool alone,
                       const py::kwargs& more) {
             return HandsetLocator(
                 options_of(nodes, filter, clock, height_m, start, node_sigma, room, walls, alone, more));
           }),
           py::arg("nodes_m"), py::arg("filter"), py::arg("clock"), py::arg("height_m"), py::arg("start_m"),
           py::arg("node_sigma_m"), py::arg("room_m"), py::arg("walls_m"), py::arg("alone"))
      .def(
          "move",
          [](HandsetLocator& self, double t_s, const RealArray<"increment">& increment,
             const Numbers<"track_covariance">& track, const Numbers<"foot_covariance_previous">& previous,
             const Numbers<"foot_covariance">& foot) {
            return self.move(motion_of(increment, track, previous, foot), t_s);
          },
          py::arg("t_s"), py::arg("increment"), py::arg("track_covariance"), py::arg("foot_covariance_previous"),
          py::arg("foot_covariance"), "One step of the camera.")
      .def("coast", &HandsetLocator::coast, py::arg("t_s"), "No step known up to here.")
      .def(
          "update_ranges",
          [](HandsetLocator& self, const RealArray<"ranges_m">& z, const RealArray<"sigma_m">& sigma, double t_s) {
            return self.update_ranges(z.span(), sigma.span(), t_s);
          },
          py::arg("ranges_m"), py::arg("sigma_m"), py::arg("t_s"), "Ranges to all nodes.")
      .def(
          "update_bearings",
          [](HandsetLocator& self, const RealArray<"bearings_rad">& z, const RealArray<"sigma_rad">& sigma, double t_s,
             bool of_body, const RealArray<"mirror_rad">& mirror) {
            return self.update_bearings(z.span(), sigma.span(), t_s, of_body, mirror.span());
          },
          py::arg("bearings_rad"), py::arg("sigma_rad"), py::arg("t_s"), py::arg("of_body"), py::arg("mirror_rad"),
          "Bearings to the nodes.")
      .def("estimate", &HandsetLocator::estimate, "Where the handset is.")
      .def(
          "particles",
          [](const HandsetLocator& self, bool draw) {
            const std::size_t n = self.options().particles;
            std::vector<double> out(4 * n);
            const std::span<double> all(out);
            self.particles(all.subspan(0, n), all.subspan(n, n), all.subspan(2 * n, n), all.subspan(3 * n, n), draw);
            return to_array(std::move(out), {4, static_cast<Size>(n)});
          },
          py::arg("draw"), "Rows x, y, heading, weight.")
      .def("run", &run_all, py::arg("frame_s"), py::arg("increments"), py::arg("track_covariance"),
           py::arg("foot_covariance"), py::arg("epoch_s"), py::arg("ranges_m"), py::arg("sigma_m"), "A whole run.")
      .def("reset", &HandsetLocator::reset, py::arg("seed"), "As new.")
      .def_property_readonly("dimension", &HandsetLocator::dimension, "Numbers of each particle's Gaussian.");
}

NlosOptions read_nlos(Keywords& read) {
  NlosOptions o;
  read("links", o.links);
  read("max_blocked", o.max_blocked);
  read("min_clear_share", o.min_clear_share);
  read("mean_los_s", o.mean_los_s);
  read("mean_nlos_s", o.mean_nlos_s);
  read("excess_min_m", o.excess_min_m);
  read("excess_max_m", o.excess_max_m);
  read("excess_walk_m2ps", o.excess_walk_m2ps);
  read("attempts", o.attempts);
  return o;
}

py::tuple arrays_of(NlosSchedule&& s) {
  const std::vector<Size> shape = {static_cast<Size>(s.epochs), s.links};
  const int attempts = s.attempts;
  const bool guarded = s.guarded;
  const double share = s.clear_share;
  return py::make_tuple(to_array(std::move(s.blocked), shape), to_array(std::move(s.excess_m), shape), attempts,
                        guarded, share);
}

template <class Rows>
py::array_t<double> rows_of(const Rows& rows) {
  std::vector<double> out;
  Size columns = 0;
  for (const auto& row : rows) {
    columns = static_cast<Size>(row.size());
    out.insert(out.end(), row.data(), row.data() + columns);
  }
  return to_array(std::move(out), {static_cast<Size>(rows.size()), columns});
}

}  // namespace

void register_handset_world(py::module_& m) {
  m.def(
      "nlos_schedule",
      [](std::size_t epochs, double step_s, std::uint64_t seed, const py::kwargs& more) {
        Keywords read(more);
        const NlosOptions o = read_nlos(read);
        read.done();
        return arrays_of(NlosSchedule::generate(o, epochs, step_s, seed));
      },
      py::arg("epochs"), py::arg("step_s"), py::arg("seed"), "Which links are blocked when.");
  m.def(
      "handset_world",
      [](std::uint64_t seed, const py::kwargs& more) {
        HandsetWorldOptions o;
        Keywords read(more);
        o.nlos = read_nlos(read);
        read("duration_s", o.duration_s);
        read("room_m", o.room_m);
        read("min_node_m", o.min_node_m);
        read("max_node_m", o.max_node_m);
        read("min_speed_mps", o.min_speed_mps);
        read("max_speed_mps", o.max_speed_mps);
        read("range_rate_hz", o.range_rate_hz);
        read("range_sigma_m", o.range_sigma_m);
        read("clock_walk_m2ps", o.clock_walk_m2ps);
        read("clock_sigma_m", o.clock_sigma_m);
        read("frame_rate_hz", o.frame_rate_hz);
        read("step_sigma_m", o.step_sigma_m);
        read("turn_sigma_rad", o.turn_sigma_rad);
        read("foot_sigma_m", o.foot_sigma_m);
        read("heading_error_rad", o.heading_error_rad);
        read("epoch_offset_s", o.epoch_offset_s);
        read.done();
        HandsetWorld w;
        {
          const py::gil_scoped_release release;
          w = HandsetWorld::generate(o, seed);
        }
        const Size n = static_cast<Size>(w.epoch_s.size()), links = o.nlos.links;
        py::array_t<double> increments =
            w.increment.empty() ? to_array(std::vector<double>{}, {0, 3}) : rows_of(w.increment);
        return py::make_tuple(rows_of(w.nodes_m), w.told_heading_rad, to_array(std::move(w.frame_s)), rows_of(w.pose),
                              increments, to_array(std::move(w.walked_m)), to_array(std::move(w.epoch_s)),
                              rows_of(w.position_m), to_array(std::move(w.range_m), {n, links}),
                              to_array(std::move(w.clock_m)), arrays_of(std::move(w.nlos)));
      },
      py::arg("seed"), "A walk indoors.");
}

void register_handset(py::module_& m) {
  register_handset_results(m);
  register_handset_locator(m);
}

}  // namespace soopnav::python
