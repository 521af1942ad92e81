#include <pybind11/native_enum.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <cmath>
#include <cstdio>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "array.hpp"
#include "register.hpp"
#include "soopnav/core/angle.hpp"
#include "soopnav/navigation/source_crlb.hpp"
#include "soopnav/navigation/source_likelihood.hpp"
#include "soopnav/navigation/source_locator.hpp"
#include "soopnav/navigation/source_tracks.hpp"

namespace soopnav::python {

namespace {

using navigation::BearingUse;
using navigation::SourceBearing;
using navigation::SourceFix;
using navigation::SourceLocator;
using navigation::SourceMethod;
using navigation::SourceMotion;
using navigation::SourceOptions;
using navigation::SourceStatus;
using navigation::SourceTracks;
using navigation::TrackState;
using Count = py::ssize_t;

// What every call takes, shapes made by the façade: times (n), positions (n, d), angles and sigmas (n, d - 1),
// covariances (n, d, d) or (0, d, d), heading sigmas (n).
struct Observed {
  std::vector<SourceBearing> bearings;

  Observed(const Numbers<"times_s">& times, const Numbers<"positions">& positions, const Numbers<"bearings">& angles,
           const Numbers<"sigmas">& sigmas, const Numbers<"position_covariance">& covariances,
           const Numbers<"heading_sigma_rad">& heading)
      : bearings(times.span().size()) {
    positions.require_axes({2}, "float64 with shape (n, 2) or (n, 3)");
    const std::size_t n = bearings.size();
    const auto d = static_cast<std::size_t>(positions.shape()[1]);
    const std::size_t k = d - 1;
    if ((d != 2 && d != 3) || positions.span().size() != n * d || angles.span().size() != n * k ||
        sigmas.span().size() != n * k || heading.span().size() != n ||
        (covariances.span().size() != 0 && covariances.span().size() != n * d * d)) {
      throw std::invalid_argument("positions, bearings, sigmas: their shapes do not fit");
    }
    for (std::size_t i = 0; i < n; ++i) {
      SourceBearing& b = bearings[i];
      b.t_s = times.span()[i];
      for (std::size_t j = 0; j < d; ++j) b.position_m[static_cast<Eigen::Index>(j)] = positions.span()[i * d + j];
      set_angles(b, angles.span().subspan(i * k, k), sigmas.span().subspan(i * k, k));
      b.heading_sigma_rad = heading.span()[i];
      if (covariances.span().empty()) continue;
      for (std::size_t j = 0; j < d * d; ++j) {
        b.position_covariance_m2(static_cast<Eigen::Index>(j / d), static_cast<Eigen::Index>(j % d)) =
            covariances.span()[i * d * d + j];
      }
    }
  }

  static void set_angles(SourceBearing& b, std::span<const double> angle, std::span<const double> sigma) {
    b.azimuth_rad = angle[0];
    b.sigma_azimuth_rad = sigma[0];
    if (angle.size() < 2) return;
    b.elevation_rad = angle[1];
    b.sigma_elevation_rad = sigma[1];
  }
};

py::array_t<double> square_of(const Eigen::Matrix3d& m, int d) {
  py::array_t<double> out({d, d});
  for (int i = 0; i < d; ++i) {
    for (int j = 0; j < d; ++j) out.mutable_at(i, j) = m(i, j);
  }
  return out;
}
py::array_t<double> head_of(const Eigen::Vector3d& v, int d) {
  py::array_t<double> out(d);
  for (int i = 0; i < d; ++i) out.mutable_at(i) = v[i];
  return out;
}

// A history of fixes, as arrays.
class History {
 public:
  History(std::size_t n, int dimensions)
      : n_(n),
        d_(static_cast<std::size_t>(dimensions)),
        position_(n * d_),
        covariance_(n * d_ * d_),
        velocity_(n * d_),
        velocity_covariance_(n * d_ * d_),
        scalars_(n * 3),
        status_(n),
        use_(n) {}

