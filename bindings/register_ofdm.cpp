#include <pybind11/complex.h>
#include <pybind11/native_enum.h>
#include <pybind11/numpy.h>
#include <pybind11/operators.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <array>
#include <complex>
#include <cstdint>
#include <cstdio>
#include <memory>
#include <mutex>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "array.hpp"
#include "ofdm_options.hpp"
#include "register.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/waveform/ofdm/boundary.hpp"
#include "soopnav/waveform/ofdm/correlator.hpp"
#include "soopnav/waveform/ofdm/synthesis.hpp"
#include "soopnav/waveform/ofdm/two_ray.hpp"

namespace soopnav::python {

namespace {

using ofdm::Boundary;
using ofdm::BoundaryMethod;
using ofdm::BoundaryStatus;
using ofdm::Numerology;
using ofdm::TwoRayBoundary;

template <class... Values>
std::string format(const char* pattern, Values... values) {
  std::array<char, 256> text{};
  std::snprintf(text.data(), text.size(), pattern, values...);
  return text.data();
}

template <class Enum, std::size_t N>
Enum of_word(const char* name, const std::string& word, const std::array<std::pair<const char*, Enum>, N>& words) {
  std::string known;
  for (const auto& [text, value] : words) {
    if (word == text) return value;
    known += (known.empty() ? "\"" : ", \"") + std::string(text) + "\"";
  }
  throw std::invalid_argument(std::string(name) + ": \"" + word + "\"; it must be one of " + known);
}

constexpr std::array<std::pair<const char*, BoundaryMethod>, 4> kMethods{
    {{"nearest_sample", BoundaryMethod::kNearestSample},
     {"magnitude", BoundaryMethod::kMagnitude},
     {"maximum_likelihood", BoundaryMethod::kMaximumLikelihood},
     {"interpolated", BoundaryMethod::kInterpolated}}};

/// An estimator that several Python threads may hold: calls wait for each other.
template <class Estimator>
struct Shared {
  template <class... Arguments>
  explicit Shared(const Arguments&... arguments) : estimator(arguments...) {}
  std::mutex mutex;
  Estimator estimator;
};

using SharedEstimator = Shared<ofdm::BoundaryEstimator>;
using SharedTiming = Shared<ofdm::TwoRayTiming>;

std::vector<std::complex<double>> correlate(IqSpan iq, const Numerology& numerology, int symbols, int oversampling) {
  ofdm::CyclicPrefixCorrelator correlator(numerology, symbols, oversampling);
  const auto status = correlator.fold(iq, false);
  if (status == BoundaryStatus::kTooShort) {
    throw std::invalid_argument("iq: " + grouped(iq.size()) + " samples are too few; " +
                                grouped(correlator.required_samples()) + " are needed");
  }
  if (status == BoundaryStatus::kNonFinite) {
    const auto index = first_non_finite(iq);
    throw std::invalid_argument(index ? "iq: sample " + grouped(*index) + " is not finite"
                                      : "iq: samples too large to be squared in single precision");
  }
  const auto gamma = correlator.gamma();
  return {gamma.begin(), gamma.end()};
}

void register_numerology(py::module_& m) {
  py::class_<Numerology>(m, "Numerology",
                         "The grid of an OFDM signal: N subcarriers, all with data, and a prefix of v samples. "
                         "Read-only.")
      .def(py::init([](int subcarriers, int prefix, double sample_rate_hz) {
             const Numerology numerology{subcarriers, prefix, sample_rate_hz};
             ofdm::check(numerology);
             return numerology;
           }),
           py::arg("subcarriers") = 64, py::arg("prefix") = 16, py::arg("sample_rate_hz") = 20e6,
           "Raises ValueError unless subcarriers is 2 ... 65536, prefix 1 ... subcarriers - 1, and the rate positive.")
      .def_readonly("subcarriers", &Numerology::subcarriers, "N.")
      .def_readonly("prefix", &Numerology::prefix, "v, samples of the cyclic prefix.")
      .def_readonly("sample_rate_hz", &Numerology::sample_rate_hz, "Critical: the subcarriers fill it.")
      .def_property_readonly("symbol_samples", &Numerology::symbol_samples, "M = N + v.")
      .def_property_readonly("symbol_s", &Numerology::symbol_s, "Duration of a symbol.")
      .def_property_readonly("sample_m", &Numerology::sample_m, "c / sample_rate_hz.")
      .def_property_readonly("ambiguity_m", &Numerology::ambiguity_m, "c symbol_s: ranges are known modulo this.")
      .def(py::self == py::self)
      .def("__hash__",
           [](const Numerology& n) { return py::hash(py::make_tuple(n.subcarriers, n.prefix, n.sample_rate_hz)); })
      .def(py::pickle([](const Numerology& n) { return py::make_tuple(n.subcarriers, n.prefix, n.sample_rate_hz); },
                      [](const py::tuple& t) {
                        const Numerology numerology{t[0].cast<int>(), t[1].cast<int>(), t[2].cast<double>()};
                        ofdm::check(numerology);
                        return numerology;
                      }))
      .def("__repr__", [](const Numerology& n) {
        return format("Numerology(subcarriers=%d, prefix=%d, sample_rate_hz=%g)", n.subcarriers, n.prefix,
                      n.sample_rate_hz);
      });
}

void register_boundary(py::module_& m) {
  py::native_enum<BoundaryStatus>(m, "BoundaryStatus", "enum.IntEnum", "What became of one epoch's samples.")
      .value("OK", BoundaryStatus::kOk)
      .value("TOO_SHORT", BoundaryStatus::kTooShort)
      .value("NON_FINITE", BoundaryStatus::kNonFinite)
      .value("NO_SIGNAL", BoundaryStatus::kNoSignal)
      .value("NO_BOUNDARY", BoundaryStatus::kNoBoundary)
      .finalize();

  py::class_<Boundary>(m, "Boundary", "Where symbols start in an epoch's samples. Read-only.")
      .def_readonly("status", &Boundary::status, "Anything but OK leaves every number zero.")
      .def_readonly("boundary_samples", &Boundary::boundary_samples, "In 0 ... M, the receiver's own samples.")
      .def_readonly("sigma_samples", &Boundary::sigma_samples, "Its standard deviation.")
      .def_readonly("boundary_m", &Boundary::boundary_m, "Offset taken out, in 0 ... ambiguity; grows with the path.")
      .def_readonly("sigma_m", &Boundary::sigma_m, "Its standard deviation.")
      .def_readonly("cfo_hz", &Boundary::cfo_hz, "Carrier offset, positive when the signal lies above.")
      .def_readonly("metric", &Boundary::metric, "|gamma| / Phi: 1 without noise, SNR / (1 + SNR) on average.")
      .def_readonly("snr_db", &Boundary::snr_db, "Per sample.")
      .def("__repr__", [](const Boundary& b) {
        if (b.status != BoundaryStatus::kOk) return "Boundary(" + std::string(to_string(b.status)) + ")";
        return format("Boundary(%.3f +- %.3f m, boundary_samples=%.4f, cfo_hz=%+.1f, metric=%.3f, snr_db=%.1f)",
                      b.boundary_m, b.sigma_m, b.boundary_samples, b.cfo_hz, b.metric, b.snr_db);
      });

  py::class_<SharedEstimator>(m, "BoundaryEstimator", "Blind estimator of the symbol boundary, with its tables kept.")
      .def(
          py::init([](const Numerology& numerology, int symbols, int oversampling, const std::string& method,
                      std::optional<double> snr_db) {
            const ofdm::BoundaryOptions options{boundary_method_of(method), snr_db};
            const py::gil_scoped_release release;
            return std::make_unique<SharedEstimator>(numerology, symbols, oversampling, options);
          }),
          py::arg_v("numerology", Numerology{}, "Numerology()"), py::arg("symbols") = 250, py::kw_only(),
          py::arg("oversampling") = 1, py::arg("method") = "nearest_sample", py::arg("snr_db") = py::none(),
          "method: \"nearest_sample\" (argmax of Re gamma), \"magnitude\" (of |gamma|), \"maximum_likelihood\" (with "
          "the energy term) or\n"
          "\"interpolated\" (between samples; critical sampling, at most 256 samples per symbol). snr_db, per sample,\n"
          "when it is known; otherwise it is estimated. Raises ValueError for what cannot be.")
      .def(
          "estimate",
          [](SharedEstimator& self, const IqArray<"iq">& iq) {
            const py::gil_scoped_release release;
            const std::scoped_lock lock(self.mutex);
            return self.estimator.estimate(iq.span());
          },
          py::arg("iq"), "The boundary in the first required_samples of iq: complex64, shape (n,).")
      .def(
          "folded_differences",
          [](SharedEstimator& self) {
            const std::scoped_lock lock(self.mutex);
            std::vector<double> out(self.estimator.correlator().period());
            self.estimator.folded_differences(out);
            return to_array(std::move(out));
          },
          "Of the last estimate: sum over the symbols of |y(i) - y(i + N)|^2 over the mean power, shape (M,).")
      .def_property_readonly("required_samples",
                             [](const SharedEstimator& self) { return self.estimator.required_samples(); })
      .def_property_readonly(
          "offset_samples", [](const SharedEstimator& self) { return self.estimator.offset_samples(); },
          "Where the method finds a signal of delay 0; boundary_m has it taken out.")
      .def("__repr__", [](const SharedEstimator& self) {
        const auto& correlator = self.estimator.correlator();
        return format("BoundaryEstimator(symbols=%zu, oversampling=%d, method=\"%s\")", correlator.symbols(),
                      correlator.oversampling(), word_of(self.estimator.options().method));
      });
}

void register_two_ray(py::module_& m) {
  py::class_<TwoRayBoundary>(m, "TwoRayBoundary", "Line of sight beside one reflection. Read-only.")
      .def_readonly("status", &TwoRayBoundary::status)
      .def_readonly("range_m", &TwoRayBoundary::range_m, "Line of sight, near the prediction, not wrapped.")
      .def_readonly("sigma_m", &TwoRayBoundary::sigma_m, "Its standard deviation.")
      .def_readonly("extra_m", &TwoRayBoundary::extra_m, "What the reflected path is longer by, in 0 ... ambiguity.")
      .def_readonly("strength", &TwoRayBoundary::strength, "Amplitude of the reflection over the line of sight's.")
      .def_readonly("likelihood_ratio", &TwoRayBoundary::likelihood_ratio, "Of two rays over one, a discounted log.")
      .def_readonly("two_rays", &TwoRayBoundary::two_rays, "Whether a second ray is wanted.")
      .def("__repr__", [](const TwoRayBoundary& b) {
        if (b.status != BoundaryStatus::kOk) return "TwoRayBoundary(" + std::string(to_string(b.status)) + ")";
        if (!b.two_rays) return format("TwoRayBoundary(%.3f +- %.3f m, one ray)", b.range_m, b.sigma_m);
        return format("TwoRayBoundary(%.3f +- %.3f m, extra_m=%.2f, strength=%.2f)", b.range_m, b.sigma_m, b.extra_m,
                      b.strength);
      });

  py::class_<SharedTiming>(m, "TwoRayTiming", "Times of two rays from an epoch's folded differences.")
      .def(py::init([](const Numerology& numerology, int symbols, double reach_samples, double snr_db,
                       double sigma_floor_m) {
             const ofdm::TwoRayOptions options{reach_samples, snr_db, sigma_floor_m};
             return std::make_unique<SharedTiming>(numerology, symbols, options);
           }),
           py::arg_v("numerology", Numerology{}, "Numerology()"), py::arg("symbols") = 250, py::kw_only(),
           py::arg("reach_samples") = 3.0, py::arg("snr_db") = 30.0, py::arg("sigma_floor_m") = 1.5,
           "reach_samples: the line of sight lies so close to its prediction. snr_db: per sample. sigma_floor_m: of\n"
           "two rays. Raises ValueError for what cannot be.")
      .def(
          "estimate",
          [](SharedTiming& self, const RealArray<"folded">& folded, double predicted_m, double sigma_m) {
            const py::gil_scoped_release release;
            const std::scoped_lock lock(self.mutex);
            return self.estimator.estimate(folded.span(), predicted_m, sigma_m);
          },
          py::arg("folded"), py::arg("predicted_m"), py::arg("sigma_m"),
          "folded: shape (M,), as of BoundaryEstimator.folded_differences; predicted_m and sigma_m of the line of "
          "sight.");
}

}  // namespace

ofdm::Constellation constellation_of(const std::string& word) {
  return of_word("constellation", word,
                 std::array<std::pair<const char*, ofdm::Constellation>, 3>{{{"qpsk", ofdm::Constellation::kQpsk},
                                                                             {"16qam", ofdm::Constellation::kQam16},
                                                                             {"64qam", ofdm::Constellation::kQam64}}});
}

BoundaryMethod boundary_method_of(const std::string& word) { return of_word("method", word, kMethods); }

const char* word_of(BoundaryMethod method) noexcept {
  for (const auto& [text, value] : kMethods) {
    if (value == method) return text;
  }
  return "unknown";
}

simulation::Movement movement_of(const std::string& word) {
  return of_word("movement", word,
                 std::array<std::pair<const char*, simulation::Movement>, 2>{
                     {{"interpolate_and_shift", simulation::Movement::kInterpolateAndShift},
                      {"fractional_delay", simulation::Movement::kFractionalDelay}}});
}

void register_ofdm(py::module_& m) {
  register_numerology(m);
  register_boundary(m);
  register_two_ray(m);
  m.def(
      "symbols",
      [](int count, const Numerology& numerology, const std::string& constellation, std::uint64_t seed,
         std::uint64_t stream) {
        if (count < 1 || count > (1 << 20)) {
          throw std::invalid_argument("count: " + std::to_string(count) + "; it must be 1 to 1048576");
        }
        const auto points = constellation_of(constellation);
        std::vector<Cf32> out;
        {
          const py::gil_scoped_release release;
          ofdm::Synthesizer synthesizer(numerology, points);
          out.resize(static_cast<std::size_t>(count) * static_cast<std::size_t>(numerology.symbol_samples()));
          RandomStream random(seed, stream);
          synthesizer.fill(out, random);
        }
        return to_array(std::move(out));
      },
      py::arg("count"), py::arg_v("numerology", Numerology{}, "Numerology()"), py::kw_only(),
      py::arg("constellation") = "qpsk", py::arg("seed"), py::arg("stream") = 0, "A string of OFDM symbols.");
  m.def(
      "correlate",
      [](const IqArray<"iq">& iq, const Numerology& numerology, int symbols, int oversampling) {
        std::vector<std::complex<double>> out;
        {
          const py::gil_scoped_release release;
          out = correlate(iq.span(), numerology, symbols, oversampling);
        }
        return to_array(std::move(out));
      },
      py::arg("iq"), py::arg_v("numerology", Numerology{}, "Numerology()"), py::arg("symbols") = 250, py::kw_only(),
      py::arg("oversampling") = 1, "Cyclic-prefix correlator over many symbols.");
  m.def("delay_crlb_m", &ofdm::delay_crlb_m, py::arg("snr_db"), py::arg("symbols"),
        py::arg_v("numerology", Numerology{}, "Numerology()"), py::kw_only(), py::arg("fraction") = py::none(),
        "Bound of a delay's standard deviation from the folded pairs.");
}

}  // namespace soopnav::python
