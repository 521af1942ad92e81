#include <pybind11/complex.h>
#include <pybind11/native_enum.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <cstddef>
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
#include "lte_errors.hpp"
#include "register.hpp"
#include "soopnav/waveform/lte/search.hpp"
#include "soopnav/waveform/lte/sequences.hpp"
#include "soopnav/waveform/lte/synthesis.hpp"
#include "soopnav/waveform/lte/time_of_arrival.hpp"

namespace soopnav::python {

namespace {

using lte::CyclicPrefix;
using lte::Detection;
using lte::Duplex;
using lte::Path;
using lte::TimeOfArrival;

/// printf into a string; what is longer than 255 characters is cut.
template <class... Values>
std::string format(const char* pattern, Values... values) {
  std::array<char, 256> text{};
  std::snprintf(text.data(), text.size(), pattern, values...);
  return text.data();
}

std::string optional_text(const std::optional<int>& value) { return value ? std::to_string(*value) : "None"; }

std::string repr(const Detection& d) {
  return "Detection(cell_id=" + std::to_string(d.cell_id) + ", " + (d.duplex == Duplex::kFdd ? "FDD" : "TDD") + ", " +
         (d.cp == CyclicPrefix::kNormal ? "normal" : "extended") + " CP, n_rb=" + optional_text(d.n_rb) +
         ", n_ports=" + optional_text(d.n_ports) + ", sfn=" + optional_text(d.sfn) +
         format(", frame_start_s=%.9f, cfo_hz=%+.1f, clock_error_ppm=%+.3f, snr_db=%.1f)", d.frame_start_s, d.cfo_hz,
                d.clock_error_ppm, d.snr_db);
}

std::string repr(const TimeOfArrival& t) {
  if (t.toa_s.empty()) return "TimeOfArrival(0 frames)";
  return format(
      "TimeOfArrival(%zu frames, toa_s[0]=%.10f +- %.1e, %zu paths, cfo_hz=%+.1f, clock_error_ppm=%+.3f, "
      "snr_db=%.1f)",
      t.toa_s.size(), t.toa_s.front(), t.sigma_s.front(), t.paths.size(), t.cfo_hz, t.clock_error_ppm, t.snr_db);
}

std::string too_few(IqSpan iq, double sample_rate_hz, const char* needed) {
  return "iq: " + grouped(iq.size()) + (iq.size() == 1 ? " sample" : " samples") +
         format(" (%.3g ms)", 1e3 * static_cast<double>(iq.size()) / sample_rate_hz) +
         (iq.size() == 1 ? " is" : " are") + " too few; " + needed;
}

std::string not_finite(IqSpan iq) {
  const auto index = first_non_finite(iq);
  return index ? "iq: sample " + grouped(*index) + " is not finite" : "iq: a sample is not finite";
}

void check(lte::SearchStatus status, IqSpan iq, double sample_rate_hz) {
  switch (status) {
    case lte::SearchStatus::kOk:
      return;
    case lte::SearchStatus::kTooShort:
      throw std::invalid_argument(too_few(iq, sample_rate_hz, "one half-frame and a symbol (5.2 ms) are needed"));
    case lte::SearchStatus::kNonFinite:
      throw std::invalid_argument(not_finite(iq));
  }
}

void check(lte::ToaStatus status, IqSpan iq, double sample_rate_hz, const Detection& cell) {
  switch (status) {
    case lte::ToaStatus::kOk:
      return;
    case lte::ToaStatus::kTooShort:
      throw std::invalid_argument(
          too_few(iq, sample_rate_hz, "one whole subframe with reference signals (1 ms) is needed"));
    case lte::ToaStatus::kNonFinite:
      throw std::invalid_argument(not_finite(iq));
    case lte::ToaStatus::kBadCell:
      throw std::invalid_argument("detection: not a cell that can be");
    case lte::ToaStatus::kLost:
      throw CellLost("detection: the reference signals of cell " + std::to_string(cell.cell_id) +
                     " are not in these samples");
  }
}

void check_range(const char* name, int value, int low, int high) {
  if (value >= low && value <= high) return;
  throw std::invalid_argument(std::string(name) + ": " + std::to_string(value) + " is outside " + std::to_string(low) +
                              " ... " + std::to_string(high));
}

void check_one_of(const char* name, int value, std::span<const int> allowed) {
  if (std::find(allowed.begin(), allowed.end(), value) != allowed.end()) return;
  std::string text;
  for (const int choice : allowed) text += (text.empty() ? "" : ", ") + std::to_string(choice);
  throw std::invalid_argument(std::string(name) + ": " + std::to_string(value) + " is none of " + text);
}

Detection make_detection(int cell_id, double frame_start_s, double cfo_hz, std::optional<int> n_rb,
                         std::optional<int> n_ports, std::optional<int> sfn, CyclicPrefix cp, Duplex duplex,
                         double clock_error_ppm, double snr_db) {
  check_range("cell_id", cell_id, 0, lte::kCells - 1);
  if (!(frame_start_s >= 0.0 && frame_start_s < lte::kFrameS)) {
    throw std::invalid_argument(format("frame_start_s: %g is outside 0 ... 0.01", frame_start_s));
  }
  if (!std::isfinite(cfo_hz)) throw std::invalid_argument("cfo_hz: a finite number is needed");
  if (!std::isfinite(clock_error_ppm)) throw std::invalid_argument("clock_error_ppm: a finite number is needed");
  if (n_rb) check_one_of("n_rb", *n_rb, lte::kBandwidthsRb);
  if (n_ports) check_one_of("n_ports", *n_ports, std::array{1, 2, 4});
  if (sfn) check_range("sfn", *sfn, 0, 1023);
  Detection cell;
  cell.cell_id = cell_id;
  cell.n_rb = n_rb;
  cell.n_ports = n_ports;
  cell.sfn = sfn;
  cell.cp = cp;
  cell.duplex = duplex;
  cell.frame_start_s = frame_start_s;
  cell.cfo_hz = cfo_hz;
  cell.clock_error_ppm = clock_error_ppm;
  cell.snr_db = snr_db;
  return cell;
}

/// A searcher that several Python threads may hold: calls wait for each other.
class SharedSearcher {
 public:
  explicit SharedSearcher(const lte::SearchOptions& options) : options_(options), searcher_(options) {}

