#include <pybind11/complex.h>
#include <pybind11/native_enum.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <cmath>
#include <complex>
#include <cstddef>
#include <cstdio>
#include <memory>
#include <mutex>
#include <stdexcept>
#include <string>
#include <vector>

#include "array.hpp"
#include "lte_errors.hpp"
#include "register.hpp"
#include "soopnav/waveform/lte/snapshot_ranger.hpp"
#include "soopnav/waveform/lte/super_resolution.hpp"

namespace soopnav::python {

namespace {

using lte::ResolvedPaths;
using lte::ResolverOptions;
using lte::ResolveStatus;

/// What Python sees of a result: the ports are known.
struct PathsOfPorts {
  ResolvedPaths result;
  int ports = 0;

  template <class Member>
  [[nodiscard]] py::array_t<double> column(Member member) const {
    std::vector<double> values;
    for (const auto& path : result.paths) values.push_back(path.*member);
    return to_array(std::move(values));
  }
};

const char* reason(ResolveStatus status) {
  switch (status) {
    case ResolveStatus::kTooShort:
      return "do not hold the subframes asked for with their reference signals";
    case ResolveStatus::kNonFinite:
      return "are not finite, or all zero";
    case ResolveStatus::kLost:
      return "hold no path that stands out of the noise";
    case ResolveStatus::kOk:
      break;
  }
  return "are good";
}

void check_resolved(ResolveStatus status, const char* name) {
  if (status == ResolveStatus::kOk) return;
  const std::string sentence = std::string(name) + ": the values " + reason(status);
  if (status == ResolveStatus::kLost) throw CellLost(sentence);
  throw std::invalid_argument(sentence);
}

ResolverOptions resolver_options(lte::OrderRule order, int max_paths, lte::SubspaceMethod subspace, double window_s,
                                 double min_separation, double earliest_db, double peak_threshold,
                                 lte::PeakWindow peak_window, bool polish, bool ignore_gap) {
  ResolverOptions o;
  o.order = order;
  o.max_paths = max_paths;
  o.subspace = subspace;
  o.window_s = window_s;
  o.min_separation = min_separation;
  o.earliest_db = earliest_db;
  o.peak_threshold = peak_threshold;
  o.peak_window = peak_window;
  o.polish = polish;
  o.ignore_gap = ignore_gap;
  return o;
}

std::vector<double> values_over(const RealArray<"delays_s">& delays_s, const auto& function) {
  std::vector<double> out(delays_s.size());
  function(delays_s.span(), std::span<double>(out));
  return out;
}

/// Calls of several threads wait for each other.
class SharedPathResolver {
 public:
  explicit SharedPathResolver(const ResolverOptions& options) : resolver_(options) {}

  std::unique_ptr<PathsOfPorts> resolve(const IqArray<"channel">& channel, const RealArray<"frequencies">& frequencies,
                                        double noise_variance) {
    const std::size_t n = frequencies.size();
    if (n == 0 || channel.span().size() % n != 0 || channel.span().size() / n > lte::kMaxPorts) {
      throw std::invalid_argument("channel: " + std::to_string(channel.span().size()) + " values for " +
                                  std::to_string(n) +
                                  " frequencies; a row of as many for each of 1 ... 4 ports expected");
    }
    lte::ChannelView view;
    view.ports = static_cast<int>(channel.span().size() / n);
    for (std::size_t p = 0; p < static_cast<std::size_t>(view.ports); ++p) view.port[p] = channel.span().data() + p * n;
    if (!(noise_variance >= 0.0) || !std::isfinite(noise_variance)) {
      throw std::invalid_argument("noise_variance: " + std::to_string(noise_variance) + "; finite and >= 0 expected");
    }
    std::vector<int> whole;
    for (const double f : frequencies.span()) {
      if (f != std::round(f)) {
        throw std::invalid_argument("frequencies: " + std::to_string(f) + "; whole multiples of 15 kHz expected");
      }
    }
    for (const double f : frequencies.span()) whole.push_back(static_cast<int>(std::lround(std::clamp(f, -1e6, 1e6))));
    view.frequencies = whole;
    view.noise_variance = noise_variance;
    auto out = std::make_unique<PathsOfPorts>();
    out->ports = view.ports;
    ResolveStatus status{};
    {
      const py::gil_scoped_release release;
      const std::scoped_lock lock(mutex_);
      status = resolver_.resolve(view, out->result);
    }
    if (status == ResolveStatus::kTooShort) {
      throw std::invalid_argument(
          "frequencies: a comb of 12 ... 440 in equal steps, as many below the carrier as above, "
          "expected");
    }
    check_resolved(status, "channel");
    return out;
  }

