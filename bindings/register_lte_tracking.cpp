#include <pybind11/native_enum.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <cstdint>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "array.hpp"
#include "register.hpp"
#include "soopnav/waveform/lte/crs_loop.hpp"
#include "soopnav/waveform/lte/measurement_stream.hpp"

namespace soopnav::python {

/// Rows of the structured arrays.
struct LoopRow {
  double time_s, toa_s, toa_sigma_s, carrier_phase_cycles, phase_sigma_cycles, cfo_hz, cfo_rate_hz_per_s, cn0_dbhz,
      phase_error_cycles, delay_error_s, lock;
  std::int32_t subframe, arc;
  std::uint8_t status;
  bool slip;
};

struct StreamRow {
  double time_s, toa_s, sigma_s, carrier_phase_cycles, phase_sigma_cycles, cfo_hz, cn0_dbhz, first_path_s,
      first_path_sigma_s, excess_s;
  std::int32_t cell_id, paths, arc;
  std::uint8_t status;
  bool slip;
};

namespace {

LoopRow row_of(const lte::LoopUpdate& u) {
  return {u.time_s,
          u.toa_s,
          u.toa_sigma_s,
          u.carrier_phase_cycles,
          u.phase_sigma_cycles,
          u.cfo_hz,
          u.cfo_rate_hz_per_s,
          u.cn0_dbhz,
          u.phase_error_cycles,
          u.delay_error_s,
          u.lock,
          u.subframe,
          u.arc,
          static_cast<std::uint8_t>(u.status),
          u.slip};
}

StreamRow row_of(double time_s, const lte::CellMeasurement& c) {
  return {time_s,
          c.toa_s,
          c.sigma_s,
          c.carrier_phase_cycles,
          c.phase_sigma_cycles,
          c.cfo_hz,
          c.cn0_dbhz,
          c.first_path_s,
          c.first_path_sigma_s,
          c.excess_s,
          c.cell_id,
          c.paths,
          c.arc,
          static_cast<std::uint8_t>(c.status),
          c.slip};
}

/// Calls of several threads wait for each other.
class SharedCrsLoop {
 public:
  SharedCrsLoop(const lte::CrsLoopOptions& options, const lte::Detection& cell) : loop_(options, cell) {}

  py::array push(const IqArray<"block">& block) {
    std::vector<LoopRow> rows;
    {
      const py::gil_scoped_release release;
      const std::scoped_lock lock(mutex_);
      for (const auto& u : loop_.push(block.span())) rows.push_back(row_of(u));
    }
    return to_array(std::move(rows));
  }
  void skip(std::int64_t samples) {
    const std::scoped_lock lock(mutex_);
    loop_.skip(samples);
  }
  [[nodiscard]] const lte::CrsLoop& loop() const noexcept { return loop_; }

 private:
  std::mutex mutex_;
  lte::CrsLoop loop_;
};

class SharedMeasurementStream {
 public:
  SharedMeasurementStream(const lte::StreamOptions& options, const std::vector<lte::Detection>& cells)
      : stream_(options, cells) {}

  /// One structured array per epoch.
  std::vector<std::pair<double, py::array>> push(const IqArray<"block">& block) {
    std::vector<std::pair<double, std::vector<StreamRow>>> epochs;
    {
      const py::gil_scoped_release release;
      const std::scoped_lock lock(mutex_);
      for (const auto& epoch : stream_.push(block.span())) {
        auto& rows = epochs.emplace_back(epoch.time_s, std::vector<StreamRow>{}).second;
        for (const auto& cell : epoch.cells) rows.push_back(row_of(epoch.time_s, cell));
      }
    }
    std::vector<std::pair<double, py::array>> out;
    for (auto& [time_s, rows] : epochs) out.emplace_back(time_s, to_array(std::move(rows)));
    return out;
  }
  void skip(std::int64_t samples) {
    const std::scoped_lock lock(mutex_);
    stream_.skip(samples);
  }
  [[nodiscard]] std::int64_t position() const { return stream_.position(); }

