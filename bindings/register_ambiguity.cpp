#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <mutex>
#include <string>
#include <utility>
#include <vector>

#include "array.hpp"
#include "register.hpp"
#include "soopnav/dsp/ambiguity.hpp"

namespace soopnav::python {

namespace {

// The measuring object carries scratch: threads that share one take turns.
struct AmbiguityMeter {
  explicit AmbiguityMeter(const dsp::AmbiguityOptions& options) : caf(options) {}
  dsp::CrossAmbiguity caf;
  std::mutex mutex;
};

dsp::SpectrumShape ambiguity_shape(const std::string& shape) {
  if (shape == "flat") return dsp::SpectrumShape::kFlat;
  if (shape == "rrc") return dsp::SpectrumShape::kRaisedCosine;
  throw std::invalid_argument("shape: \"flat\" or \"rrc\" required, got \"" + shape + "\"");
}

py::tuple ambiguity_surface(AmbiguityMeter& self, const IqArray<"a">& a, const IqArray<"b">& b,
                            const RealArray<"delays_s">& delays, const RealArray<"doppler_hz">& doppler) {
  std::vector<double> cells(delays.size() * doppler.size());
  dsp::AmbiguityPeak peak;
  bool drawn = false;
  {
    const py::gil_scoped_release release;
    const std::lock_guard lock(self.mutex);
    peak = self.caf.measure(a.span(), b.span());
    drawn = self.caf.surface(delays.span(), doppler.span(), cells);
  }
  if (!drawn) cells.assign(cells.size(), 0.0);
  return py::make_tuple(peak, to_array(std::move(cells), {static_cast<py::ssize_t>(delays.size()),
                                                          static_cast<py::ssize_t>(doppler.size())}));
}

}  // namespace

void register_ambiguity(py::module_& m) {
  using dsp::AmbiguityPeak, dsp::AmbiguityPrefilter, dsp::AmbiguityStatus;
  py::enum_<AmbiguityStatus>(m, "AmbiguityStatus", "What came of a pair of recordings.")
      .value("OK", AmbiguityStatus::kOk)
      .value("NOT_DETECTED", AmbiguityStatus::kNotDetected)
      .value("TONE", AmbiguityStatus::kTone)
      .value("IDENTICAL", AmbiguityStatus::kIdentical)
      .value("TOO_SHORT", AmbiguityStatus::kTooShort)
      .value("TOO_LONG", AmbiguityStatus::kTooLong)
      .value("LENGTH_MISMATCH", AmbiguityStatus::kLengthMismatch)
      .value("NOT_FINITE", AmbiguityStatus::kNotFinite)
      .value("NO_POWER", AmbiguityStatus::kNoPower)
      .def_property_readonly("text", [](AmbiguityStatus status) { return dsp::to_string(status); });
  py::enum_<AmbiguityPrefilter>(m, "AmbiguityPrefilter", "How the recordings are filtered before they are multiplied.")
      .value("NONE", AmbiguityPrefilter::kNone)
      .value("BOX", AmbiguityPrefilter::kBox)
      .value("RRC", AmbiguityPrefilter::kRootRaisedCosine)
      .value("ML", AmbiguityPrefilter::kMaximumLikelihood);
  py::class_<AmbiguityPeak>(m, "AmbiguityPeak", "Delay and Doppler between two recordings.")
      .def_readonly("status", &AmbiguityPeak::status)
      .def_readonly("tdoa_s", &AmbiguityPeak::tdoa_s)
      .def_readonly("fdoa_hz", &AmbiguityPeak::fdoa_hz)
      .def_readonly("tdoa_rate", &AmbiguityPeak::tdoa_rate)
      .def_readonly("phase_rad", &AmbiguityPeak::phase_rad)
      .def_readonly("sigma_tdoa_s", &AmbiguityPeak::sigma_tdoa_s)
      .def_readonly("sigma_fdoa_hz", &AmbiguityPeak::sigma_fdoa_hz)
      .def_readonly("sigma_tdoa_rate", &AmbiguityPeak::sigma_tdoa_rate)
      .def_readonly("correlation", &AmbiguityPeak::correlation)
      .def_readonly("epoch_s", &AmbiguityPeak::epoch_s)
      .def_readonly("start_s", &AmbiguityPeak::start_s)
      .def_readonly("duration_s", &AmbiguityPeak::duration_s)
      .def_readonly("center_a_hz", &AmbiguityPeak::center_a_hz)
      .def_readonly("center_b_hz", &AmbiguityPeak::center_b_hz)
      .def_readonly("bandwidth_hz", &AmbiguityPeak::bandwidth_hz)
      .def_readonly("snr_db", &AmbiguityPeak::snr_db)
      .def_readonly("threshold_db", &AmbiguityPeak::threshold_db)
      .def_readonly("snr_a_db", &AmbiguityPeak::snr_a_db)
      .def_readonly("snr_b_db", &AmbiguityPeak::snr_b_db)
      .def_readonly("coherence", &AmbiguityPeak::coherence)
      .def_readonly("tones", &AmbiguityPeak::tones);
  py::class_<AmbiguityMeter>(m, "CrossAmbiguity", "Cross-ambiguity of pairs of recordings, plans made once.")
      .def(py::init([](double sample_rate_hz, std::size_t max_samples, double max_delay_s, double max_doppler_hz,
                       double delay_center_s, double doppler_center_hz, double bandwidth_hz, double center_a_hz,
                       double center_b_hz, double symbol_rate_hz, double rolloff, AmbiguityPrefilter prefilter,
                       double false_alarm, double carrier_hz, double tdoa_rate, bool estimate_rate,
                       double max_tdoa_rate, bool reject_tones) {
             const dsp::AmbiguityOptions options{
                 sample_rate_hz, max_samples, max_delay_s, max_doppler_hz, delay_center_s, doppler_center_hz,
                 bandwidth_hz,   center_a_hz, center_b_hz, symbol_rate_hz, rolloff,        prefilter,
                 false_alarm,    carrier_hz,  tdoa_rate,   estimate_rate,  max_tdoa_rate,  reject_tones};
             const py::gil_scoped_release release;
             return std::make_unique<AmbiguityMeter>(options);
           }),
           py::kw_only(), py::arg("sample_rate_hz"), py::arg("max_samples"), py::arg("max_delay_s"),
           py::arg("max_doppler_hz"), py::arg("delay_center_s"), py::arg("doppler_center_hz"), py::arg("bandwidth_hz"),
           py::arg("center_a_hz"), py::arg("center_b_hz"), py::arg("symbol_rate_hz"), py::arg("rolloff"),
           py::arg("prefilter"), py::arg("false_alarm"), py::arg("carrier_hz"), py::arg("tdoa_rate"),
           py::arg("estimate_rate"), py::arg("max_tdoa_rate"), py::arg("reject_tones"))
      .def_property_readonly("min_samples", [](const AmbiguityMeter& self) { return self.caf.min_samples(); })
      .def(
          "measure",
          [](AmbiguityMeter& self, const IqArray<"a">& a, const IqArray<"b">& b) {
            const py::gil_scoped_release release;
            const std::lock_guard lock(self.mutex);
            return self.caf.measure(a.span(), b.span());
          },
          py::arg("a"), py::arg("b"), "Delay and Doppler of a against b.")
      .def("surface", &ambiguity_surface, py::arg("a"), py::arg("b"), py::arg("delays_s"), py::arg("doppler_hz"),
           "The same, and |C|^2 over a grid.");
  const auto bound = [&m](const char* name, auto function, const char* text) {
    m.def(
        name,
        [function](double bandwidth_hz, double duration_s, double snr_a, double snr_b, const std::string& shape,
                   double rolloff) {
          const dsp::TdoaFdoaBound b =
              function(bandwidth_hz, duration_s, snr_a, snr_b, ambiguity_shape(shape), rolloff);
          return std::pair{b.sigma_tdoa_s, b.sigma_fdoa_hz};
        },
        py::arg("bandwidth_hz"), py::arg("duration_s"), py::arg("snr_a"), py::arg("snr_b"), py::arg("shape"),
        py::arg("rolloff"), text);
  };
  bound("stein_bound", &dsp::stein_bound, "Stein's bound of TDOA and FDOA.");
  bound("stochastic_bound", &dsp::stochastic_bound, "The bound for an unknown Gaussian signal.");
}

}  // namespace soopnav::python
