#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <cstddef>
#include <cstdint>
#include <span>
#include <stdexcept>
#include <utility>
#include <vector>

#include "array.hpp"
#include "register.hpp"
#include "soopnav/core/constants.hpp"
#include "soopnav/simulation/opportunity_link.hpp"

namespace soopnav::python {

namespace {

using simulation::OpportunityLink;

Eigen::Vector3d opportunity_vector(const RealArrayBase& values, const char* name) {
  if (values.size() != 3) throw py::value_error(std::string(name) + ": three numbers expected");
  return {values[0], values[1], values[2]};
}

clock::ClockState opportunity_clock(double bias_s, double drift) {
  return {bias_s * kSpeedOfLightMps, drift * kSpeedOfLightMps};
}

}  // namespace

void register_opportunity_link(py::module_& m) {
  py::class_<simulation::OpportunitySource>(m, "OpportunitySource", "A transmitter of a spread signal.")
      .def(py::init([](std::size_t band, const IqArray<"chips">& chips, double chip_rate_hz,
                       const std::vector<int>& bits, double symbol_s, const geometry::SampledOrbit& orbit, double h0,
                       double h_minus_2, double bias_s, double drift, double cn0_dbhz) {
             simulation::OpportunitySource source;
             source.band = band;
             source.chips.assign(chips.span().begin(), chips.span().end());
             source.chip_rate_hz = chip_rate_hz;
             for (const int bit : bits) {
               source.bits.push_back(bit == 1 || bit == -1 ? static_cast<std::int8_t>(bit) : std::int8_t{0});
             }
             source.symbol_s = symbol_s;
             source.orbit = orbit;
             source.clock = clock::ClockNoise::from_allan(h0, h_minus_2);
             source.clock_start = opportunity_clock(bias_s, drift);
             source.cn0_dbhz = cn0_dbhz;
             return source;
           }),
           py::kw_only(), py::arg("band"), py::arg("chips"), py::arg("chip_rate_hz"), py::arg("bits"),
           py::arg("symbol_s"), py::arg("orbit"), py::arg("h0"), py::arg("h_minus_2"), py::arg("bias_s"),
           py::arg("drift"), py::arg("cn0_dbhz"));
  py::class_<OpportunityLink>(m, "OpportunityLink", "Samples of every band of a receiver with one oscillator.")
      .def(py::init([](const Table<"bands">& bands, const std::vector<simulation::OpportunitySource>& sources,
                       const RealArray<"position_e_m">& position, const RealArray<"velocity_e_mps">& velocity,
                       double start_s, double duration_s, double step_s, double h0, double h_minus_2, double bias_s,
                       double drift, const RealArray<"clock_bias_s">& clock_bias_s, std::uint64_t seed,
                       std::uint64_t stream) {
             if (bands.rows() > 0 && bands.columns() != 3)
               throw py::value_error("bands: rows of three numbers expected");
             std::vector<simulation::OpportunityBand> all;
             for (std::size_t i = 0; i < bands.rows(); ++i) {
               const auto row = bands.row(i);
               all.push_back({.carrier_hz = row[0], .sample_rate_hz = row[1], .intermediate_hz = row[2]});
             }
             simulation::OpportunityLinkOptions options;
             options.position_e = opportunity_vector(position, "position_e_m");
             options.velocity_e = opportunity_vector(velocity, "velocity_e_mps");
             options.start_s = start_s;
             options.duration_s = duration_s;
             options.step_s = step_s;
             options.clock = clock::ClockNoise::from_allan(h0, h_minus_2);
             options.clock_start = opportunity_clock(bias_s, drift);
             options.clock_bias_s.assign(clock_bias_s.span().begin(), clock_bias_s.span().end());
             const py::gil_scoped_release release;
             return OpportunityLink(std::move(all), sources, options, RandomStream(seed, stream));
           }),
           py::arg("bands"), py::arg("sources"), py::kw_only(), py::arg("position_e_m"), py::arg("velocity_e_mps"),
           py::arg("start_s"), py::arg("duration_s"), py::arg("step_s"), py::arg("h0"), py::arg("h_minus_2"),
           py::arg("bias_s"), py::arg("drift"), py::arg("clock_bias_s"), py::arg("seed"), py::arg("stream"))
      .def("samples", &OpportunityLink::samples, py::arg("band"), "Samples of a band.")
      .def(
          "render",
          [](const OpportunityLink& link, std::size_t band, std::uint64_t first, std::size_t count, bool noise) {
            std::vector<Cf32> out;
            bool made = false;
            {
              const py::gil_scoped_release release;
              if (band < link.bands().size() && count <= link.samples(band)) {
                out.resize(count);
                made = noise ? link.render(band, first, out) : link.render_clean(band, first, out);
              }
            }
            if (!made) {
              throw py::value_error("band = " + std::to_string(band) + ", samples " + std::to_string(first) + " to " +
                                    std::to_string(first + count) + ": there are " +
                                    std::to_string(link.samples(band)));
            }
            return to_array(std::move(out));
          },
          py::arg("band"), py::arg("first"), py::arg("count"), py::kw_only(), py::arg("noise"), "Samples of a band.")
      .def(
          "receiver_bias_s",
          [](const py::object& self) {
            return view_array(self.cast<const OpportunityLink&>().receiver_bias_s(), self);
          },
          "The receiver's clock at the nodes.")
      .def(
          "delay_s",
          [](const py::object& self, std::size_t source) {
            return view_array(self.cast<const OpportunityLink&>().delay_s(source), self);
          },
          py::arg("source"), "What a source's signal is behind at the nodes, clocks included.")
      .def(
          "source_bias_s",
          [](const py::object& self, std::size_t source) {
            return view_array(self.cast<const OpportunityLink&>().source_bias_s(source), self);
          },
          py::arg("source"), "A source's clock at the nodes.");
}

}  // namespace soopnav::python
