#include <pybind11/complex.h>
#include <pybind11/native_enum.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <complex>
#include <cstdint>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "array.hpp"
#include "register.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/simulation/indoor_room.hpp"

namespace soopnav::python {

namespace {

using simulation::IndoorLink;
using simulation::IndoorRoom;
using simulation::IndoorRoomOptions;
using simulation::LinkStatus;
using simulation::Material;
using simulation::RoomNode;
using simulation::Wall;
using WallTuple = std::tuple<double, double, double, double, Material, double>;

template <class Numbers>
std::vector<Eigen::Vector3d> rows_of_three(const Numbers& table, const char* name) {
  table.require_axes({2}, "float64 with shape (n, 3)");
  if (table.shape()[1] != 3) throw std::invalid_argument(std::string(name) + ": rows of three numbers expected");
  std::vector<Eigen::Vector3d> out(static_cast<std::size_t>(table.shape()[0]));
  for (std::size_t i = 0; i < out.size(); ++i) {
    out[i] = {table.span()[3 * i], table.span()[3 * i + 1], table.span()[3 * i + 2]};
  }
  return out;
}

Wall wall_of(const WallTuple& t) {
  const auto& [ax, ay, bx, by, material, thickness_m] = t;
  return {{ax, ay}, {bx, by}, material, thickness_m};
}

WallTuple tuple_of(const Wall& w) {
  return {w.from_m.x(), w.from_m.y(), w.to_m.x(), w.to_m.y(), w.material, w.thickness_m};
}

std::vector<WallTuple> tuples_of(const std::vector<Wall>& walls) {
  std::vector<WallTuple> out;
  for (const Wall& wall : walls) out.push_back(tuple_of(wall));
  return out;
}

py::tuple room_links(const IndoorRoom& room, const Numbers<"nodes_m">& nodes, const Numbers<"places_m">& places) {
  const auto at = rows_of_three(nodes, "nodes_m");
  const auto where = rows_of_three(places, "places_m");
  const std::size_t n = where.size(), links = at.size();
  std::vector<std::int64_t> status(n * links), paths(n * links), start(n * links + 1, 0);
  std::vector<std::uint8_t> sight(n * links);
  std::vector<double> distance(n * links), loss(n * links), power(n * links), excess(n * links), delay;
  std::vector<std::complex<double>> gain;
  {
    const py::gil_scoped_release release;
    std::vector<RoomNode> ready;
    for (const auto& p : at) ready.push_back(room.node(p));
    IndoorLink link = room.make_link();
    for (std::size_t k = 0; k < n; ++k) {
      for (std::size_t l = 0; l < links; ++l) {
        const std::size_t i = k * links + l;
        room.link(ready[l], where[k], link);
        status[i] = static_cast<std::int64_t>(link.status);
        sight[i] = link.line_of_sight ? 1 : 0;
        distance[i] = link.distance_m;
        loss[i] = link.wall_loss_db;
        power[i] = link.power_db;
        excess[i] = link.excess_delay_s;
        paths[i] = link.paths;
        for (const auto& tap : link.taps) {
          delay.push_back(tap.delay_s);
          gain.push_back(tap.gain);
        }
        start[i + 1] = static_cast<std::int64_t>(delay.size());
      }
    }
  }
  const std::vector<py::ssize_t> shape{static_cast<py::ssize_t>(n), static_cast<py::ssize_t>(links)};
  return py::make_tuple(to_array(std::move(status), shape), to_array(std::move(sight), shape),
                        to_array(std::move(distance), shape), to_array(std::move(loss), shape),
                        to_array(std::move(power), shape), to_array(std::move(excess), shape),
                        to_array(std::move(paths), shape), to_array(std::move(start)), to_array(std::move(delay)),
                        to_array(std::move(gain)));
}

void register_room(py::module_& m) {
  py::native_enum<Material>(m, "Material", "enum.Enum", "What a wall is made of (ITU-R P.2040-2, table 3).")
      .value("CONCRETE", Material::kConcrete)
      .value("BRICK", Material::kBrick)
      .value("PLASTER", Material::kPlaster)
      .value("WOOD", Material::kWood)
      .value("GLASS", Material::kGlass)
      .value("METAL", Material::kMetal)
      .finalize();
  py::native_enum<LinkStatus>(m, "LinkStatus", "enum.Enum", "How a link of an indoor room came out.")
      .value("OK", LinkStatus::kOk)
      .value("NOT_FINITE", LinkStatus::kNotFinite)
      .value("TOO_CLOSE", LinkStatus::kTooClose)
      .value("DARK", LinkStatus::kDark)
      .finalize();
  py::class_<IndoorRoom>(m, "IndoorRoom", "Propagation in and into a room by the image method.")
      .def(py::init([](const std::vector<WallTuple>& walls, double carrier_hz, int order, double height_m,
                       bool floor_and_ceiling, Material floor_material, double floor_thickness_m, double path_range_db,
                       double detect_range_db, double los_loss_db, double tail_db, double tail_decay_s,
                       double tail_spacing_s, int tail_taps, std::uint64_t seed) {
             std::vector<Wall> made;
             for (const auto& wall : walls) made.push_back(wall_of(wall));
             IndoorRoomOptions o;
             o.carrier_hz = carrier_hz;
             o.order = order;
             o.height_m = height_m;
             o.floor_and_ceiling = floor_and_ceiling;
             o.floor_material = floor_material;
             o.floor_thickness_m = floor_thickness_m;
             o.path_range_db = path_range_db;
             o.detect_range_db = detect_range_db;
             o.los_loss_db = los_loss_db;
             o.tail_db = tail_db;
             o.tail_decay_s = tail_decay_s;
             o.tail_spacing_s = tail_spacing_s;
             o.tail_taps = tail_taps;
             o.seed = seed;
             return IndoorRoom(std::move(made), o);
           }),
           py::arg("walls"), py::kw_only(), py::arg("carrier_hz"), py::arg("order"), py::arg("height_m"),
           py::arg("floor_and_ceiling"), py::arg("floor_material"), py::arg("floor_thickness_m"),
           py::arg("path_range_db"), py::arg("detect_range_db"), py::arg("los_loss_db"), py::arg("tail_db"),
           py::arg("tail_decay_s"), py::arg("tail_spacing_s"), py::arg("tail_taps"), py::arg("seed"))
      .def("links", &room_links, py::arg("nodes_m"), py::arg("places_m"),
           "Status, sight, distance, wall loss, power, excess delay, paths, start, delay and gain of the taps.")
      .def(
          "wall_loss_db",
          [](const IndoorRoom& room, const Numbers<"nodes_m">& nodes, const Numbers<"places_m">& places) {
            const auto at = rows_of_three(nodes, "nodes_m");
            const auto where = rows_of_three(places, "places_m");
            std::vector<double> out;
            out.reserve(at.size() * where.size());
            for (const auto& p : where) {
              for (const auto& q : at) out.push_back(room.wall_loss_db(p, q));
            }
            return to_array(std::move(out),
                            {static_cast<py::ssize_t>(where.size()), static_cast<py::ssize_t>(at.size())});
          },
          py::arg("nodes_m"), py::arg("places_m"), "What walls take from the straight paths [dB].");
  m.def(
      "with_opening",
      [](const WallTuple& wall, double start_m, double stop_m, Material material, double thickness_m) {
        return tuples_of(simulation::with_opening(wall_of(wall), start_m, stop_m, material, thickness_m));
      },
      py::arg("wall"), py::arg("start_m"), py::arg("stop_m"), py::arg("material"), py::arg("thickness_m"),
      "A wall with a piece of another material.");
  m.def(
      "slab_response",
      [](Material material, double thickness_m, double cos_incidence, double frequency_hz, bool parallel) {
        const auto s = simulation::slab_response(material, thickness_m, cos_incidence, frequency_hz, parallel);
        return py::make_tuple(s.reflection, s.transmission, s.delay_s);
      },
      py::arg("material"), py::arg("thickness_m"), py::arg("cos_incidence"), py::arg("frequency_hz"),
      py::arg("parallel") = false, "Reflection, transmission and delay of a slab.");
  m.def(
      "excess_delays",
      [](const py::array_t<std::uint8_t, py::array::c_style | py::array::forcecast>& sight, double dt_s, double low_m,
         double high_m, double wander, double floor_m, std::uint64_t seed) {
        if (sight.ndim() != 2) throw std::invalid_argument("line_of_sight: shape (n, links) expected");
        std::vector<double> out(static_cast<std::size_t>(sight.size()));
        simulation::excess_delays({sight.data(), out.size()}, static_cast<std::size_t>(sight.shape(1)), dt_s,
                                  {low_m, high_m, wander, floor_m}, RandomStream(seed), out);
        return to_array(std::move(out), {sight.shape(0), sight.shape(1)});
      },
      py::arg("line_of_sight"), py::arg("dt_s"), py::kw_only(), py::arg("low_m"), py::arg("high_m"),
      py::arg("wander_m_per_sqrt_s"), py::arg("floor_m"), py::arg("seed"), "Excess delays of links out of sight.");
}

}  // namespace

void register_indoor(py::module_& simulation) { register_room(simulation); }

}  // namespace soopnav::python
