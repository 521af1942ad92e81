#include <pybind11/native_enum.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <cstdint>
#include <stdexcept>
#include <utility>
#include <vector>

#include "array.hpp"
#include "indoor.hpp"
#include "soopnav/navigation/node_mapper.hpp"

namespace soopnav::python {

namespace {

using navigation::ClockMotion;
using navigation::NodeMap;
using navigation::NodeMapper;
using navigation::NodeMapperOptions;
using navigation::NodeMapStatus;
using navigation::NodeStart;

py::array_t<double> pairs_array(const std::vector<Eigen::Vector2d>& pairs) {
  std::vector<double> out;
  out.reserve(2 * pairs.size());
  for (const auto& p : pairs) out.insert(out.end(), {p.x(), p.y()});
  return to_array(std::move(out), {static_cast<py::ssize_t>(pairs.size()), 2});
}

py::array_t<double> square_array(const Eigen::MatrixXd& m) {
  return to_array(std::vector<double>(m.data(), m.data() + m.size()), {m.rows(), m.cols()});  // symmetric
}

py::tuple locate(const RealArray<"t_s">& t_s, const Table<"track_m">& track, const Table<"ranges_m">& ranges,
                 const Numbers<"sigma_m">& sigma, const RealArray<"heights_m">& heights, ClockMotion clock,
                 double clock_m_per_sqrt_s, double track_m_per_sqrt_s, double heading_rad_per_sqrt_s,
                 double max_distance_m, int starts, int max_iterations, double ambiguity_cost, std::uint64_t seed) {
  NodeMapperOptions o;
  o.clock = clock;
  o.clock_m_per_sqrt_s = clock_m_per_sqrt_s;
  o.track_m_per_sqrt_s = track_m_per_sqrt_s;
  o.heading_rad_per_sqrt_s = heading_rad_per_sqrt_s;
  o.max_distance_m = max_distance_m;
  o.starts = starts;
  o.max_iterations = max_iterations;
  o.ambiguity_cost = ambiguity_cost;
  o.seed = seed;
  const NodeMapper mapper(o);
  if (track.rows() > 0 && track.columns() != 3) throw std::invalid_argument("track_m: shape (n, 3) expected");
  if (ranges.columns() != heights.size() && ranges.rows() > 0) {
    throw std::invalid_argument("heights_m: one for each column of ranges_m expected");
  }
  std::vector<Eigen::Vector3d> places(track.rows());
  std::vector<double> z;
  z.reserve(ranges.rows() * ranges.columns());
  for (std::size_t k = 0; k < places.size(); ++k) {
    const auto row = track.row(k);
    places[k] = {row[0], row[1], row[2]};
  }
  for (std::size_t k = 0; k < ranges.rows(); ++k) {
    const auto row = ranges.row(k);
    z.insert(z.end(), row.begin(), row.end());
  }
  NodeMap map;
  {
    const py::gil_scoped_release release;
    map = mapper.locate(t_s.span(), places, z, sigma.span(), heights.span());
  }
  return py::make_tuple(map.status, pairs_array(map.position_m), square_array(map.covariance_m2),
                        to_array(std::move(map.offset_m)), to_array(std::move(map.offset_sigma_m)),
                        std::vector<bool>(map.mirrored), pairs_array(map.mirror_m), to_array(std::move(map.clock_m)),
                        pairs_array(map.track_m), to_array(std::move(map.heading_rad)), map.cost,
                        map.degrees_of_freedom, map.observations, map.undetermined, map.iterations, map.starts);
}

}  // namespace

void register_node_mapper(py::module_& m) {
  py::native_enum<ClockMotion>(m, "ClockMotion", "enum.Enum", "How the receiver's clock goes from epoch to epoch.")
      .value("RANDOM_WALK", ClockMotion::kRandomWalk)
      .value("FREE", ClockMotion::kFree)
      .finalize();
  py::native_enum<NodeMapStatus>(m, "NodeMapStatus", "enum.Enum", "How a map of nodes came out.")
      .value("OK", NodeMapStatus::kOk)
      .value("TOO_FEW", NodeMapStatus::kTooFew)
      .value("UNDETERMINED", NodeMapStatus::kUndetermined)
      .value("NOT_CONVERGED", NodeMapStatus::kNotConverged)
      .value("POOR_FIT", NodeMapStatus::kPoorFit)
      .finalize();
  m.def("locate_nodes", &locate, py::arg("t_s"), py::arg("track_m"), py::arg("ranges_m"), py::arg("sigma_m"),
        py::arg("heights_m"), py::kw_only(), py::arg("clock"), py::arg("clock_m_per_sqrt_s"),
        py::arg("track_m_per_sqrt_s"), py::arg("heading_rad_per_sqrt_s"), py::arg("max_distance_m"), py::arg("starts"),
        py::arg("max_iterations"), py::arg("ambiguity_cost"), py::arg("seed"), "Nodes from ranges along a walk.");
  m.def(
      "start_node",
      [](const Table<"track_m">& track, const RealArray<"ranges_m">& ranges, double sigma_m, double max_distance_m,
         double height_m) {
        if (track.rows() > 0 && track.columns() != 2) throw std::invalid_argument("track_m: shape (n, 2) expected");
        if (track.rows() != ranges.size()) throw std::invalid_argument("ranges_m: one for each place expected");
        std::vector<Eigen::Vector2d> places(track.rows());
        for (std::size_t k = 0; k < places.size(); ++k) places[k] = {track.row(k)[0], track.row(k)[1]};
        NodeStart s;
        {
          const py::gil_scoped_release release;
          s = navigation::start_node(places, ranges.span(), sigma_m, max_distance_m, height_m);
        }
        return py::make_tuple(s.ok, pairs_array({s.position_m, s.mirror_m}), s.offset_m, s.mirror_offset_m, s.cost,
                              s.mirror_cost, square_array(s.covariance));
      },
      py::arg("track_m"), py::arg("ranges_m"), py::arg("sigma_m"), py::arg("max_distance_m"), py::arg("height_m"),
      "Best start of one node from an exact walk.");
}

}  // namespace soopnav::python
