#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <Eigen/Core>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "array.hpp"
#include "register.hpp"
#include "soopnav/clock/clock_fit.hpp"
#include "soopnav/clock/clock_simulator.hpp"
#include "soopnav/clock/deviation.hpp"
#include "soopnav/clock/oscillator.hpp"
#include "soopnav/core/constants.hpp"

namespace soopnav::python {

namespace {

using clock::Deviation;
using clock::DeviationKind;
using clock::Oscillator;
using clock::PowerLaw;

template <class T>
T named(const std::string& value, const char* parameter, std::initializer_list<std::pair<const char*, T>> choices) {
  std::string expected;
  for (const auto& [name, choice] : choices) {
    if (value == name) return choice;
    expected += (expected.empty() ? "'" : ", '") + std::string(name) + "'";
  }
  throw py::value_error(std::string(parameter) + ": expected one of " + expected + ", got '" + value + "'");
}

DeviationKind kind_of(const std::string& kind) {
  return named<DeviationKind>(kind, "kind",
                              {{"allan", DeviationKind::kAllan},
                               {"overlapping", DeviationKind::kOverlappingAllan},
                               {"modified", DeviationKind::kModifiedAllan},
                               {"time", DeviationKind::kTime},
                               {"hadamard", DeviationKind::kHadamard},
                               {"overlapping_hadamard", DeviationKind::kOverlappingHadamard}});
}

std::optional<PowerLaw> noise_of(const std::optional<std::string>& noise) {
  if (!noise) return std::nullopt;
  return named<PowerLaw>(*noise, "noise",
                         {{"white_phase", PowerLaw::kWhitePhase},
                          {"flicker_phase", PowerLaw::kFlickerPhase},
                          {"white_frequency", PowerLaw::kWhiteFrequency},
                          {"flicker_frequency", PowerLaw::kFlickerFrequency},
                          {"random_walk_frequency", PowerLaw::kRandomWalkFrequency}});
}

// Averaging times in seconds as whole numbers of steps.
std::vector<std::size_t> factors_of(const RealArray<"taus">& taus, double dt_s) {
  std::vector<std::size_t> out;
  for (std::size_t i = 0; i < taus.size(); ++i) {
    const double factor = taus[i] / dt_s;
    const double whole = std::round(factor);
    if (!(whole >= 1.0 && whole < 1e15 && std::abs(factor - whole) <= 1e-6 * whole)) {
      throw py::value_error("taus[" + std::to_string(i) + "] = " + std::to_string(taus[i]) +
                            ": a positive multiple of dt_s = " + std::to_string(dt_s) + " expected");
    }
    out.push_back(static_cast<std::size_t>(whole));
  }
  return out;
}

std::vector<Deviation> analyse(const RealArray<"data">& data, double dt_s, const std::string& kind,
                               const std::variant<std::string, RealArray<"taus">>& taus, bool frequency,
                               double confidence, const std::optional<std::string>& noise) {
  if (!(dt_s > 0.0) || std::isinf(dt_s)) {
    throw py::value_error("dt_s = " + std::to_string(dt_s) + " must be positive and finite");
  }
  const DeviationKind which = kind_of(kind);
  const clock::DeviationOptions options{.confidence = confidence, .noise = noise_of(noise)};
  std::vector<std::size_t> factors;
  if (const auto* spacing = std::get_if<std::string>(&taus)) {
    factors = clock::averaging_factors(data.size() + (frequency ? 1 : 0), which,
                                       named<clock::TauSpacing>(*spacing, "taus",
                                                                {{"octave", clock::TauSpacing::kOctave},
                                                                 {"decade", clock::TauSpacing::kDecade},
                                                                 {"all", clock::TauSpacing::kAll}}));
  } else {
    factors = factors_of(std::get<RealArray<"taus">>(taus), dt_s);
  }
  const py::gil_scoped_release release;
  return frequency ? clock::frequency_deviations(data.span(), dt_s, which, factors, options)
                   : clock::phase_deviations(data.span(), dt_s, which, factors, options);
}

py::tuple deviations(const RealArray<"data">& data, double dt_s, const std::string& kind, const py::object& taus,
                     bool frequency, double confidence, const std::optional<std::string>& noise) {
  std::variant<std::string, RealArray<"taus">> chosen;
  if (py::isinstance<py::str>(taus)) {
    chosen = taus.cast<std::string>();
  } else {
    chosen = RealArray<"taus">(taus);
  }
  const auto all = analyse(data, dt_s, kind, chosen, frequency, confidence, noise);
  std::array<std::vector<double>, 5> columns;
  std::vector<std::int64_t> count;
  std::vector<int> alpha;
  for (const Deviation& d : all) {
    const std::array<double, 5> row{d.tau_s, d.deviation, d.lower, d.upper, d.dof};
    for (std::size_t i = 0; i < row.size(); ++i) columns[i].push_back(row[i]);
    count.push_back(static_cast<std::int64_t>(d.count));
    alpha.push_back(static_cast<int>(d.noise));
  }
  return py::make_tuple(to_array(std::move(columns[0])), to_array(std::move(columns[1])),
                        to_array(std::move(columns[2])), to_array(std::move(columns[3])),
                        to_array(std::move(columns[4])), to_array(std::move(count)), to_array(std::move(alpha)));
}

py::tuple simulate(double h0, double h_minus_2, const RealArray<"t_s">& t_s, double bias_s, double drift,
                   std::uint64_t seed, std::uint64_t stream) {
  std::vector<double> bias(t_s.size());
  std::vector<double> rate(t_s.size());
  {
    const py::gil_scoped_release release;
    std::vector<clock::ClockState> x(t_s.size());
    clock::simulate(clock::ClockNoise::from_allan(h0, h_minus_2), {bias_s * kSpeedOfLightMps, drift * kSpeedOfLightMps},
                    t_s.span(), RandomStream(seed, stream), x);
    for (std::size_t i = 0; i < x.size(); ++i) {
      bias[i] = x[i].bias_m;
      rate[i] = x[i].drift_mps / kSpeedOfLightMps;
    }
  }
  return py::make_tuple(to_array(std::move(bias)), to_array(std::move(rate)));
}

py::tuple as_tuple(const Oscillator& o) { return py::make_tuple(o.h0, o.h_minus_2, o.h_minus_1); }

}  // namespace

void register_clock(py::module_& m) {
  m.def(
      "preset",
      [](const std::string& name) {
        return as_tuple(named<Oscillator>(name, "name",
                                          {{"tcxo", Oscillator::tcxo()},
                                           {"ocxo", Oscillator::ocxo()},
                                           {"csac", Oscillator::csac()},
                                           {"gps", Oscillator::gps()},
                                           {"basestation", Oscillator::basestation()},
                                           {"crosby", Oscillator::crosby()}}));
      },
      py::arg("name"), "A named oscillator: (h0, h_minus_2, h_minus_1).");
  m.def(
      "noise",
      [](double h0, double h_minus_2) {
        const auto noise = clock::ClockNoise::from_allan(h0, h_minus_2);
        return py::make_tuple(noise.white_frequency_m2ps, noise.frequency_walk_m2ps3);
      },
      py::arg("h0"), py::arg("h_minus_2"), "Power densities (S_f, S_g) in metres.");
  m.def(
      "from_noise",
      [](double s_f, double s_g) {
        return as_tuple(Oscillator::from_noise({s_f, s_g}));
      },
      py::arg("white_frequency_m2ps"), py::arg("frequency_walk_m2ps3"), "(h0, h_minus_2, 0) of power densities.");
  m.def(
      "crossover_s",
      [](double h0, double h_minus_2) {
        return Oscillator{h0, h_minus_2}.crossover_s();
      },
      py::arg("h0"), py::arg("h_minus_2"), "Step at which both noises add the same variance rate.");
  m.def(
      "model_deviation",
      [](double h0, double h_minus_2, const RealArray<"tau_s">& tau_s) {
        const auto noise = clock::ClockNoise::from_allan(h0, h_minus_2);
        std::vector<double> out;
        for (const double tau : tau_s.span()) out.push_back(clock::allan_deviation(noise, tau));
        return to_array(std::move(out));
      },
      py::arg("h0"), py::arg("h_minus_2"), py::arg("tau_s"), "Allan deviation of the two-state model.");
  m.def(
      "prediction_variance_m2",
      [](double h0, double h_minus_2, double tau_s, const std::optional<Table<"covariance">>& covariance) {
        Eigen::Matrix2d P = Eigen::Matrix2d::Zero();
        if (covariance) {
          if (covariance->rows() != 2 || covariance->columns() != 2) {
            throw py::value_error("covariance: expected shape (2, 2)");
          }
          for (std::size_t i = 0; i < 4; ++i) {
            P(static_cast<Eigen::Index>(i / 2), static_cast<Eigen::Index>(i % 2)) = covariance->row(i / 2)[i % 2];
          }
        }
        return clock::prediction_variance_m2(clock::ClockNoise::from_allan(h0, h_minus_2), tau_s, P);
      },
      py::arg("h0"), py::arg("h_minus_2"), py::arg("tau_s"), py::arg("covariance") = py::none(),
      "Variance of the bias tau_s ahead.");
  m.def("simulate", &simulate, py::arg("h0"), py::arg("h_minus_2"), py::arg("t_s"), py::kw_only(), py::arg("bias_s"),
        py::arg("drift"), py::arg("seed"), py::arg("stream"), "Bias in metres and dimensionless drift at times.");
  m.def("deviations", &deviations, py::arg("data"), py::arg("dt_s"), py::kw_only(), py::arg("kind"), py::arg("taus"),
        py::arg("frequency"), py::arg("confidence"), py::arg("noise"),
        "(tau_s, deviation, lower, upper, dof, count, alpha) of a record.");
  m.def(
      "fit",
      [](const RealArray<"phase_s">& phase_s, double dt_s, bool phase_noise) {
        clock::ClockFit fit;
        {
          const py::gil_scoped_release release;
          fit = clock::fit_clock(phase_s.span(), dt_s, {.phase_noise = phase_noise});
        }
        return py::make_tuple(fit.clock.h0, fit.clock.h_minus_2, fit.sigma_h0, fit.sigma_h_minus_2, fit.correlation,
                              fit.phase_noise_s, fit.log_likelihood);
      },
      py::arg("phase_s"), py::arg("dt_s"), py::kw_only(), py::arg("phase_noise"),
      "(h0, h_minus_2, sigma_h0, sigma_h_minus_2, correlation, phase_noise_s, log_likelihood).");
}

}  // namespace soopnav::python