  [[nodiscard]] const lte::SearchOptions& options() const noexcept { return options_; }

  std::vector<Detection> search(IqSpan iq) {
    const py::gil_scoped_release release;
    const std::scoped_lock lock(mutex_);
    check(searcher_.search(iq), iq, options_.sample_rate_hz);
    const auto found = searcher_.detections();
    return {found.begin(), found.end()};
  }

  std::vector<Detection> push(IqSpan block) {
    const py::gil_scoped_release release;
    const std::scoped_lock lock(mutex_);
    const auto found = searcher_.push(block);
    return {found.begin(), found.end()};
  }

 private:
  lte::SearchOptions options_;
  std::mutex mutex_;
  lte::Searcher searcher_;
};

lte::SearchOptions make_options(double sample_rate_hz, double max_cfo_hz, bool decode_mib, int max_cells) {
  lte::SearchOptions options;
  options.sample_rate_hz = sample_rate_hz;
  options.max_cfo_hz = max_cfo_hz;
  options.decode_mib = decode_mib;
  options.max_cells = max_cells;
  return options;
}

void register_types(py::module_& m) {
  py::native_enum<CyclicPrefix>(m, "CyclicPrefix", "enum.Enum", "Cyclic prefix of the downlink (TS 36.211 6.12).")
      .value("NORMAL", CyclicPrefix::kNormal)
      .value("EXTENDED", CyclicPrefix::kExtended)
      .finalize();
  py::native_enum<Duplex>(m, "Duplex", "enum.Enum", "Frame structure: type 1 (FDD) or type 2 (TDD), TS 36.211 4.")
      .value("FDD", Duplex::kFdd)
      .value("TDD", Duplex::kTdd)
      .finalize();

  py::class_<Detection>(m, "Detection",
                        "A cell found in a capture. Times run from the capture's first sample; cfo_hz is where the "
                        "carrier lies in the\nbaseband spectrum; clock_error_ppm is how much faster the cell's clock "
                        "runs than the receiver's. Read-only.")
      .def(py::init(&make_detection), py::kw_only(), py::arg("cell_id"), py::arg("frame_start_s"),
           py::arg("cfo_hz") = 0.0, py::arg("n_rb") = py::none(), py::arg("n_ports") = py::none(),
           py::arg("sfn") = py::none(), py::arg_v("cp", CyclicPrefix::kNormal, "CyclicPrefix.NORMAL"),
           py::arg_v("duplex", Duplex::kFdd, "Duplex.FDD"), py::arg("clock_error_ppm") = 0.0, py::arg("snr_db") = 0.0,
           "A cell that is known already. Raises ValueError for a value outside its range.")
      .def_readonly("cell_id", &Detection::cell_id, "Physical-layer cell identity, 0 ... 503.")
      .def_readonly("n_rb", &Detection::n_rb, "Bandwidth in resource blocks; None when no MIB was decoded.")
      .def_readonly("n_ports", &Detection::n_ports, "Antenna ports 1, 2 or 4; None when no MIB was decoded.")
      .def_readonly("sfn", &Detection::sfn, "System frame number at frame_start_s; None when no MIB was decoded.")
      .def_readonly("cp", &Detection::cp, "Cyclic prefix.")
      .def_readonly("duplex", &Detection::duplex, "Frame structure.")
      .def_readonly("frame_start_s", &Detection::frame_start_s,
                    "Start (cyclic prefix included) of the first radio frame, 0 ... 10 ms.")
      .def_readonly("cfo_hz", &Detection::cfo_hz, "Carrier-frequency offset.")
      .def_readonly("cfo_sigma_hz", &Detection::cfo_sigma_hz, "Standard deviation of cfo_hz.")
      .def_readonly("clock_error_ppm", &Detection::clock_error_ppm, "Sampling-clock error, parts per million.")
      .def_readonly("clock_error_sigma_ppm", &Detection::clock_error_sigma_ppm,
                    "Standard deviation of clock_error_ppm.")
      .def_readonly("power_db", &Detection::power_db,
                    "Of a reference element, mean over ports; 0 dB is magnitude 1 in a unitary transform.")
      .def_readonly("snr_db", &Detection::snr_db,
                    "Per reference element, mean over ports, over the central six resource blocks.")
      .def_readonly("crs_statistic", &Detection::crs_statistic,
                    "Evidence of the confirming reference-signal test, in units of its mean in noise.")
      .def("__repr__", [](const Detection& d) { return repr(d); });

  py::class_<Path>(m, "Path", "One resolved propagation path. Read-only.")
      .def_readonly("delay_s", &Path::delay_s, "Delay after the first path.")
      .def_readonly("power_db", &Path::power_db, "Power relative to the strongest path.")
      .def("__repr__",
           [](const Path& p) { return format("Path(delay_s=%.3e, power_db=%.1f)", p.delay_s, p.power_db); });

  py::class_<TimeOfArrival>(m, "TimeOfArrival", "Times of arrival of one cell, a value per radio frame. Read-only.")
      .def_property_readonly(
          "toa_s", [](py::object self) { return view_array<double>(self.cast<const TimeOfArrival&>().toa_s, self); },
          "First path: start of frame i minus i * 10 ms, from the capture's first sample; shape (frames,).")
      .def_property_readonly(
          "sigma_s",
          [](py::object self) { return view_array<double>(self.cast<const TimeOfArrival&>().sigma_s, self); },
          "Standard deviation of each, what the frames share included; shape (frames,).")
      .def_property_readonly(
          "frame_index",
          [](py::object self) { return view_array<int>(self.cast<const TimeOfArrival&>().frame_index, self); },
          "Frames after the one that starts at Detection.frame_start_s; shape (frames,), int32.")
      .def_property_readonly(
          "impulse_response",
          [](py::object self) { return view_array<float>(self.cast<const TimeOfArrival&>().impulse_response, self); },
          "Magnitude over delay, all ports; shape (n,), float32.")
      .def_readonly("impulse_response_step_s", &TimeOfArrival::impulse_response_step_s, "Spacing of impulse_response.")
      .def_readonly("impulse_response_start_s", &TimeOfArrival::impulse_response_start_s,
                    "Delay of impulse_response[0] after the first path.")
      .def_readonly("paths", &TimeOfArrival::paths, "Resolved paths, the first one first.")
      .def_readonly("cfo_hz", &TimeOfArrival::cfo_hz, "Carrier-frequency offset, refined over the capture.")
      .def_readonly("clock_error_ppm", &TimeOfArrival::clock_error_ppm, "Sampling-clock error of the frames' delays.")
      .def_readonly("snr_db", &TimeOfArrival::snr_db, "Per reference element, mean over ports.")
      .def_readonly("noise_variance", &TimeOfArrival::noise_variance, "Of one resource element.")
      .def("__len__", [](const TimeOfArrival& t) { return t.toa_s.size(); })
      .def("__repr__", [](const TimeOfArrival& t) { return repr(t); });
}

void register_receiver(py::module_& m) {
  m.def(
      "search",
      [](const IqArray<"iq">& iq, double sample_rate_hz, double max_cfo_hz, bool decode_mib, int max_cells) {
        SharedSearcher searcher(make_options(sample_rate_hz, max_cfo_hz, decode_mib, max_cells));
        return searcher.search(iq.span());
      },
      py::arg("iq"), py::arg("sample_rate_hz"), py::kw_only(), py::arg("max_cfo_hz") = 150e3,
      py::arg("decode_mib") = true, py::arg("max_cells") = 16, "Cells in a capture, strongest first.");

  py::class_<SharedSearcher>(m, "Searcher", "Cell search with its plans and buffers kept; also for streams.")
      .def(py::init([](double sample_rate_hz, double max_cfo_hz, double window_s, bool decode_mib, int max_cells) {
             auto options = make_options(sample_rate_hz, max_cfo_hz, decode_mib, max_cells);
             options.window_s = window_s;
             return std::make_unique<SharedSearcher>(options);
           }),
           py::arg("sample_rate_hz"), py::kw_only(), py::arg("max_cfo_hz") = 150e3, py::arg("window_s") = 80e-3,
           py::arg("decode_mib") = true, py::arg("max_cells") = 16)
      .def_property_readonly("sample_rate_hz", [](const SharedSearcher& s) { return s.options().sample_rate_hz; })
      .def_property_readonly("max_cfo_hz", [](const SharedSearcher& s) { return s.options().max_cfo_hz; })
      .def_property_readonly("window_s", [](const SharedSearcher& s) { return s.options().window_s; })
      .def(
          "search", [](SharedSearcher& self, const IqArray<"iq">& iq) { return self.search(iq.span()); }, py::arg("iq"),
          "Searches a whole capture; cells strongest first.")
      .def(
          "push", [](SharedSearcher& self, const IqArray<"block">& block) { return self.push(block.span()); },
          py::arg("block"),
          "Adds a block of a stream; cells of the windows it completed, times from the window's first sample.\n"
          "Samples that are not finite count as zero.")
      .def("__repr__", [](const SharedSearcher& s) {
        return format("Searcher(sample_rate_hz=%g, max_cfo_hz=%g, window_s=%g)", s.options().sample_rate_hz,
                      s.options().max_cfo_hz, s.options().window_s);
      });

  m.def(
      "time_of_arrival",
      [](const IqArray<"iq">& iq, double sample_rate_hz, const Detection& detection) {
        auto result = std::make_unique<TimeOfArrival>();
        const Detection cell = detection;
        const py::gil_scoped_release release;
        lte::ToaEstimator estimator(sample_rate_hz);
        check(estimator.estimate(iq.span(), cell, *result), iq.span(), sample_rate_hz, cell);
        return result;
      },
      py::arg("iq"), py::arg("sample_rate_hz"), py::arg("detection"),
      "Times of arrival of one cell from its reference signals.");
}

void register_sequences(py::module_& m) {
  m.def(
      "pss",
      [](int n_id_2) {
        check_range("n_id_2", n_id_2, 0, 2);
        const auto& values = lte::pss(n_id_2);
        return to_array(std::vector<Cf32>(values.begin(), values.end()));
      },
      py::arg("n_id_2"), "Primary synchronisation signal, lowest subcarrier first.");
  m.def(
      "sss",
      [](int cell_id, int subframe) {
        check_range("cell_id", cell_id, 0, lte::kCells - 1);
        check_one_of("subframe", subframe, std::array{0, 5});
        const auto values = lte::sss(cell_id, subframe);
        return to_array(std::vector<float>(values.begin(), values.end()));
      },
      py::arg("cell_id"), py::arg("subframe"), "Secondary synchronisation signal, lowest subcarrier first.");
  m.def(
      "crs",
      [](int cell_id, int slot, int symbol, int port, int n_rb, CyclicPrefix cp) {
        check_range("cell_id", cell_id, 0, lte::kCells - 1);
        check_range("slot", slot, 0, 19);
        check_range("symbol", symbol, 0, lte::symbols_per_slot(cp) - 1);
        check_range("port", port, 0, lte::kMaxPorts - 1);
        check_range("n_rb", n_rb, 6, lte::kMaxRb);
        if (!lte::has_crs(symbol, port, cp)) {
          throw std::invalid_argument("symbol: symbol " + std::to_string(symbol) +
                                      " carries no reference signals of port " + std::to_string(port));
        }
        const auto n = static_cast<std::size_t>(2 * n_rb);
        std::vector<Cf32> values(n);
        lte::crs_values(cell_id, slot, symbol, cp, n_rb, values);
        std::vector<std::int64_t> subcarriers(n);
        const int first = lte::crs_first_subcarrier(cell_id, slot, symbol, port);
        for (std::size_t i = 0; i < n; ++i) subcarriers[i] = first + 6 * static_cast<std::int64_t>(i);
        return std::pair(to_array(std::move(values)), to_array(std::move(subcarriers)));
      },
      py::arg("cell_id"), py::arg("slot"), py::arg("symbol"), py::kw_only(), py::arg("port") = 0, py::arg("n_rb"),
      py::arg_v("cp", CyclicPrefix::kNormal, "CyclicPrefix.NORMAL"),
      "Cell-specific reference signals of one symbol: values, subcarriers.");
}

/// An estimator that several Python threads may hold: calls wait for each other.
class SharedSubframeToaEstimator {
 public:
  SharedSubframeToaEstimator(double sample_rate_hz, const Detection& cell) : estimator_(sample_rate_hz, cell) {}