  py::array_t<double> music(const RealArray<"delays_s">& delays_s, int order) {
    const std::scoped_lock lock(mutex_);
    return to_array(values_over(delays_s, [&](auto in, auto to) { resolver_.music(in, order, to); }));
  }
  py::array_t<double> impulse_response(const RealArray<"delays_s">& delays_s) {
    const std::scoped_lock lock(mutex_);
    return to_array(values_over(delays_s, [&](auto in, auto to) { resolver_.impulse_response(in, to); }));
  }
  [[nodiscard]] double period_s() const { return resolver_.music_period_s(); }

 private:
  std::mutex mutex_;
  lte::PathResolver resolver_;
};

class SharedSubframePathResolver {
 public:
  SharedSubframePathResolver(double sample_rate_hz, const lte::Detection& cell, const ResolverOptions& options)
      : resolver_(sample_rate_hz, cell, options) {}

  std::unique_ptr<PathsOfPorts> resolve(const IqArray<"iq">& iq, int subframe, int subframes, double start_s,
                                        double cfo_hz) {
    if (subframe < 0 || subframes < 1 || subframe + subframes > 10) {
      throw std::invalid_argument("subframes: " + std::to_string(subframes) + " from " + std::to_string(subframe) +
                                  "; within 0 ... 9 of one frame expected");
    }
    auto out = std::make_unique<PathsOfPorts>();
    out->ports = resolver_.ports();
    ResolveStatus status{};
    {
      const py::gil_scoped_release release;
      const std::scoped_lock lock(mutex_);
      status = resolver_.resolve(iq.span(), subframe, subframes, start_s, cfo_hz, out->result);
    }
    check_resolved(status, "iq");
    return out;
  }

  py::array_t<Cf32> channel() {
    const std::scoped_lock lock(mutex_);
    std::vector<Cf32> values;
    for (int p = 0; p < resolver_.ports(); ++p) {
      const auto row = resolver_.channel(p);
      values.insert(values.end(), row.begin(), row.end());
    }
    const auto n = static_cast<py::ssize_t>(resolver_.frequencies().size());
    return to_array(std::move(values), {resolver_.ports(), n});
  }
  [[nodiscard]] py::array_t<int> frequencies() const {
    const auto f = resolver_.frequencies();
    return to_array(std::vector<int>(f.begin(), f.end()));
  }
  py::array_t<double> music(const RealArray<"delays_s">& delays_s, int order) {
    return shifted(delays_s, [&](auto in, auto to) { resolver_.resolver().music(in, order, to); });
  }
  py::array_t<double> impulse_response(const RealArray<"delays_s">& delays_s) {
    return shifted(delays_s, [&](auto in, auto to) { resolver_.resolver().impulse_response(in, to); });
  }
  [[nodiscard]] double residual_cfo_hz() const { return resolver_.residual_cfo_hz(); }

 private:
  // The resolver's own delays count from the start it was given.
  py::array_t<double> shifted(const RealArray<"delays_s">& delays_s, const auto& function) {
    const std::scoped_lock lock(mutex_);
    std::vector<double> in(delays_s.span().begin(), delays_s.span().end()), out(delays_s.size());
    for (double& t : in) t -= resolver_.start_s();
    function(std::span<const double>(in), std::span<double>(out));
    return to_array(std::move(out));
  }

  std::mutex mutex_;
  lte::SubframePathResolver resolver_;
};

/// The cells of one snapshot, a column per quantity.
struct Snapshot {
  std::vector<lte::SnapshotRange> cells;

  template <class T>
  [[nodiscard]] py::array_t<T> column(T lte::SnapshotRange::*member) const {
    std::vector<T> values;
    for (const auto& cell : cells) values.push_back(cell.*member);
    return to_array(std::move(values));
  }
  [[nodiscard]] int good() const {
    int count = 0;
    for (const auto& cell : cells) count += cell.status == ResolveStatus::kOk ? 1 : 0;
    return count;
  }
};

class SharedSnapshotRanger {
 public:
  SharedSnapshotRanger(double sample_rate_hz, const std::vector<lte::Detection>& cells,
                       const lte::RangerOptions& options)
      : ranger_(sample_rate_hz, cells, options) {}