  void set(std::size_t at, const SourceFix& fix) {
    for (std::size_t i = 0; i < d_; ++i) {
      const auto row = static_cast<Eigen::Index>(i);
      position_[at * d_ + i] = fix.position_m[row];
      velocity_[at * d_ + i] = fix.velocity_mps[row];
      for (std::size_t j = 0; j < d_; ++j) {
        const auto column = static_cast<Eigen::Index>(j);
        covariance_[(at * d_ + i) * d_ + j] = fix.covariance_m2(row, column);
        velocity_covariance_[(at * d_ + i) * d_ + j] = fix.velocity_covariance(row, column);
      }
    }
    scalars_[at * 3] = fix.cep_m;
    scalars_[at * 3 + 1] = fix.heading_bias_rad;
    scalars_[at * 3 + 2] = fix.heading_bias_sigma_rad;
    status_[at] = static_cast<std::int64_t>(fix.status);
    use_[at] = static_cast<std::int64_t>(fix.last);
  }

  // position, covariance, velocity, velocity covariance, scalars, status, use; `lead` are the axes before the last.
  py::tuple arrays(const std::vector<Count>& lead) && {
    const auto with = [&](std::initializer_list<std::size_t> more) {
      std::vector<Count> shape = lead;
      for (const std::size_t m : more) shape.push_back(static_cast<Count>(m));
      return shape;
    };
    return py::make_tuple(to_array(std::move(position_), with({d_})), to_array(std::move(covariance_), with({d_, d_})),
                          to_array(std::move(velocity_), with({d_})),
                          to_array(std::move(velocity_covariance_), with({d_, d_})),
                          to_array(std::move(scalars_), with({3})), to_array(std::move(status_), with({})),
                          to_array(std::move(use_), with({})));
  }