 private:
  std::mutex mutex_;
  lte::MeasurementStream stream_;
};

}  // namespace

void register_lte_tracking(py::module_& m) {
  PYBIND11_NUMPY_DTYPE(LoopRow, time_s, toa_s, toa_sigma_s, carrier_phase_cycles, phase_sigma_cycles, cfo_hz,
                       cfo_rate_hz_per_s, cn0_dbhz, phase_error_cycles, delay_error_s, lock, subframe, arc, status,
                       slip);
  PYBIND11_NUMPY_DTYPE(StreamRow, time_s, toa_s, sigma_s, carrier_phase_cycles, phase_sigma_cycles, cfo_hz, cn0_dbhz,
                       first_path_s, first_path_sigma_s, excess_s, cell_id, paths, arc, status, slip);

  py::native_enum<lte::LoopStatus>(m, "LoopStatus", "enum.IntEnum", "What a loop does.")
      .value("PULL_IN", lte::LoopStatus::kPullIn)
      .value("TRACKING", lte::LoopStatus::kTracking)
      .value("COASTING", lte::LoopStatus::kCoasting)
      .value("LOST", lte::LoopStatus::kLost)
      .finalize();

  py::class_<SharedCrsLoop>(m, "CrsLoop", "Follows carrier phase and delay of one cell.")
      .def(py::init([](double sample_rate_hz, const lte::Detection& detection, double carrier_hz,
                       double pll_bandwidth_hz, int pll_order, double dll_bandwidth_hz, double lost_after_s) {
             lte::CrsLoopOptions o;
             o.sample_rate_hz = sample_rate_hz;
             o.carrier_hz = carrier_hz;
             o.pll_bandwidth_hz = pll_bandwidth_hz;
             o.pll_order = pll_order;
             o.dll_bandwidth_hz = dll_bandwidth_hz;
             o.lost_after_s = lost_after_s;
             return std::make_unique<SharedCrsLoop>(o, detection);
           }),
           py::arg("sample_rate_hz"), py::arg("detection"), py::kw_only(), py::arg("carrier_hz") = 0.0,
           py::arg("pll_bandwidth_hz") = 15.0, py::arg("pll_order") = 3, py::arg("dll_bandwidth_hz") = 1.0,
           py::arg("lost_after_s") = 0.05)
      .def("push", &SharedCrsLoop::push, py::arg("block"),
           "Adds samples; a structured array with one row for each subframe read.")
      .def("skip", &SharedCrsLoop::skip, py::arg("samples"), "Samples were lost before the next block.")
      .def_property_readonly(
          "position", [](const SharedCrsLoop& s) { return s.loop().position(); }, "Samples pushed and skipped.")
      .def_property_readonly(
          "subframes", [](const SharedCrsLoop& s) { return s.loop().subframes(); },
          "Subframes that are read, bit s for subframe s.");

  py::class_<SharedMeasurementStream>(m, "MeasurementStream", "Measurements of several cells at a fixed rate.")
      .def(py::init([](double sample_rate_hz, const std::vector<lte::Detection>& cells, double carrier_hz,
                       double rate_hz, bool search, double search_interval_s, double search_window_s, double max_cfo_hz,
                       int max_cells, double drop_after_s, bool resolve, double pll_bandwidth_hz,
                       double dll_bandwidth_hz) {
             lte::StreamOptions o;
             o.sample_rate_hz = sample_rate_hz;
             o.carrier_hz = carrier_hz;
             o.rate_hz = rate_hz;
             o.search = search;
             o.search_interval_s = search_interval_s;
             o.search_window_s = search_window_s;
             o.max_cfo_hz = max_cfo_hz;
             o.max_cells = max_cells;
             o.drop_after_s = drop_after_s;
             o.resolve = resolve;
             o.pll_bandwidth_hz = pll_bandwidth_hz;
             o.dll_bandwidth_hz = dll_bandwidth_hz;
             return std::make_unique<SharedMeasurementStream>(o, cells);
           }),
           py::arg("sample_rate_hz"), py::arg("cells"), py::kw_only(), py::arg("carrier_hz") = 0.0,
           py::arg("rate_hz") = 10.0, py::arg("search") = true, py::arg("search_interval_s") = 2.0,
           py::arg("search_window_s") = 80e-3, py::arg("max_cfo_hz") = 20e3, py::arg("max_cells") = 8,
           py::arg("drop_after_s") = 2.0, py::arg("resolve") = true, py::arg("pll_bandwidth_hz") = 15.0,
           py::arg("dll_bandwidth_hz") = 1.0)
      .def("push", &SharedMeasurementStream::push, py::arg("block"),
           "Adds samples; time and a structured array, a row per cell, for each epoch that they complete.")
      .def("skip", &SharedMeasurementStream::skip, py::arg("samples"), "Samples were lost before the next block.")
      .def_property_readonly("position", &SharedMeasurementStream::position, "Samples pushed and skipped.");
}

}  // namespace soopnav::python
