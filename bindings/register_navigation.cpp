#include <pybind11/native_enum.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <cmath>
#include <cstddef>
#include <cstdio>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "array.hpp"
#include "doppler_fix.hpp"
#include "register.hpp"
#include "soopnav/navigation/position_fix.hpp"

namespace soopnav::python {

namespace {

using navigation::FixDimension;
using navigation::FixStatus;
using navigation::Node;
using navigation::NodeUse;
using navigation::PositionFix;

std::vector<Node> make_nodes(const TableBase& positions, const std::optional<RealArray<"clock_offsets_s">>& offsets,
                             const std::optional<RealArray<"node_sigmas_s">>& sigmas) {
  if (positions.columns() != 3) {
    throw std::invalid_argument("nodes_enu_m: rows of three numbers expected, got " +
                                std::to_string(positions.columns()));
  }
  const auto check = [&](const char* name, std::size_t size) {
    if (size == positions.rows()) return;
    throw std::invalid_argument(std::string(name) + ": " + std::to_string(positions.rows()) +
                                " numbers expected, one for each node, got " + std::to_string(size));
  };
  if (offsets) check("clock_offsets_s", offsets->size());
  if (sigmas) check("node_sigmas_s", sigmas->size());
  std::vector<Node> nodes(positions.rows());
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    const auto row = positions.row(i);
    nodes[i].position_m = {row[0], row[1], row[2]};
    if (offsets) nodes[i].clock_offset_s = (*offsets)[i];
    if (sigmas) nodes[i].sigma_s = (*sigmas)[i];
  }
  return nodes;
}

FixDimension dimension_of(std::optional<int> dimensions) {
  if (!dimensions) return FixDimension::kAuto;
  if (*dimensions == 2) return FixDimension::kPlanar;
  if (*dimensions == 3) return FixDimension::kSpatial;
  throw std::invalid_argument("dimensions: " + std::to_string(*dimensions) + " is neither 2 nor 3");
}

std::string repr(const PositionFix& fix) {
  const std::string status(navigation::to_string(fix.status));
  if (!std::isfinite(fix.position_m[0])) return "PositionFix(" + status + ")";
  char text[200];
  std::snprintf(text, sizeof text,
                "PositionFix(%s, %d-D, position_m=[%.2f, %.2f, %.2f], sigma_m=[%.2g, %.2g, %.2g], "
                "clock_bias_s=%.10f, %zu of %zu nodes)",
                status.c_str(), fix.dimensions, fix.position_m[0], fix.position_m[1], fix.position_m[2],
                std::sqrt(fix.covariance_m2(0, 0)), std::sqrt(fix.covariance_m2(1, 1)),
                std::sqrt(fix.covariance_m2(2, 2)), fix.clock_bias_s, fix.used_count(), fix.use.size());
  return text;
}

}  // namespace

