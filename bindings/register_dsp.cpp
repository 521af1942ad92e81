#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <cstddef>
#include <cstdint>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "array.hpp"
#include "register.hpp"
#include "soopnav/dsp/correlate.hpp"
#include "soopnav/dsp/fft.hpp"
#include "soopnav/dsp/fractional_delay.hpp"
#include "soopnav/dsp/resample.hpp"

namespace soopnav::python {

namespace {

std::vector<Cf32> correlate(IqSpan iq, IqSpan kernel) {
  if (iq.size() < kernel.size()) {
    throw std::invalid_argument("iq: " + grouped(iq.size()) + " samples are fewer than the kernel's " +
                                grouped(kernel.size()));
  }
  dsp::OverlapSave filter(kernel, dsp::FilterKind::kCorrelation);
  std::vector<Cf32> out(iq.size() - kernel.size() + 1);
  filter.apply(iq, 0, out);
  return out;
}

std::vector<Cf32> convolve(IqSpan iq, IqSpan kernel) {
  dsp::OverlapSave filter(kernel, dsp::FilterKind::kConvolution);
  std::vector<Cf32> out(iq.empty() ? 0 : iq.size() + kernel.size() - 1);
  filter.apply(iq, 0, out);
  return out;
}

template <class Compute>
py::array_t<Cf32> without_gil(const Compute& compute) {
  std::vector<Cf32> out;
  {
    const py::gil_scoped_release release;
    out = compute();
  }
  return to_array(std::move(out));
}

}  // namespace

void register_dsp(py::module_& m) {
  m.def(
      "correlate",
      [](const IqArray<"iq">& iq, const IqArray<"kernel">& kernel) {
        return without_gil([&] { return correlate(iq.span(), kernel.span()); });
      },
      py::arg("iq"), py::arg("kernel"), "Correlation where the kernel lies wholly inside iq.");
  m.def(
      "convolve",
      [](const IqArray<"iq">& iq, const IqArray<"kernel">& kernel) {
        return without_gil([&] { return convolve(iq.span(), kernel.span()); });
      },
      py::arg("iq"), py::arg("kernel"), "The whole convolution.");
  m.def(
      "delay",
      [](const IqArray<"iq">& iq, double delay_samples, double passband, double attenuation_db) {
        return without_gil([&] { return dsp::delayed(iq.span(), delay_samples, {passband, attenuation_db}); });
      },
      py::arg("iq"), py::arg("delay_samples"), py::kw_only(), py::arg("passband") = 0.8,
      py::arg("attenuation_db") = 80.0, "Delay by any number of samples.");
  m.def(
      "resample",
      [](const IqArray<"iq">& iq, double in_rate_hz, double out_rate_hz, double passband, double stopband,
         double attenuation_db) {
        return without_gil([&] {
          return dsp::resample(iq.span(), in_rate_hz, out_rate_hz, {passband, stopband, attenuation_db});
        });
      },
      py::arg("iq"), py::arg("in_rate_hz"), py::arg("out_rate_hz"), py::kw_only(), py::arg("passband") = 0.8,
      py::arg("stopband") = 1.2, py::arg("attenuation_db") = 80.0, "A capture at another rate.");
  m.def("fft_library", &dsp::fft_library, "Library behind the transforms: \"fftw\" or \"eigen\".");
}

}  // namespace soopnav::python