  std::unique_ptr<Snapshot> range(const IqArray<"iq">& iq, const RealArray<"frame_start_s">& frame_start_s,
                                  const RealArray<"cfo_hz">& cfo_hz) {
    const auto cells = static_cast<std::size_t>(ranger_.cells());
    const auto check = [&](const char* name, std::size_t size) {
      if (size != cells) {
        throw std::invalid_argument(std::string(name) + ": " + std::to_string(size) + " values for " +
                                    std::to_string(cells) + " cells");
      }
    };
    check("frame_start_s", frame_start_s.size());
    check("cfo_hz", cfo_hz.size());
    auto out = std::make_unique<Snapshot>();
    const py::gil_scoped_release release;
    const std::scoped_lock lock(mutex_);
    const auto ranges = ranger_.range(iq.span(), frame_start_s.span(), cfo_hz.span());
    out->cells.assign(ranges.begin(), ranges.end());
    return out;
  }
  [[nodiscard]] int cells() const { return ranger_.cells(); }

 private:
  std::mutex mutex_;
  lte::SnapshotRanger ranger_;
};

std::string text_of(const PathsOfPorts& p) {
  std::array<char, 200> text{};
  std::snprintf(text.data(), text.size(), "ResolvedPaths(%zu paths, toa_s=%.12g +- %.1e, snr_db=%.1f, fit=%.2f)",
                p.result.paths.size(), p.result.toa_s, p.result.toa_sigma_s, p.result.snr_db, p.result.fit);
  return text.data();
}

void register_results(py::module_& m) {
  py::native_enum<lte::OrderRule>(m, "OrderRule", "enum.Enum", "How the number of paths is found.")
      .value("MDL", lte::OrderRule::kMdl)
      .value("AIC", lte::OrderRule::kAic)
      .value("FIXED", lte::OrderRule::kFixed)
      .finalize();
  py::native_enum<lte::SubspaceMethod>(m, "SubspaceMethod", "enum.Enum", "Subspace that starts the fits.")
      .value("ESPRIT", lte::SubspaceMethod::kEsprit)
      .value("MATRIX_PENCIL", lte::SubspaceMethod::kMatrixPencil)
      .finalize();
  py::native_enum<lte::PeakWindow>(m, "PeakWindow", "enum.Enum", "Window over frequency of the first-peak rule.")
      .value("RECTANGULAR", lte::PeakWindow::kRectangular)
      .value("HANN", lte::PeakWindow::kHann)
      .finalize();
  py::native_enum<ResolveStatus>(m, "ResolveStatus", "enum.IntEnum", "Why a cell has no paths.")
      .value("OK", ResolveStatus::kOk)
      .value("TOO_SHORT", ResolveStatus::kTooShort)
      .value("NON_FINITE", ResolveStatus::kNonFinite)
      .value("LOST", ResolveStatus::kLost)
      .finalize();

  py::class_<PathsOfPorts>(m, "ResolvedPaths", "Paths told apart in a channel, ascending delay. Read-only.")
      .def_property_readonly(
          "toa_s", [](const PathsOfPorts& p) { return p.result.toa_s; }, "Delay of the first path.")
      .def_property_readonly(
          "toa_sigma_s", [](const PathsOfPorts& p) { return p.result.toa_sigma_s; },
          "Its deviation, all other delays and amplitudes unknown.")
      .def_property_readonly(
          "first", [](const PathsOfPorts& p) { return p.result.first; }, "Index of the path that counts as the first.")
      .def_property_readonly(
          "delays_s", [](const PathsOfPorts& p) { return p.column(&lte::ResolvedPath::delay_s); }, "Shape (paths,).")
      .def_property_readonly(
          "sigmas_s", [](const PathsOfPorts& p) { return p.column(&lte::ResolvedPath::sigma_s); },
          "Deviations of delays_s; shape (paths,).")
      .def_property_readonly(
          "powers_db", [](const PathsOfPorts& p) { return p.column(&lte::ResolvedPath::power_db); },
          "Relative to the strongest path, mean over ports; shape (paths,).")
      .def_property_readonly(
          "gains",
          [](const PathsOfPorts& p) {
            std::vector<std::complex<double>> values;
            for (const auto& path : p.result.paths) {
              values.insert(values.end(), path.gain.begin(), path.gain.begin() + p.ports);
            }
            return to_array(std::move(values), {static_cast<py::ssize_t>(p.result.paths.size()), p.ports});
          },
          "Amplitude and phase at the carrier; shape (paths, ports), complex128.")
      .def_property_readonly(
          "covariance_s2",
          [](const PathsOfPorts& p) {
            const std::size_t n = p.result.paths.size();
            std::vector<double> values;
            for (std::size_t i = 0; i < n; ++i) {
              const auto& row = p.result.covariance_s2[i];
              values.insert(values.end(), row.begin(), row.begin() + static_cast<std::ptrdiff_t>(n));
            }
            return to_array(std::move(values), {static_cast<py::ssize_t>(n), static_cast<py::ssize_t>(n)});
          },
          "Of delays_s; shape (paths, paths).")
      .def_property_readonly(
          "subspace_delays_s",
          [](const PathsOfPorts& p) {
            const auto& d = p.result.subspace_delays_s;
            return to_array(std::vector<double>(d.begin(), d.end()));
          },
          "What the subspace gave for that order, before the polish; shape (paths,) or (0,).")
      .def_property_readonly(
          "subspace_order", [](const PathsOfPorts& p) { return p.result.subspace_order; },
          "Order by the covariance's eigenvalues.")
      .def_property_readonly(
          "single_path_s", [](const PathsOfPorts& p) { return p.result.single_path_s; },
          "Maximum likelihood of one path.")
      .def_property_readonly(
          "first_peak_s", [](const PathsOfPorts& p) { return p.result.first_peak_s; },
          "First local maximum of the impulse response over the threshold.")
      .def_property_readonly(
          "first_peak_sigma_s", [](const PathsOfPorts& p) { return p.result.first_peak_sigma_s; },
          "Deviation of a lone path there.")
      .def_property_readonly(
          "noise_variance", [](const PathsOfPorts& p) { return p.result.noise_variance; },
          "Of one channel value, as used.")
      .def_property_readonly(
          "fit", [](const PathsOfPorts& p) { return p.result.fit; },
          "Residual per degree of freedom over the noise measured; 1 when the model holds.")
      .def_property_readonly(
          "snr_db", [](const PathsOfPorts& p) { return p.result.snr_db; }, "Of one channel value, mean over ports.")
      .def("__len__", [](const PathsOfPorts& p) { return p.result.paths.size(); })
      .def("__repr__", &text_of);

  py::class_<Snapshot>(m, "Snapshot", "Ranges to the cells of one snapshot, in the order they were given. Read-only.")
      .def_property_readonly(
          "status",
          [](const Snapshot& s) {
            std::vector<std::uint8_t> values;
            for (const auto& cell : s.cells) values.push_back(static_cast<std::uint8_t>(cell.status));
            return to_array(std::move(values));
          },
          "Values of ResolveStatus, 0 is good; shape (cells,), uint8.")
      .def_property_readonly(
          "cell_id", [](const Snapshot& s) { return s.column(&lte::SnapshotRange::cell_id); }, "Shape (cells,), int32.")
      .def_property_readonly(
          "toa_s", [](const Snapshot& s) { return s.column(&lte::SnapshotRange::toa_s); },
          "Frame start by the first path, on the guess's time line; 0 where status is not good.")
      .def_property_readonly(
          "sigma_s", [](const Snapshot& s) { return s.column(&lte::SnapshotRange::sigma_s); }, "Deviation of toa_s.")
      .def_property_readonly(
          "undetected_s", [](const Snapshot& s) { return s.column(&lte::SnapshotRange::undetected_s); },
          "Deviation that a path too weak to be told apart could cause; not in sigma_s.")
      .def_property_readonly(
          "first_peak_s", [](const Snapshot& s) { return s.column(&lte::SnapshotRange::first_peak_s); },
          "Frame start by the first-peak rule.")
      .def_property_readonly(
          "first_peak_sigma_s", [](const Snapshot& s) { return s.column(&lte::SnapshotRange::first_peak_sigma_s); },
          "Deviation of a lone path there.")
      .def_property_readonly(
          "excess_s", [](const Snapshot& s) { return s.column(&lte::SnapshotRange::excess_s); },
          "Strongest path after the first one.")
      .def_property_readonly(
          "first_db", [](const Snapshot& s) { return s.column(&lte::SnapshotRange::first_db); },
          "Power of the first path over the strongest.")
      .def_property_readonly(
          "paths", [](const Snapshot& s) { return s.column(&lte::SnapshotRange::paths); },
          "Paths from the first one on.")
      .def_property_readonly(
          "snr_db", [](const Snapshot& s) { return s.column(&lte::SnapshotRange::snr_db); },
          "Per reference element, over noise and what remains of other cells.")
      .def_property_readonly(
          "residual_cfo_hz", [](const Snapshot& s) { return s.column(&lte::SnapshotRange::residual_cfo_hz); },
          "Carrier offset left beside the one given.")
      .def("__len__", [](const Snapshot& s) { return s.cells.size(); })
      .def("__repr__", [](const Snapshot& s) {
        return "Snapshot(" + std::to_string(s.good()) + " of " + std::to_string(s.cells.size()) + " cells ranged)";
      });
}

template <class Class>
void add_spectra(Class& c) {
  using Self = typename Class::type;
  c.def(
       "music",
       [](Self& self, const RealArray<"delays_s">& delays_s, int order) { return self.music(delays_s, order); },
       py::arg("delays_s"), py::kw_only(), py::arg("order") = 0, "MUSIC pseudo-spectrum of the last channel.")
      .def(
          "impulse_response",
          [](Self& self, const RealArray<"delays_s">& delays_s) { return self.impulse_response(delays_s); },
          py::arg("delays_s"), "Magnitude of the last channel over delay, rectangular window.");
}

}  // namespace

void register_lte_paths(py::module_& m) {
  register_results(m);
  py::class_<ResolverOptions>(m, "ResolverOptions", "How paths are told apart. Read-only.")
      .def(py::init(&resolver_options), py::kw_only(), py::arg_v("order", lte::OrderRule::kMdl, "OrderRule.MDL"),
           py::arg("max_paths") = 4, py::arg_v("subspace", lte::SubspaceMethod::kEsprit, "SubspaceMethod.ESPRIT"),
           py::arg("window_s") = 2e-6, py::arg("min_separation") = 0.1, py::arg("earliest_db") = -20.0,
           py::arg("peak_threshold") = 0.35,
           py::arg_v("peak_window", lte::PeakWindow::kRectangular, "PeakWindow.RECTANGULAR"), py::arg("polish") = true,
           py::arg("ignore_gap") = false)
      .def_readonly("max_paths", &ResolverOptions::max_paths);

  py::class_<SharedPathResolver> resolver(m, "PathResolver", "Tells paths apart in a channel over frequency.");
  resolver.def(py::init<const ResolverOptions&>(), py::arg("options"))
      .def("resolve", &SharedPathResolver::resolve, py::arg("channel"), py::arg("frequencies"),
           py::arg("noise_variance"), "channel: rows of the ports one after the other; frequencies in units of 15 kHz.")
      .def_property_readonly("music_period_s", &SharedPathResolver::period_s, "Delays of `music` repeat after this.");
  add_spectra(resolver);

  py::class_<SharedSubframePathResolver> resolver_of_samples(m, "SubframePathResolver",
                                                             "Tells the paths of one cell apart, from samples.");
  resolver_of_samples
      .def(py::init<double, const lte::Detection&, const ResolverOptions&>(), py::arg("sample_rate_hz"),
           py::arg("detection"), py::arg("options"))
      .def("resolve", &SharedSubframePathResolver::resolve, py::arg("iq"), py::kw_only(), py::arg("subframe"),
           py::arg("subframes"), py::arg("start_s"), py::arg("cfo_hz"),
           "Paths of the subframe that begins near start_s in iq.")
      .def_property_readonly("channel", &SharedSubframePathResolver::channel,
                             "Channel of the last call, shape (ports, elements), complex64.")
      .def_property_readonly("frequencies", &SharedSubframePathResolver::frequencies,
                             "Of the elements, units of 15 kHz; shape (elements,), int32.")
      .def_property_readonly("residual_cfo_hz", &SharedSubframePathResolver::residual_cfo_hz,
                             "Carrier offset left beside the one given, in the last call.");
  add_spectra(resolver_of_samples);

  py::class_<SharedSnapshotRanger>(m, "SnapshotRanger", "Ranges to several known cells from a millisecond of samples.")
      .def(py::init([](double sample_rate_hz, const std::vector<lte::Detection>& cells, int subframes, int passes,
                       bool cancel, double search_window_s, const ResolverOptions& options) {
             lte::RangerOptions o;
             o.subframes = subframes;
             o.passes = passes;
             o.cancel = cancel;
             o.search_window_s = search_window_s;
             o.resolver = options;
             return std::make_unique<SharedSnapshotRanger>(sample_rate_hz, cells, o);
           }),
           py::arg("sample_rate_hz"), py::arg("cells"), py::kw_only(), py::arg("subframes"), py::arg("passes"),
           py::arg("cancel"), py::arg("search_window_s"), py::arg("options"))
      .def("range", &SharedSnapshotRanger::range, py::arg("iq"), py::arg("frame_start_s"), py::arg("cfo_hz"),
           "Ranges of one snapshot.")
      .def("__len__", &SharedSnapshotRanger::cells);
}

}  // namespace soopnav::python
