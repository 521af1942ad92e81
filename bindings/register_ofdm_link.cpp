#include <pybind11/complex.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <array>
#include <complex>
#include <cstdint>
#include <cstdio>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "array.hpp"
#include "ofdm_options.hpp"
#include "register.hpp"
#include "soopnav/simulation/ofdm_link.hpp"
#include "soopnav/simulation/ricean_reflector.hpp"

namespace soopnav::python {

namespace {

using simulation::BoundarySeries;
using simulation::OfdmLink;
using simulation::Reflection;

/// A link that several Python threads may hold: calls wait for each other.
struct SharedLink {
  SharedLink(const ofdm::Numerology& numerology, int symbols, const simulation::OfdmLinkOptions& options)
      : link(numerology, symbols, options) {}
  std::mutex mutex;
  OfdmLink link;
};

std::vector<Reflection> reflections_of(const std::optional<std::vector<double>>& extra_m,
                                       const std::optional<std::vector<std::complex<double>>>& gain,
                                       std::size_t epochs) {
  if (!extra_m && !gain) return {};
  if (!extra_m || !gain) {
    throw std::invalid_argument("reflection_extra_m, reflection_gain: both or neither must be given");
  }
  if (extra_m->size() != epochs || gain->size() != epochs) {
    throw std::invalid_argument("reflection_extra_m, reflection_gain: " + grouped(extra_m->size()) + " and " +
                                grouped(gain->size()) + " elements; as many as delay_m has, " + grouped(epochs) +
                                ", are expected");
  }
  std::vector<Reflection> out(epochs);
  for (std::size_t e = 0; e < epochs; ++e) out[e] = {(*extra_m)[e], (*gain)[e]};
  return out;
}

struct Series {
  BoundarySeries rows;
  std::vector<std::uint8_t> status;
  std::size_t width = 0;
};

}  // namespace

void register_ofdm_link(py::module_& m) {
  py::class_<Series>(m, "BoundarySeries", "What the measured epochs of an OfdmLink gave, a row per epoch. Read-only.")
      .def_property_readonly(
          "range_m",
          [](const py::object& self) { return view_array<double>(self.cast<const Series&>().rows.range_m, self); },
          "In 0 ... ambiguity, shape (epochs,).")
      .def_property_readonly(
          "sigma_m",
          [](const py::object& self) { return view_array<double>(self.cast<const Series&>().rows.sigma_m, self); },
          "Standard deviation of each, reflections not counted; shape (epochs,).")
      .def_property_readonly(
          "metric",
          [](const py::object& self) { return view_array<double>(self.cast<const Series&>().rows.metric, self); },
          "|gamma| / Phi at the boundary, shape (epochs,).")
      .def_property_readonly(
          "status",
          [](const py::object& self) { return view_array<std::uint8_t>(self.cast<const Series&>().status, self); },
          "Values of ofdm.BoundaryStatus, shape (epochs,), uint8.")
      .def_property_readonly(
          "folded",
          [](const py::object& self) -> std::optional<py::array_t<double>> {
            const auto& series = self.cast<const Series&>();
            if (series.width == 0) return std::nullopt;
            return view_array<double>(
                series.rows.folded, self,
                {static_cast<py::ssize_t>(series.rows.range_m.size()), static_cast<py::ssize_t>(series.width)});
          },
          "Folded differences, shape (epochs, M), or None.")
      .def("__len__", [](const Series& s) { return s.rows.range_m.size(); })
      .def("__repr__", [](const Series& s) { return "BoundarySeries(" + grouped(s.rows.range_m.size()) + " epochs)"; });

  py::class_<SharedLink>(
      m, "OfdmLink",
      "One OFDM transmitter as a receiver hears it: fresh symbols each epoch, moved by the path's "
      "length, with a\nreflection, white noise and a carrier offset. The longer the path, the larger "
      "the boundary.")
      .def(py::init([](const ofdm::Numerology& numerology, int symbols, int oversampling, const std::string& movement,
                       const std::string& constellation, double cfo_hz, bool band_limited_noise) {
             const simulation::OfdmLinkOptions options{oversampling, movement_of(movement),
                                                       constellation_of(constellation), cfo_hz, band_limited_noise};
             return std::make_unique<SharedLink>(numerology, symbols, options);
           }),
           py::arg_v("numerology", ofdm::Numerology{}, "soopnav_cpp._core.ofdm.Numerology()"), py::arg("symbols") = 250,
           py::kw_only(), py::arg("oversampling") = 1, py::arg("movement") = "interpolate_and_shift",
           py::arg("constellation") = "qpsk", py::arg("cfo_hz") = 0.0, py::arg("band_limited_noise") = false,
           "oversampling: 1, or 15 for a receiver that takes all fine samples. movement: \"interpolate_and_shift\" by\n"
           "floor(delay / fine sample) fine samples of c / (15 f_s), or \"fractional_delay\", exact for any real "
           "delay.\n"
           "constellation: \"qpsk\", \"16qam\" or \"64qam\". band_limited_noise: made at the critical rate and\n"
           "interpolated. Raises ValueError for what cannot be.")
      .def_property_readonly("numerology", [](const SharedLink& self) { return self.link.numerology(); })
      .def_property_readonly("symbols", [](const SharedLink& self) { return self.link.symbols(); })
      .def_property_readonly("oversampling", [](const SharedLink& self) { return self.link.options().oversampling; })
      .def(
          "iq",
          [](SharedLink& self, double delay_m, std::uint64_t seed, std::uint64_t stream, std::optional<double> snr_db,
             std::optional<std::pair<double, std::complex<double>>> reflection) {
            std::vector<Cf32> out(self.link.epoch_samples());
            std::optional<Reflection> ray;
            if (reflection) ray = Reflection{reflection->first, reflection->second};
            {
              const py::gil_scoped_release release;
              const std::scoped_lock lock(self.mutex);
              self.link.epoch(delay_m, RandomStream(seed, stream), out, snr_db, ray);
            }
            return to_array(std::move(out));
          },
          py::arg("delay_m"), py::kw_only(), py::arg("seed"), py::arg("stream") = 0, py::arg("snr_db") = py::none(),
          py::arg("reflection") = py::none(),
          "The samples of one epoch, complex64, shape (symbols + 1) M oversampling. snr_db: per sample of the "
          "receiver;\n"
          "None for no noise. reflection: extra path [m] and complex gain over the line of sight.")
      .def(
          "measure",
          [](SharedLink& self, const RealArray<"delay_m">& delay_m, const std::string& method, std::uint64_t seed,
             std::uint64_t stream, std::optional<double> snr_db,
             const std::optional<std::vector<double>>& reflection_extra_m,
             const std::optional<std::vector<std::complex<double>>>& reflection_gain, bool folded, int threads) {
            OfdmLink::Measure how;
            how.method = boundary_method_of(method);
            how.snr_db = snr_db;
            how.folded = folded;
            how.threads = threads;
            const auto reflections = reflections_of(reflection_extra_m, reflection_gain, delay_m.size());
            auto series = std::make_unique<Series>();
            const py::gil_scoped_release release;
            const std::scoped_lock lock(self.mutex);
            series->rows = self.link.measure(delay_m.span(), reflections, RandomStream(seed, stream), how);
            series->status.reserve(series->rows.status.size());
            for (const auto status : series->rows.status) series->status.push_back(static_cast<std::uint8_t>(status));
            if (folded) {
              series->width = static_cast<std::size_t>(self.link.numerology().symbol_samples()) *
                              static_cast<std::size_t>(self.link.options().oversampling);
            }
            return series;
          },
          py::arg("delay_m"), py::kw_only(), py::arg("method") = "nearest_sample", py::arg("seed"),
          py::arg("stream") = 0, py::arg("snr_db") = py::none(), py::arg("reflection_extra_m") = py::none(),
          py::arg("reflection_gain") = py::none(), py::arg("folded") = false, py::arg("threads") = 1,
          "Simulates and measures an epoch per element of delay_m, shape (epochs,): the same bits for any number of\n"
          "threads. method as of ofdm.BoundaryEstimator. reflection_extra_m and reflection_gain: shape (epochs,), a "
          "gain\n"
          "of 0 is no reflection. folded: keep the folded differences, which ofdm.TwoRayTiming takes.")
      .def("__repr__", [](const SharedLink& self) {
        return "OfdmLink(symbols=" + std::to_string(self.link.symbols()) +
               ", oversampling=" + std::to_string(self.link.options().oversampling) + ")";
      });
  m.def(
      "ricean_reflections",
      [](const Table<"receivers_m">& receivers_m, const RealArray<"transmitter_m">& transmitter_m,
         const RealArray<"reflector_m">& reflector_m, double mean, double variance, std::uint64_t seed,
         std::uint64_t stream) {
        const auto point = [&](const char* name, std::span<const double> numbers) {
          if (numbers.size() != receivers_m.columns() || numbers.size() < 2 || numbers.size() > 3) {
            throw std::invalid_argument(std::string(name) +
                                        ": as many numbers as receivers_m has columns, 2 or 3, expected");
          }
          return Eigen::Vector3d(numbers[0], numbers[1], numbers.size() > 2 ? numbers[2] : 0.0);
        };
        const Eigen::Vector3d transmitter = point("transmitter_m", transmitter_m.span());
        const simulation::RiceanReflector reflector{point("reflector_m", reflector_m.span()), mean, variance};
        std::vector<Eigen::Vector3d> receivers;
        for (std::size_t i = 0; i < receivers_m.rows(); ++i)
          receivers.push_back(point("receivers_m", receivers_m.row(i)));
        std::vector<double> extra;
        std::vector<std::complex<double>> gain;
        for (const Reflection& ray : reflector.reflections(receivers, transmitter, RandomStream(seed, stream))) {
          extra.push_back(ray.extra_m);
          gain.push_back(ray.gain);
        }
        return py::make_tuple(to_array(std::move(extra)), to_array(std::move(gain)));
      },
      py::arg("receivers_m"), py::arg("transmitter_m"), py::arg("reflector_m"), py::kw_only(), py::arg("mean") = 0.33,
      py::arg("variance") = 0.0625, py::arg("seed"), py::arg("stream") = 0,
      "Extra path [m] and complex gain over the line of sight of a Ricean reflection at each place.");
}

}  // namespace soopnav::python
