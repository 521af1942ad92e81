#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <array>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "array.hpp"
#include "register.hpp"
#include "soopnav/clock/coherence.hpp"
#include "soopnav/dsp/detection.hpp"

namespace soopnav::python {

namespace {

py::tuple mean_squared_coherence(const RealArray<"phase_cycles">& phase, std::size_t runs, double dt_s,
                                 const std::vector<std::size_t>& samples, double confidence, bool detrend) {
  std::vector<clock::Coherence> all;
  {
    const py::gil_scoped_release release;
    all = clock::mean_squared_coherence(phase.span(), runs, dt_s, samples,
                                        {.confidence = confidence, .detrend = detrend});
  }
  std::array<std::vector<double>, 6> columns;
  std::vector<std::int64_t> count;
  for (const clock::Coherence& c : all) {
    const std::array<double, 6> row{c.tau_s, c.mean_squared, c.lower, c.upper, c.least, c.effective};
    for (std::size_t i = 0; i < row.size(); ++i) columns[i].push_back(row[i]);
    count.push_back(static_cast<std::int64_t>(c.count));
  }
  py::tuple out(7);
  for (std::size_t i = 0; i < columns.size(); ++i) out[i] = to_array(std::move(columns[i]));
  out[6] = to_array(std::move(count));
  return out;
}

// Three arrays of one size, number by number.
template <class Of>
py::array_t<double> coherence_by_three(const std::vector<int>& m, const RealArrayBase& a, const RealArrayBase& b,
                                       Of of) {
  if (m.size() != a.size() || a.size() != b.size()) throw py::value_error("arrays of one size expected");
  std::vector<double> out(a.size());
  {
    const py::gil_scoped_release release;
    for (std::size_t i = 0; i < out.size(); ++i) out[i] = of(m[i], a[i], b[i]);
  }
  return to_array(std::move(out));
}

}  // namespace

void register_coherence(py::module_& m) {
  m.def(
      "coherences",
      [](const RealArray<"phase_cycles">& phase, std::size_t samples) {
        std::vector<double> out;
        {
          const py::gil_scoped_release release;
          out = clock::coherences(phase.span(), samples);
        }
        return to_array(std::move(out));
      },
      py::arg("phase_cycles"), py::arg("samples"), "Coherence of every window of so many phases.");
  m.def(
      "remove_trend",
      [](const RealArray<"phase_cycles">& phase) {
        std::vector<double> out(phase.span().begin(), phase.span().end());
        clock::remove_trend(out);
        return to_array(std::move(out));
      },
      py::arg("phase_cycles"), "A record without its line of least squares.");
  m.def("mean_squared_coherence", &mean_squared_coherence, py::arg("phase_cycles"), py::arg("runs"), py::arg("dt_s"),
        py::arg("samples"), py::kw_only(), py::arg("confidence"), py::arg("detrend"),
        "(tau_s, mean_squared, lower, upper, least, effective, count).");
  m.def("coherence_samples", &clock::coherence_samples, py::arg("phases"), py::arg("per_decade"),
        "Numbers of samples, so many a decade.");
  m.def(
      "coherence_time",
      [](const RealArray<"tau_s">& tau_s, const RealArray<"mean_squared">& mean_squared, double level) {
        const clock::CoherenceTime time = clock::coherence_time(tau_s.span(), mean_squared.span(), level);
        return py::make_tuple(time.tau_s, time.beyond);
      },
      py::arg("tau_s"), py::arg("mean_squared"), py::arg("level"), "(tau_s, beyond).");
  m.def(
      "expected_coherence",
      [](double h0, double h_minus_2, double carrier_hz, const RealArray<"tau_s">& tau_s, double drift_sigma) {
        const auto noise = clock::ClockNoise::from_allan(h0, h_minus_2);
        std::vector<double> out;
        for (const double tau : tau_s.span()) {
          out.push_back(clock::expected_coherence(noise, carrier_hz, tau, drift_sigma));
        }
        return to_array(std::move(out));
      },
      py::arg("h0"), py::arg("h_minus_2"), py::arg("carrier_hz"), py::arg("tau_s"), py::arg("drift_sigma"),
      "Mean-squared coherence expected of a two-state clock.");
  m.def("predetection_snr_db", &clock::predetection_snr_db, py::arg("cn0_dbhz"), py::arg("tau_s"),
        py::arg("mean_squared"), "SNR after coherent integration.");
  m.def("required_cn0_dbhz", &clock::required_cn0_dbhz, py::arg("tau_s"), py::arg("mean_squared"), py::arg("snr_db"),
        "The C/N0 that gives an SNR.");
  m.def(
      "marcum_q",
      [](const std::vector<int>& orders, const RealArray<"a">& a, const RealArray<"b">& b, bool complement) {
        return coherence_by_three(orders, a, b, [complement](int order, double x, double y) {
          return complement ? dsp::marcum_q_complement(order, x, y) : dsp::marcum_q(order, x, y);
        });
      },
      py::arg("m"), py::arg("a"), py::arg("b"), py::arg("complement"), "Generalised Marcum Q, element by element.");
  m.def("false_alarm_probability", &dsp::false_alarm_probability, py::arg("sums"), py::arg("threshold"),
        "Of one cell of noise.");
  m.def("detection_threshold", &dsp::detection_threshold, py::arg("sums"), py::arg("probability"),
        "Of one cell's false alarm.");
  m.def("detection_probability", &dsp::detection_probability, py::arg("sums"), py::arg("snr"), py::arg("threshold"),
        "Of a signal's cell.");
  m.def("cell_false_alarm", &dsp::cell_false_alarm, py::arg("total"), py::arg("cells"),
        "One cell's share of a search's false alarm.");
}

}  // namespace soopnav::python