  std::optional<lte::SubframeToa> estimate(IqSpan iq, int subframe, double start_s, double cfo_hz) {
    const py::gil_scoped_release release;
    const std::scoped_lock lock(mutex_);
    return estimator_.estimate(iq, subframe, start_s, cfo_hz);
  }

 private:
  std::mutex mutex_;
  lte::SubframeToaEstimator estimator_;
};

void register_subframe(py::module_& m) {
  using lte::SubframeToa;
  py::class_<SubframeToa>(m, "SubframeToa", "Delay of one subframe. Read-only.")
      .def_readonly("toa_s", &SubframeToa::toa_s, "Start of the subframe, from the samples' first one.")
      .def_readonly("sigma_s", &SubframeToa::sigma_s, "Standard deviation.")
      .def_readonly("snr_db", &SubframeToa::snr_db, "Per reference element, mean over ports.")
      .def_readonly("noise_variance", &SubframeToa::noise_variance, "Of one resource element.")
      .def_readonly("residual_cfo_hz", &SubframeToa::residual_cfo_hz, "Carrier offset left beside the one given.")
      .def("__repr__", [](const SubframeToa& t) {
        return format("SubframeToa(toa_s=%.12g +- %.1e, snr_db=%.1f, residual_cfo_hz=%+.1f)", t.toa_s, t.sigma_s,
                      t.snr_db, t.residual_cfo_hz);
      });
  py::class_<SharedSubframeToaEstimator>(
      m, "SubframeToaEstimator",
      "Maximum-likelihood delay from the reference signals of one subframe at a time: phase free per port, one path.")
      .def(py::init<double, const Detection&>(), py::arg("sample_rate_hz"), py::arg("detection"))
      .def(
          "estimate",
          [](SharedSubframeToaEstimator& self, const IqArray<"iq">& iq, int subframe, double start_s, double cfo_hz) {
            check_range("subframe", subframe, 0, 9);
            return self.estimate(iq.span(), subframe, start_s, cfo_hz);
          },
          py::arg("iq"), py::arg("subframe"), py::arg("start_s"), py::kw_only(), py::arg("cfo_hz") = 0.0,
          "Delay of the subframe that begins near start_s in iq; None when the samples do not hold it.");
}

using lte::CellParameters;
using lte::SyncPorts;
using Taps = std::vector<std::pair<double, std::complex<double>>>;

CellParameters make_cell(int cell_id, int n_rb, int n_ports, CyclicPrefix cp, Duplex duplex, int tdd_configuration,
                         int special_subframe_configuration, int start_sfn, double delay_s, double power_db,
                         double cfo_hz, double clock_error_ppm, double carrier_phase_rad,
                         const std::optional<std::vector<std::complex<double>>>& port_gain, const Taps& taps,
                         SyncPorts sync_ports, double crs_boost_db, double sync_boost_db, double data_load) {
  CellParameters cell;
  cell.cell_id = cell_id;
  cell.n_rb = n_rb;
  cell.n_ports = n_ports;
  cell.cp = cp;
  cell.duplex = duplex;
  cell.tdd_configuration = tdd_configuration;
  cell.special_subframe_configuration = special_subframe_configuration;
  cell.start_sfn = start_sfn;
  cell.delay_s = delay_s;
  cell.power_db = power_db;
  cell.cfo_hz = cfo_hz;
  cell.clock_error_ppm = clock_error_ppm;
  cell.carrier_phase_rad = carrier_phase_rad;
  if (port_gain) {
    if (port_gain->size() > cell.port_gain.size()) {
      throw std::invalid_argument("port_gain: " + std::to_string(port_gain->size()) + " gains; at most 4 are taken");
    }
    std::copy(port_gain->begin(), port_gain->end(), cell.port_gain.begin());
  }
  cell.taps.clear();
  for (const auto& [delay, gain] : taps) cell.taps.push_back({delay, gain});
  cell.sync_ports = sync_ports;
  cell.crs_boost_db = crs_boost_db;
  cell.sync_boost_db = sync_boost_db;
  cell.data_load = data_load;
  return cell;
}

std::string repr(const CellParameters& c) {
  return "CellParameters(cell_id=" + std::to_string(c.cell_id) + ", n_rb=" + std::to_string(c.n_rb) +
         ", n_ports=" + std::to_string(c.n_ports) + ", " + (c.duplex == Duplex::kFdd ? "FDD" : "TDD") + ", " +
         (c.cp == CyclicPrefix::kNormal ? "normal" : "extended") + " CP" +
         format(", delay_s=%.10g, power_db=%g, cfo_hz=%g, %zu taps)", c.delay_s, c.power_db, c.cfo_hz, c.taps.size());
}

/// A synthesizer that several Python threads may hold: calls wait for each other.
class SharedSynthesizer {
 public:
  SharedSynthesizer(const std::vector<CellParameters>& cells, double sample_rate_hz, double noise_variance,
                    std::uint64_t seed)
      : synthesizer_(cells, sample_rate_hz, noise_variance, seed) {}

