#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <cstddef>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "array.hpp"
#include "register.hpp"
#include "soopnav/clock/characterization.hpp"
#include "soopnav/clock/clock_group.hpp"
#include "soopnav/clock/noise_bank.hpp"

namespace soopnav::python {

namespace {

using clock::Oscillator;
using clock::PhaseModel;

// Sizes are refused by the engine; here the tables only have to fit its arrays.
PhaseModel characterization_model(double dt_s, const Table<"phase_covariance_s2">& covariance,
                                  const Table<"mixing">& mixing) {
  PhaseModel model;
  model.dt_s = dt_s;
  model.channels = mixing.rows();
  model.clocks = mixing.columns();
  if (model.channels < 1 || model.channels > PhaseModel::kMaxChannels || model.clocks < 1 ||
      model.clocks > PhaseModel::kMaxClocks) {
    throw py::value_error("mixing: 1 ... 3 records of 1 ... 4 clocks expected, got (" + std::to_string(mixing.rows()) +
                          ", " + std::to_string(mixing.columns()) + ")");
  }
  if (covariance.rows() != model.channels || covariance.columns() != model.channels) {
    throw py::value_error("phase_covariance_s2: (" + std::to_string(model.channels) + ", " +
                          std::to_string(model.channels) + ") expected");
  }
  for (std::size_t i = 0; i < model.channels; ++i) {
    std::ranges::copy(mixing.row(i), model.mixing.begin() + static_cast<std::ptrdiff_t>(i * model.clocks));
    std::ranges::copy(covariance.row(i), model.covariance_s2.begin() + static_cast<std::ptrdiff_t>(i * model.channels));
  }
  return model;
}

std::vector<Oscillator> characterization_clocks(const Table<"clocks">& clocks) {
  if (clocks.rows() > 0 && clocks.columns() != 2) throw py::value_error("clocks: rows of (h0, h_minus_2) expected");
  std::vector<Oscillator> out;
  for (std::size_t i = 0; i < clocks.rows(); ++i) {
    out.push_back({.h0 = clocks.row(i)[0], .h_minus_2 = clocks.row(i)[1]});
  }
  return out;
}

py::array_t<double> characterization_pairs(std::span<const Oscillator> clocks, std::vector<py::ssize_t> shape = {}) {
  std::vector<double> out;
  for (const Oscillator& clock : clocks) {
    out.push_back(clock.h0);
    out.push_back(clock.h_minus_2);
  }
  if (shape.empty()) shape = {static_cast<py::ssize_t>(clocks.size()), 2};
  return to_array(std::move(out), std::move(shape));
}

py::array_t<double> characterization_square(std::vector<double>&& values, std::size_t n) {
  const auto size = static_cast<py::ssize_t>(n);
  return to_array(std::move(values), {size, size});
}

py::tuple phase_likelihood(const Numbers<"phase_s">& phase_s, double dt_s,
                           const Table<"phase_covariance_s2">& covariance, const Table<"mixing">& mixing,
                           const Table<"clocks">& clocks, const std::vector<std::size_t>& estimated) {
  const PhaseModel model = characterization_model(dt_s, covariance, mixing);
  const auto given = characterization_clocks(clocks);
  clock::PhaseScore at;
  {
    const py::gil_scoped_release release;
    at = clock::PhaseLikelihood(phase_s.span(), model).evaluate(given, estimated);
  }
  return py::make_tuple(at.log_likelihood, to_array(std::move(at.score)),
                        characterization_square(std::move(at.information), 2 * estimated.size()), at.mean_nis,
                        at.largest_nis, at.largest_at);
}

py::dict characterize(const Numbers<"phase_s">& phase_s, double dt_s, const Table<"phase_covariance_s2">& covariance,
                      const Table<"mixing">& mixing, const Table<"clocks">& clocks,
                      const std::vector<std::size_t>& estimated, bool search) {
  const PhaseModel model = characterization_model(dt_s, covariance, mixing);
  const auto given = characterization_clocks(clocks);
  clock::CharacterizationResult found;
  std::size_t skipped = 0;
  {
    const py::gil_scoped_release release;
    const clock::PhaseLikelihood likelihood(phase_s.span(), model);
    skipped = likelihood.skipped();
    found = clock::characterize(likelihood, given, estimated, search);
  }
  const std::size_t n = 2 * estimated.size();
  std::vector<bool> identifiable = found.identifiable;
  py::list alternatives;
  for (const auto& other : found.alternatives) {
    alternatives.append(py::make_tuple(characterization_pairs(other.clocks), other.log_likelihood));
  }
  py::dict out;
  out["clocks"] = characterization_pairs(found.best.clocks);
  out["log_likelihood"] = found.best.log_likelihood;
  out["iterations"] = found.best.iterations;
  out["converged"] = found.best.converged;
  out["alternatives"] = alternatives;
  out["information"] = characterization_square(std::move(found.information), n);
  out["ln_covariance"] = characterization_square(std::move(found.ln_covariance), n);
  out["identifiable"] = py::cast(identifiable);
  out["directions"] = characterization_square(std::move(found.directions), n);
  out["direction_sigma"] = to_array(std::move(found.direction_sigma));
  out["mean_nis"] = found.mean_nis;
  out["largest_nis"] = found.largest_nis;
  out["largest_at"] = found.largest_at;
  out["jumped"] = found.jumped;
  out["skipped"] = skipped;
  return out;
}

py::tuple estimate_clocks(const Numbers<"phase_s">& phase_s, double dt_s,
                          const Table<"phase_covariance_s2">& covariance, const Table<"mixing">& mixing,
                          const Table<"clocks">& clocks) {
  const PhaseModel model = characterization_model(dt_s, covariance, mixing);
  const auto given = characterization_clocks(clocks);
  clock::ClockGroupRun run;
  {
    const py::gil_scoped_release release;
    run = clock::ClockGroup(model, given).run(phase_s.span());
  }
  const std::vector<py::ssize_t> shape{static_cast<py::ssize_t>(run.epochs), static_cast<py::ssize_t>(run.clocks)};
  return py::make_tuple(to_array(std::move(run.filtered_s), shape), to_array(std::move(run.filtered_sigma_s), shape),
                        to_array(std::move(run.bias_s), shape), to_array(std::move(run.drift), shape),
                        to_array(std::move(run.sigma_s), shape));
}

py::array_t<double> error_allan_variance(double dt_s, const Table<"phase_covariance_s2">& covariance,
                                         const Table<"mixing">& mixing, const Table<"clocks">& clocks,
                                         std::size_t clock_index, const std::vector<std::size_t>& factors,
                                         std::size_t epochs) {
  const PhaseModel model = characterization_model(dt_s, covariance, mixing);
  const auto given = characterization_clocks(clocks);
  std::vector<double> out;
  {
    const py::gil_scoped_release release;
    out = clock::ClockGroup(model, given).error_allan_variance(clock_index, factors, epochs);
  }
  return to_array(std::move(out));
}

py::array_t<double> iterate_noise(const Numbers<"phase_s">& phase_s, double dt_s,
                                  const Table<"phase_covariance_s2">& covariance, const Table<"mixing">& mixing,
                                  const Table<"clocks">& clocks, const std::vector<std::size_t>& estimated,
                                  bool allan_fit, int iterations) {
  const PhaseModel model = characterization_model(dt_s, covariance, mixing);
  const auto given = characterization_clocks(clocks);
  std::vector<Oscillator> history;
  {
    const py::gil_scoped_release release;
    history = clock::iterate_noise(phase_s.span(), model, given, estimated,
                                   allan_fit ? clock::NoiseAnalysis::kAllanFit : clock::NoiseAnalysis::kIncrements,
                                   iterations);
  }
  const auto clocks_each = static_cast<py::ssize_t>(given.size());
  return characterization_pairs(history, {static_cast<py::ssize_t>(history.size()) / clocks_each, clocks_each, 2});
}

}  // namespace

void register_characterization(py::module_& m) {
  m.def("phase_likelihood", &phase_likelihood, py::arg("phase_s"), py::arg("dt_s"), py::arg("phase_covariance_s2"),
        py::arg("mixing"), py::arg("clocks"), py::arg("estimated"),
        "(log_likelihood, score, information, mean_nis, largest_nis, largest_at) of clocks in phase records.");
  m.def("characterize", &characterize, py::arg("phase_s"), py::arg("dt_s"), py::arg("phase_covariance_s2"),
        py::arg("mixing"), py::arg("clocks"), py::arg("estimated"), py::arg("search"),
        "Noise of clocks by maximum likelihood, by name.");
  m.def("estimate_clocks", &estimate_clocks, py::arg("phase_s"), py::arg("dt_s"), py::arg("phase_covariance_s2"),
        py::arg("mixing"), py::arg("clocks"),
        "(filtered_s, filtered_sigma_s, bias_s, drift, sigma_s), each (epochs, clocks).");
  m.def("error_allan_variance", &error_allan_variance, py::arg("dt_s"), py::arg("phase_covariance_s2"),
        py::arg("mixing"), py::arg("clocks"), py::arg("clock"), py::arg("factors"), py::arg("epochs"),
        "Allan variance of a smoothed clock's error at averaging times of `factors` steps.");
  m.def("iterate_noise", &iterate_noise, py::arg("phase_s"), py::arg("dt_s"), py::arg("phase_covariance_s2"),
        py::arg("mixing"), py::arg("clocks"), py::arg("estimated"), py::kw_only(), py::arg("allan_fit"),
        py::arg("iterations"), "History of pesyna fig. 2's iteration, (iterations + 1, clocks, 2).");
  py::class_<clock::NoiseBank>(m, "NoiseBank", "Candidate noises weighted by the likelihood of their innovations.")
      .def(py::init([](double dt_s, const Table<"phase_covariance_s2">& covariance, const Table<"mixing">& mixing,
                       const Table<"clocks">& candidates, const RealArray<"prior">& prior) {
             return clock::NoiseBank(characterization_model(dt_s, covariance, mixing),
                                     characterization_clocks(candidates), prior.span());
           }),
           py::arg("dt_s"), py::arg("phase_covariance_s2"), py::arg("mixing"), py::arg("candidates"), py::arg("prior"))
      .def(
          "push",
          [](clock::NoiseBank& bank, const Numbers<"phase_s">& phase_s) {
            const std::size_t each = bank.model().channels;
            if (phase_s.span().size() % each != 0) {
              throw py::value_error("phase_s: whole epochs of " + std::to_string(each) + " phases expected");
            }
            const py::gil_scoped_release release;
            std::size_t used = 0;
            for (std::size_t k = 0; k < phase_s.span().size(); k += each) {
              used += bank.push(phase_s.span().subspan(k, each)) ? 1U : 0U;
            }
            return used;
          },
          py::arg("phase_s"), "Epochs, one or more; how many of them were whole.")
      .def_property_readonly("innovations", &clock::NoiseBank::innovations, "Whole epochs so far, less two.")
      .def_property_readonly(
          "weights",
          [](const clock::NoiseBank& bank) {
            return to_array(std::vector<double>(bank.weights().begin(), bank.weights().end()));
          },
          "Posterior probability of each candidate.")
      .def_property_readonly(
          "log_likelihoods",
          [](const clock::NoiseBank& bank) {
            return to_array(std::vector<double>(bank.log_likelihoods().begin(), bank.log_likelihoods().end()));
          },
          "Of each candidate, without its prior.");
}

}  // namespace soopnav::python