 private:
  std::size_t n_, d_;
  std::vector<double> position_, covariance_, velocity_, velocity_covariance_, scalars_;
  std::vector<std::int64_t> status_, use_;
};

SourceOptions make_options(SourceMethod method, int dimensions, SourceMotion motion,
                           const std::optional<RealArray<"start_m">>& start, const py::kwargs& more) {
  SourceOptions o;
  o.method = method;
  o.dimensions = dimensions;
  o.motion = motion;
  if (start) {
    if (start->size() != static_cast<std::size_t>(dimensions)) {
      throw std::invalid_argument("start_m: " + std::to_string(dimensions) + " numbers expected, got " +
                                  std::to_string(start->size()));
    }
    Eigen::Vector3d at = Eigen::Vector3d::Zero();
    for (std::size_t i = 0; i < start->size(); ++i) at[static_cast<Eigen::Index>(i)] = (*start)[i];
    o.start_m = at;
  }
  const auto read = [&](const char* name, auto& value) {
    if (more.contains(name)) value = more[name].cast<std::remove_reference_t<decltype(value)>>();
  };
  read("start_sigma_m", o.start_sigma_m);
  read("start_speed_sigma_mps", o.start_speed_sigma_mps);
  read("acceleration_psd", o.acceleration_psd);
  read("min_range_m", o.min_range_m);
  read("max_range_m", o.max_range_m);
  read("outlier_probability", o.outlier_probability);
  read("heading_bias_sigma_rad", o.heading_bias_sigma_rad);
  read("min_crossing_rad", o.min_crossing_rad);
  read("triple_spacing", o.triple_spacing);
  read("grid_size", o.grid_size);
  read("max_iterations", o.max_iterations);
  read("particles", o.particles);
  read("ess_threshold", o.ess_threshold);
  read("seed", o.seed);
  read("filters", o.filters);
  read("bank_sigma_rad", o.bank_sigma_rad);
  read("bank_azimuths", o.bank_azimuths);
  read("max_bearings", o.max_bearings);
  read("false_alarm_probability", o.false_alarm_probability);
  return o;
}

std::vector<std::string> unobservable(const SourceFix& fix) {
  if (fix.status != SourceStatus::kUnobservable) return {};
  if (!fix.line) return {"range"};
  char text[60];
  std::snprintf(text, sizeof text, "range along azimuth %.2f deg",
                degrees(std::atan2(fix.line->direction[1], fix.line->direction[0])));
  return {text};
}

void register_fix(py::module_& m) {
  py::class_<navigation::SourceLine>(m, "SourceLine", "A line on which a source lies. Read-only.")
      .def_property_readonly(
          "point_m", [](const navigation::SourceLine& l) { return head_of(l.point_m, 3); },
          "A place of the platform; shape (3,).")
      .def_property_readonly(
          "direction", [](const navigation::SourceLine& l) { return head_of(l.direction, 3); },
          "Unit vector towards the source; shape (3,).")
      .def_readonly("sigma_rad", &navigation::SourceLine::sigma_rad, "Of the direction's azimuth.")
      .def("__repr__", [](const navigation::SourceLine& l) {
        char text[120];
        std::snprintf(text, sizeof text, "SourceLine(from [%.2f, %.2f, %.2f], azimuth %.2f deg, sigma %.2g deg)",
                      l.point_m[0], l.point_m[1], l.point_m[2], degrees(std::atan2(l.direction[1], l.direction[0])),
                      degrees(l.sigma_rad));
        return std::string(text);
      });
  py::class_<SourceFix>(m, "SourceFix", "A source's position and what it is worth. Read-only; NaN where there is none.")
      .def_readonly("status", &SourceFix::status, "How the fix ended.")
      .def_readonly("last", &SourceFix::last, "What became of the last bearing.")
      .def_readonly("dimensions", &SourceFix::dimensions, "2 or 3.")
      .def_property_readonly(
          "position_m", [](const SourceFix& f) { return head_of(f.position_m, f.dimensions); },
          "At the last bearing; shape (d,).")
      .def_property_readonly(
          "covariance_m2", [](const SourceFix& f) { return square_of(f.covariance_m2, f.dimensions); },
          "Of position_m; shape (d, d).")
      .def_property_readonly(
          "velocity_mps", [](const SourceFix& f) { return head_of(f.velocity_mps, f.dimensions); },
          "Of a moving source; shape (d,).")
      .def_property_readonly(
          "velocity_covariance", [](const SourceFix& f) { return square_of(f.velocity_covariance, f.dimensions); },
          "Of velocity_mps; shape (d, d).")
      .def_readonly("heading_bias_rad", &SourceFix::heading_bias_rad, "Constant error of all azimuths, if estimated.")
      .def_readonly("heading_bias_sigma_rad", &SourceFix::heading_bias_sigma_rad, "Its standard deviation.")
      .def_readonly("cep_m", &SourceFix::cep_m, "Radius that holds the horizontal error with probability one half.")
      .def_readonly("chi_square", &SourceFix::chi_square, "Of the residuals of bearings that are no outliers.")
      .def_readonly("degrees_of_freedom", &SourceFix::degrees_of_freedom, "Of chi_square.")
      .def_readonly("used", &SourceFix::used, "Number of bearings used.")
      .def_readonly("rejected", &SourceFix::rejected, "Number of bearings left out.")
      .def_readonly("outliers", &SourceFix::outliers, "Of those used: more likely from anywhere than from the source.")
      .def_property_readonly(
          "line", [](const SourceFix& f) { return f.line; },
          "The line on which the source lies when its range is not determined, else None.")
      .def_property_readonly("unobservable", &unobservable, "What the bearings do not determine, in words; else empty.")
      .def_property_readonly("message", &SourceFix::message, "One sentence.")
      .def("__repr__", [](const SourceFix& f) {
        return "SourceFix(" + std::string(navigation::to_string(f.status)) + ": " + f.message() + ")";
      });
}

void register_locator(py::module_& m) {
  py::class_<SourceLocator>(m, "SourceLocator", "Bearings in, a position out.")
      .def(py::init([](SourceMethod method, int dimensions, SourceMotion motion,
                       const std::optional<RealArray<"start_m">>& start, const py::kwargs& more) {
             return SourceLocator(make_options(method, dimensions, motion, start, more));
           }),
           py::arg("method"), py::arg("dimensions"), py::arg("motion"), py::arg("start_m"))
      .def(
          "step",
          [](SourceLocator& self, const Numbers<"times_s">& t, const Numbers<"positions">& p,
             const Numbers<"bearings">& z, const Numbers<"sigmas">& s, const Numbers<"position_covariance">& c,
             const Numbers<"heading_sigma_rad">& h, bool solve) -> std::optional<SourceFix> {
            const Observed observed(t, p, z, s, c, h);
            const py::gil_scoped_release release;
            for (const SourceBearing& b : observed.bearings) self.observe(b);
            if (!solve) return std::nullopt;
            return self.fix();
          },
          py::arg("times_s"), py::arg("positions"), py::arg("bearings"), py::arg("sigmas"),
          py::arg("position_covariance"), py::arg("heading_sigma_rad"), py::arg("solve"),
          "Takes bearings, then solves.")
      .def(
          "run",
          [](SourceLocator& self, const Numbers<"times_s">& t, const Numbers<"positions">& p,
             const Numbers<"bearings">& z, const Numbers<"sigmas">& s, const Numbers<"position_covariance">& c,
             const Numbers<"heading_sigma_rad">& h) {
            const Observed observed(t, p, z, s, c, h);
            const std::size_t n = observed.bearings.size();
            History history(n, self.options().dimensions);
            {
              const py::gil_scoped_release release;
              for (std::size_t i = 0; i < n; ++i) history.set(i, self.step(observed.bearings[i]));
            }
            return std::move(history).arrays({static_cast<Count>(n)});
          },
          py::arg("times_s"), py::arg("positions"), py::arg("bearings"), py::arg("sigmas"),
          py::arg("position_covariance"), py::arg("heading_sigma_rad"), "A fix after every bearing.")
      .def(
          "run_many",
          [](SourceLocator& self, const Numbers<"times_s">& t, const Numbers<"positions">& p,
             const Numbers<"bearings">& z, const Numbers<"sigmas">& s, const Numbers<"position_covariance">& c,
             const Numbers<"heading_sigma_rad">& h, const Numbers<"starts_m">& starts,
             const std::vector<std::uint64_t>& seeds, const std::vector<std::size_t>& epochs) {
            // Angles and sigmas: (runs, n, k); all else as of one run.
            const std::size_t n = t.span().size();
            const std::size_t runs = seeds.size();
            const auto d = static_cast<std::size_t>(self.options().dimensions);
            const std::size_t k = d - 1;
            if (z.span().size() != runs * n * k || s.span().size() != runs * n * k ||
                (!starts.span().empty() && starts.span().size() != runs * d)) {
              throw std::invalid_argument("bearings, sigmas, starts_m: their shapes do not fit the number of runs");
            }
            std::vector<SourceBearing> bearings;
            {
              const std::vector<double> none(n * k, 0.0);
              const py::array_t<double> zero(static_cast<Count>(n * k), none.data());
              bearings = Observed(t, p, Numbers<"bearings">(zero), Numbers<"sigmas">(zero), c, h).bearings;
            }
            History history(runs * epochs.size(), self.options().dimensions);
            {
              const py::gil_scoped_release release;
              for (std::size_t run = 0; run < runs; ++run) {
                std::optional<Eigen::Vector3d> start;
                if (!starts.span().empty()) {
                  start = Eigen::Vector3d::Zero();
                  for (std::size_t i = 0; i < d; ++i)
                    (*start)[static_cast<Eigen::Index>(i)] = starts.span()[run * d + i];
                }
                self.reset(start, seeds[run]);
                std::size_t next = 0;
                for (std::size_t i = 0; i < n; ++i) {
                  const std::size_t at = (run * n + i) * k;
                  Observed::set_angles(bearings[i], z.span().subspan(at, k), s.span().subspan(at, k));
                  self.observe(bearings[i]);
                  for (; next < epochs.size() && epochs[next] == i; ++next) {
                    history.set(run * epochs.size() + next, self.fix());
                  }
                }
              }
            }
            return std::move(history).arrays({static_cast<Count>(runs), static_cast<Count>(epochs.size())});
          },
          py::arg("times_s"), py::arg("positions"), py::arg("bearings"), py::arg("sigmas"),
          py::arg("position_covariance"), py::arg("heading_sigma_rad"), py::arg("starts_m"), py::arg("seeds"),
          py::arg("epochs"), "Fixes at some epochs of many runs.")
      .def(
          "reset",
          [](SourceLocator& self, const std::optional<RealArray<"start_m">>& start, std::uint64_t seed) {
            std::optional<Eigen::Vector3d> at;
            if (start) {
              at = Eigen::Vector3d::Zero();
              for (std::size_t i = 0; i < std::min<std::size_t>(start->size(), 3); ++i) {
                (*at)[static_cast<Eigen::Index>(i)] = (*start)[i];
              }
            }
            self.reset(at, seed);
          },
          py::arg("start_m"), py::arg("seed"), "As new.")
      .def(
          "particles",
          [](const SourceLocator& self) {
            const auto d = static_cast<Count>(self.options().dimensions);
            const auto n = static_cast<Count>(self.weights().size());
            py::array_t<double> out({n, d});
            for (Count axis = 0; axis < d; ++axis) {
              const auto values = self.particles(static_cast<int>(axis));
              for (Count i = 0; i < n; ++i) out.mutable_at(i, axis) = values[static_cast<std::size_t>(i)];
            }
            return out;
          },
          "Places of the particles; shape (particles, d).")
      .def(
          "weights",
          [](const SourceLocator& self) {
            const auto w = self.weights();
            return to_array(std::vector<double>(w.begin(), w.end()));
          },
          "Weights of the particles; shape (particles,).")
      .def(
          "members",
          [](const SourceLocator& self) {
            const auto n = static_cast<Count>(self.members());
            const int d = self.options().dimensions;
            py::array_t<double> at({n, static_cast<Count>(d)});
            py::array_t<double> weight(n);
            for (Count i = 0; i < n; ++i) {
              const auto p = self.member_position_m(static_cast<std::size_t>(i));
              for (int j = 0; j < d; ++j) at.mutable_at(i, j) = p[j];
              weight.mutable_at(i) = self.member_weight(static_cast<std::size_t>(i));
            }
            return py::make_tuple(at, weight);
          },
          "Positions and weights of the bank's members.");
}

void register_tracks(py::module_& m) {
  py::native_enum<TrackState>(m, "TrackState", "enum.Enum", "How far a track has come.")
      .value("TENTATIVE", TrackState::kTentative)
      .value("CONFIRMED", TrackState::kConfirmed)
      .finalize();
  using navigation::SourceTrack;
  py::class_<SourceTrack>(m, "SourceTrack", "One source as it stands. Read-only.")
      .def_readonly("id", &SourceTrack::id, "Never used twice.")
      .def_readonly("state", &SourceTrack::state, "How far it has come.")
      .def_readonly("fix", &SourceTrack::fix, "Where it is.")
      .def_readonly("hits", &SourceTrack::hits, "Bearings taken.")
      .def_readonly("misses", &SourceTrack::misses, "Epochs in a row without one.")
      .def_readonly("bearing", &SourceTrack::bearing, "Index of this epoch's bearing; -1: none.")
      .def("__repr__", [](const SourceTrack& t) {
        return "SourceTrack(" + std::to_string(t.id) + ", " +
               (t.state == TrackState::kConfirmed ? "confirmed, " : "tentative, ") + t.fix.message() + ")";
      });
  py::class_<SourceTracks>(m, "SourceTracks", "Several sources at once.")
      .def(py::init([](int dimensions, SourceMotion motion, double gate_probability, double clutter_density_per_rad,
                       int confirm_hits, int confirm_epochs, int drop_misses, const py::kwargs& more) {
             navigation::SourceTrackOptions o;
             o.source = make_options(SourceMethod::kEkfBank, dimensions, motion, std::nullopt, more);
             o.gate_probability = gate_probability;
             o.clutter_density_per_rad = clutter_density_per_rad;
             o.confirm_hits = confirm_hits;
             o.confirm_epochs = confirm_epochs;
             o.drop_misses = drop_misses;
             return SourceTracks(o);
           }),
           py::arg("dimensions"), py::arg("motion"), py::arg("gate_probability"), py::arg("clutter_density_per_rad"),
           py::arg("confirm_hits"), py::arg("confirm_epochs"), py::arg("drop_misses"))
      .def(
          "step",
          [](SourceTracks& self, const Numbers<"times_s">& t, const Numbers<"positions">& p,
             const Numbers<"bearings">& z, const Numbers<"sigmas">& s, const Numbers<"position_covariance">& c,
             const Numbers<"heading_sigma_rad">& h) {
            const Observed observed(t, p, z, s, c, h);
            {
              const py::gil_scoped_release release;
              self.step(observed.bearings);
            }
            const auto tracks = self.tracks();
            return std::vector<SourceTrack>(tracks.begin(), tracks.end());
          },
          py::arg("times_s"), py::arg("positions"), py::arg("bearings"), py::arg("sigmas"),
          py::arg("position_covariance"), py::arg("heading_sigma_rad"), "One epoch.");
}

}  // namespace

void register_source(py::module_& m) {
  py::native_enum<SourceMethod>(m, "SourceMethod", "enum.Enum", "How bearings become a position.")
      .value("CENTROID", SourceMethod::kCentroid)
      .value("INCENTER", SourceMethod::kIncenter)
      .value("LINEAR", SourceMethod::kLinear)
      .value("STANSFIELD", SourceMethod::kStansfield)
      .value("LEAST_SQUARES", SourceMethod::kLeastSquares)
      .value("ML", SourceMethod::kMaximumLikelihood)
      .value("EKF", SourceMethod::kExtendedKalman)
      .value("EKF_BANK", SourceMethod::kEkfBank)
      .value("PARTICLE", SourceMethod::kParticle)
      .finalize();
  py::native_enum<SourceMotion>(m, "SourceMotion", "enum.Enum", "What a source does between bearings.")
      .value("STATIC", SourceMotion::kStatic)
      .value("CONSTANT_VELOCITY", SourceMotion::kConstantVelocity)
      .finalize();
  py::native_enum<SourceStatus>(m, "SourceStatus", "enum.Enum", "How a fix ended.")
      .value("CONVERGED", SourceStatus::kConverged)
      .value("TOO_FEW_BEARINGS", SourceStatus::kTooFewBearings)
      .value("UNOBSERVABLE", SourceStatus::kUnobservable)
      .value("INCONSISTENT", SourceStatus::kInconsistent)
      .value("ON_PLATFORM", SourceStatus::kOnPlatform)
      .value("NOT_CONVERGED", SourceStatus::kNotConverged)
      .value("DIVERGED", SourceStatus::kDiverged)
      .finalize();
  py::native_enum<BearingUse>(m, "BearingUse", "enum.Enum", "What became of a bearing.")
      .value("USED", BearingUse::kUsed)
      .value("NOT_FINITE", BearingUse::kNotFinite)
      .value("BAD_SIGMA", BearingUse::kBadSigma)
      .value("OUT_OF_ORDER", BearingUse::kOutOfOrder)
      .value("WAITING", BearingUse::kWaiting)
      .value("UNDEFINED", BearingUse::kUndefined)
      .finalize();
  register_fix(m);
  register_locator(m);
  register_tracks(m);

  m.def(
      "source_crlb",
      [](const Numbers<"times_s">& t, const Numbers<"positions">& p, const Numbers<"sigmas">& s,
         const Numbers<"position_covariance">& c, const Numbers<"heading_sigma_rad">& h,
         const RealArray<"emitter">& emitter, const RealArray<"velocity">& velocity, bool moving,
         double acceleration_psd, double heading_bias_sigma_rad, double start_sigma_m, double start_speed_sigma_mps) {
        const Observed observed(t, p, Numbers<"bearings">(py::array_t<double>(static_cast<Count>(s.span().size()))), s,
                                c, h);
        navigation::SourceBoundOptions o;
        o.dimensions = static_cast<int>(p.shape()[1]);
        o.motion = moving ? SourceMotion::kConstantVelocity : SourceMotion::kStatic;
        o.acceleration_psd = acceleration_psd;
        o.heading_bias_sigma_rad = heading_bias_sigma_rad;
        o.start_sigma_m = start_sigma_m;
        o.start_speed_sigma_mps = start_speed_sigma_mps;
        const auto d = static_cast<std::size_t>(o.dimensions);
        if (emitter.size() != d || velocity.size() != d) {
          throw std::invalid_argument("emitter, velocity: " + std::to_string(d) + " numbers expected");
        }
        Eigen::Vector3d at = Eigen::Vector3d::Zero();
        Eigen::Vector3d speed = Eigen::Vector3d::Zero();
        for (std::size_t i = 0; i < d; ++i) {
          at[static_cast<Eigen::Index>(i)] = emitter[i];
          speed[static_cast<Eigen::Index>(i)] = velocity[i];
        }
        std::vector<Eigen::MatrixXd> bounds;
        {
          const py::gil_scoped_release release;
          bounds = navigation::source_crlb(observed.bearings, at, speed, o);
        }
        const std::size_t k = moving ? 2 * d : d;
        std::vector<double> out;
        out.reserve(bounds.size() * k * k);
        for (const auto& b : bounds) out.insert(out.end(), b.data(), b.data() + b.size());  // symmetric
        return to_array(std::move(out),
                        {static_cast<Count>(bounds.size()), static_cast<Count>(k), static_cast<Count>(k)});
      },
      py::arg("times_s"), py::arg("positions"), py::arg("sigmas"), py::arg("position_covariance"),
      py::arg("heading_sigma_rad"), py::arg("emitter"), py::arg("velocity"), py::arg("moving"),
      py::arg("acceleration_psd"), py::arg("heading_bias_sigma_rad"), py::arg("start_sigma_m"),
      py::arg("start_speed_sigma_mps"), "Cramér-Rao bound over time.");

  m.def(
      "likelihood_surface",
      [](const Numbers<"times_s">& t, const Numbers<"positions">& p, const Numbers<"bearings">& z,
         const Numbers<"sigmas">& s, const Numbers<"position_covariance">& c, const Numbers<"heading_sigma_rad">& h,
         std::pair<double, double> x, std::pair<double, double> y, std::size_t columns, std::size_t rows,
         double outlier_probability) {
        const Observed observed(t, p, z, s, c, h);
        std::vector<navigation::PackedBearing> packed;
        packed.reserve(observed.bearings.size());
        for (const SourceBearing& b : observed.bearings) {
          navigation::PackedBearing k;
          k.x = b.position_m[0];
          k.y = b.position_m[1];
          k.cos_azimuth = std::cos(b.azimuth_rad);
          k.sin_azimuth = std::sin(b.azimuth_rad);
          k.variance_azimuth = b.sigma_azimuth_rad * b.sigma_azimuth_rad + b.heading_sigma_rad * b.heading_sigma_rad;
          k.xx = b.position_covariance_m2(0, 0);
          k.xy = b.position_covariance_m2(0, 1);
          k.yy = b.position_covariance_m2(1, 1);
          const bool good = std::isfinite(k.x + k.y + k.cos_azimuth + k.variance_azimuth + k.xx + k.xy + k.yy) &&
                            b.sigma_azimuth_rad > 0.0;
          if (good) packed.push_back(k);
        }
        if (rows > 100'000 || columns > 100'000) throw std::invalid_argument("grid: at most 100 000 a side expected");
        std::vector<double> surface(rows * columns);
        {
          const py::gil_scoped_release release;
          navigation::likelihood_surface(packed, {x.first, x.second, y.first, y.second, columns, rows},
                                         outlier_probability, surface);
        }
        return to_array(std::move(surface), {static_cast<Count>(rows), static_cast<Count>(columns)});
      },
      py::arg("times_s"), py::arg("positions"), py::arg("bearings"), py::arg("sigmas"), py::arg("position_covariance"),
      py::arg("heading_sigma_rad"), py::arg("x"), py::arg("y"), py::arg("columns"), py::arg("rows"),
      py::arg("outlier_probability"), "Log-likelihood over a grid.");
}

}  // namespace soopnav::python