  std::vector<Cf32> generate(std::size_t n_samples) {
    const py::gil_scoped_release release;
    const std::scoped_lock lock(mutex_);
    std::vector<Cf32> out(n_samples);
    synthesizer_.generate(out);
    return out;
  }

  std::int64_t position() {
    const py::gil_scoped_release release;
    const std::scoped_lock lock(mutex_);
    return synthesizer_.position();
  }

  void seek(std::int64_t sample) {
    const py::gil_scoped_release release;
    const std::scoped_lock lock(mutex_);
    synthesizer_.seek(sample);
  }

 private:
  std::mutex mutex_;
  lte::Synthesizer synthesizer_;
};

void register_synthesis(py::module_& m) {
  py::native_enum<SyncPorts>(m, "SyncPorts", "enum.Enum", "Antenna ports that send PSS and SSS.")
      .value("FIRST", SyncPorts::kFirst)
      .value("ALL", SyncPorts::kAll)
      .finalize();

  py::class_<CellParameters>(m, "CellParameters", "One eNodeB as it reaches the receiver. Read-only.")
      .def(py::init(&make_cell), py::kw_only(), py::arg("cell_id"), py::arg("n_rb") = 6, py::arg("n_ports") = 1,
           py::arg_v("cp", CyclicPrefix::kNormal, "CyclicPrefix.NORMAL"),
           py::arg_v("duplex", Duplex::kFdd, "Duplex.FDD"), py::arg("tdd_configuration") = 1,
           py::arg("special_subframe_configuration") = 7, py::arg("start_sfn") = 0, py::arg("delay_s") = 0.0,
           py::arg("power_db") = 0.0, py::arg("cfo_hz") = 0.0, py::arg("clock_error_ppm") = 0.0,
           py::arg("carrier_phase_rad") = 0.0, py::arg("port_gain") = py::none(),
           py::arg("taps") = Taps{{0.0, {1.0, 0.0}}}, py::arg_v("sync_ports", SyncPorts::kFirst, "SyncPorts.FIRST"),
           py::arg("crs_boost_db") = 0.0, py::arg("sync_boost_db") = 0.0, py::arg("data_load") = 1.0)
      .def_readonly("cell_id", &CellParameters::cell_id, "0 ... 503.")
      .def_readonly("n_rb", &CellParameters::n_rb, "Bandwidth: 6, 15, 25, 50, 75 or 100 resource blocks.")
      .def_readonly("n_ports", &CellParameters::n_ports, "Antenna ports: 1, 2 or 4.")
      .def_readonly("cp", &CellParameters::cp, "Cyclic prefix.")
      .def_readonly("duplex", &CellParameters::duplex, "Frame structure.")
      .def_readonly("start_sfn", &CellParameters::start_sfn, "Frame number of the frame that starts at delay_s.")
      .def_readonly("delay_s", &CellParameters::delay_s, "Capture time at which that frame starts.")
      .def_readonly("power_db", &CellParameters::power_db, "Power of all elements.")
      .def_readonly("cfo_hz", &CellParameters::cfo_hz, "Where the carrier lies in the baseband spectrum.")
      .def_readonly("clock_error_ppm", &CellParameters::clock_error_ppm, "The cell's clock over the receiver's.")
      .def("__repr__", [](const CellParameters& c) { return repr(c); });

  py::class_<SharedSynthesizer>(m, "Synthesizer", "Samples of several cells and noise, block by block.")
      .def(py::init<const std::vector<CellParameters>&, double, double, std::uint64_t>(), py::arg("cells"),
           py::arg("sample_rate_hz"), py::kw_only(), py::arg("noise_variance") = 0.0, py::arg("seed") = 0)
      .def(
          "generate", [](SharedSynthesizer& self, std::size_t n_samples) { return to_array(self.generate(n_samples)); },
          py::arg("n_samples"), "The next samples, complex64.")
      .def_property_readonly("position", &SharedSynthesizer::position, "Sample that generate begins with.")
      .def("seek", &SharedSynthesizer::seek, py::arg("sample"), "Sets position; negative ones lie before time 0.");

  m.def(
      "synthesize",
      [](const std::vector<CellParameters>& cells, double sample_rate_hz, std::size_t n_samples, double noise_variance,
         std::uint64_t seed) {
        std::vector<Cf32> out;
        {
          const py::gil_scoped_release release;
          out = lte::synthesize(cells, sample_rate_hz, n_samples, noise_variance, seed);
        }
        return to_array(std::move(out));
      },
      py::arg("cells"), py::arg("sample_rate_hz"), py::arg("n_samples"), py::kw_only(), py::arg("noise_variance") = 0.0,
      py::arg("seed") = 0, "Samples of several cells and noise.");
  m.def("noise_variance_for_snr", &lte::noise_variance_for_snr, py::arg("snr_db"), py::kw_only(),
        py::arg("power_db") = 0.0, "Noise variance per sample that gives a reference element of unit gain snr_db.");
  m.def(
      "resource_grid",
      [](const CellParameters& cell, int sfn, int subframe, std::uint64_t seed) {
        auto grid = lte::resource_grid(cell, sfn, subframe, seed);
        return to_array(std::move(grid.values), {grid.n_ports, grid.n_symbols, grid.n_subcarriers});
      },
      py::arg("cell"), py::arg("sfn"), py::arg("subframe"), py::kw_only(), py::arg("seed") = 0,
      "Resource elements of a subframe: ports, symbols, subcarriers.");
}

}  // namespace

void register_lte(py::module_& m) {
  py::register_exception<CellLost>(m, "CellLostError", PyExc_ValueError).doc() =
      "The reference signals of the cell asked for are not in the samples.";
  register_types(m);
  register_receiver(m);
  register_subframe(m);
  register_sequences(m);
  register_synthesis(m);
}

}  // namespace soopnav::python