void register_navigation(py::module_& m) {
  py::native_enum<FixStatus>(m, "FixStatus", "enum.Enum", "How a fix ended.")
      .value("CONVERGED", FixStatus::kConverged)
      .value("AMBIGUOUS", FixStatus::kAmbiguous)
      .value("INCONSISTENT", FixStatus::kInconsistent)
      .value("TOO_FEW_NODES", FixStatus::kTooFewNodes)
      .value("RANK_DEFICIENT", FixStatus::kRankDeficient)
      .value("NOT_CONVERGED", FixStatus::kNotConverged)
      .finalize();
  py::native_enum<NodeUse>(m, "NodeUse", "enum.Enum", "What a fix did with a node.")
      .value("USED", NodeUse::kUsed)
      .value("REJECTED", NodeUse::kRejected)
      .value("NOT_FINITE", NodeUse::kNotFinite)
      .value("BAD_SIGMA", NodeUse::kBadSigma)
      .finalize();

  py::class_<PositionFix>(m, "PositionFix",
                          "A position, what it is worth, and what became of each node. Read-only; NaN where there is "
                          "no value.")
      .def_readonly("status", &PositionFix::status, "How the fix ended.")
      .def_readonly("dimensions", &PositionFix::dimensions, "3, or 2 at a stated height.")
      .def_readonly("fell_back", &PositionFix::fell_back,
                    "The stated height was used because three dimensions were not determined.")
      .def_property_readonly(
          "position_m",
          [](py::object self) {
            const auto& fix = self.cast<const PositionFix&>();
            return view_array<double>({fix.position_m.data(), 3}, self);
          },
          "East, north, up in the nodes' frame; shape (3,).")
      .def_property_readonly(
          "covariance_m2",
          [](py::object self) {
            const auto& fix = self.cast<const PositionFix&>();  // symmetric: the order of its axes does not matter
            return view_array<double>({fix.covariance_m2.data(), 9}, self, {3, 3});
          },
          "Of position_m; zero for a stated height; shape (3, 3).")
      .def_readonly("clock_bias_s", &PositionFix::clock_bias_s,
                    "Receiver clock minus common time, modulo the period, within half of it.")
      .def_readonly("clock_sigma_s", &PositionFix::clock_sigma_s, "Standard deviation of clock_bias_s.")
      .def_readonly("dop", &PositionFix::dop, "Dilution of precision of the nodes used.")
      .def_readonly("chi_square", &PositionFix::chi_square, "Sum of squared residuals in standard deviations.")
      .def_readonly("degrees_of_freedom", &PositionFix::degrees_of_freedom, "Of chi_square.")
      .def_readonly("chi_square_limit", &PositionFix::chi_square_limit,
                    "What chi_square exceeds with the false-alarm probability.")
      .def_property_readonly(
          "use", [](const PositionFix& fix) { return std::vector<NodeUse>(fix.use.begin(), fix.use.end()); },
          "What was done with each node.")
      .def_property_readonly(
          "used",
          [](const PositionFix& fix) {
            py::array_t<bool> used(static_cast<py::ssize_t>(fix.use.size()));
            for (std::size_t i = 0; i < fix.use.size(); ++i) used.mutable_at(static_cast<py::ssize_t>(i)) = fix.used(i);
            return used;
          },
          "Whether each node took part; shape (nodes,).")
      .def_property_readonly(
          "residuals_m",
          [](py::object self) {
            const auto& values = self.cast<const PositionFix&>().residuals_m;
            return view_array<double>({values.data(), values.size()}, self);
          },
          "Measured minus predicted, of the fit for a node used, of the others' prediction for one rejected.")
      .def_property_readonly(
          "gates_m",
          [](py::object self) {
            const auto& values = self.cast<const PositionFix&>().gates_m;
            return view_array<double>({values.data(), values.size()}, self);
          },
          "What each residual may reach; NaN where no other node controls it.")
      .def_property_readonly(
          "alternatives_m",
          [](py::object self) {
            const auto& m3 = self.cast<const PositionFix&>().alternatives_m;
            const auto n = static_cast<std::size_t>(m3.cols());
            return view_array<double>({m3.data(), 3 * n}, self, {static_cast<py::ssize_t>(n), 3});
          },
          "Other positions that fit as well; shape (k, 3).")
      .def_property_readonly(
          "alternative_clock_biases_s",
          [](py::object self) {
            const auto& values = self.cast<const PositionFix&>().alternative_clock_biases_s;
            return view_array<double>({values.data(), static_cast<std::size_t>(values.size())}, self);
          },
          "Their clock biases; shape (k,).")
      .def_property_readonly("unobservable", &PositionFix::unobservable,
                             "Directions that the nodes do not determine, in words; empty when all are.")
      .def_readonly("nodes_in_line", &PositionFix::nodes_in_line,
                    "Nodes lie in one line (2-D) or plane (3-D): the fix has a mirror image.")
      .def_property_readonly("message", &PositionFix::message, "One sentence: what the fix is, or why there is none.")
      .def("__repr__", [](const PositionFix& fix) { return repr(fix); });

  m.def(
      "position_fix",
      [](const Table<"nodes_enu_m">& nodes_enu_m, const RealArray<"toas_s">& toas_s,
         const RealArray<"sigmas_s">& sigmas_s, const std::optional<RealArray<"clock_offsets_s">>& clock_offsets_s,
         const std::optional<RealArray<"node_sigmas_s">>& node_sigmas_s, std::optional<int> dimensions,
         std::optional<double> height_m, const std::optional<RealArray<"near_m">>& near_m, double period_s,
         bool reject_outliers, double false_alarm_probability, int max_iterations) {
        const auto nodes = make_nodes(nodes_enu_m, clock_offsets_s, node_sigmas_s);
        navigation::PositionFixOptions options;
        options.dimension = dimension_of(dimensions);
        options.height_m = height_m;
        if (near_m) {
          if (near_m->size() != 3) throw std::invalid_argument("near_m: three numbers expected");
          options.near_m = Eigen::Vector3d((*near_m)[0], (*near_m)[1], (*near_m)[2]);
        }
        options.period_s = period_s;
        options.reject_outliers = reject_outliers;
        options.false_alarm_probability = false_alarm_probability;
        options.max_iterations = max_iterations;
        const py::gil_scoped_release release;
        return std::make_unique<PositionFix>(navigation::position_fix(nodes, toas_s.span(), sigmas_s.span(), options));
      },
      py::arg("nodes_enu_m"), py::arg("toas_s"), py::arg("sigmas_s"), py::kw_only(),
      py::arg("clock_offsets_s") = py::none(), py::arg("node_sigmas_s") = py::none(),
      py::arg("dimensions") = py::none(), py::arg("height_m") = py::none(), py::arg("near_m") = py::none(),
      py::arg("period_s") = 10e-3, py::arg("reject_outliers") = true, py::arg("false_alarm_probability") = 1e-3,
      py::arg("max_iterations") = 50, "Position and receiver clock from times of arrival.");

  register_doppler_fix(m);
}

}  // namespace soopnav::python
