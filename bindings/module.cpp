#include <pybind11/pybind11.h>

#include "indoor.hpp"
#include "register.hpp"

namespace py = pybind11;

PYBIND11_MODULE(_core, m) {
  m.doc() = "The compiled engine of soopnav. Use it through the modules of soopnav_cpp, which document it.";
  auto array = m.def_submodule("array", "Antenna arrays: manifolds, covariances, directions.");
  auto clock = m.def_submodule("clock", "Oscillators, their deviations, fits to records.");
  auto dsp = m.def_submodule("dsp", "Transforms, correlation, delays and resampling.");
  auto estimation = m.def_submodule("estimation", "What an estimate is worth: dilution of precision, ellipses.");
  auto geometry = m.def_submodule("geometry", "Earth, local frames and directions.");
  auto gnss = m.def_submodule("gnss", "Satellite navigation: orbits, positions, attitude.");
  auto gps = m.def_submodule("gps", "GPS L1 C/A: codes, signals, tracking noise.");
  auto iridium = m.def_submodule("iridium", "Iridium: channels, bursts, their detection.");
  auto inertial = m.def_submodule("inertial", "Inertial navigation: increments, mechanisation, alignment, rest.");
  auto lte = m.def_submodule("lte", "LTE downlink: sequences, synthesis, cell search, time of arrival.");
  auto measurement = m.def_submodule("measurement", "Measurement models.");
  auto ofdm = m.def_submodule("ofdm", "OFDM: symbols, cyclic-prefix correlator, blind symbol boundaries.");
  auto process = m.def_submodule("process", "Process models.");
  auto simulation = m.def_submodule("simulation", "Channels: noise, carrier offset, clock error, path loss.");
  auto vision = m.def_submodule("vision", "Cameras, planes of ground, motion over it.");
  auto navigation = m.def_submodule("navigation", "Positions from observations.");
  soopnav::python::register_array(array);
  soopnav::python::register_calibration(array);
  soopnav::python::register_synthetic_aperture(array);
  soopnav::python::register_clock(clock);
  soopnav::python::register_dsp(dsp);
  soopnav::python::register_measurement(measurement);
  soopnav::python::register_process(process);
  soopnav::python::register_estimation(estimation);
  soopnav::python::register_estimation_bounds(estimation);
  soopnav::python::register_estimation_linear(estimation);
  soopnav::python::register_kalman_report(estimation);
  soopnav::python::register_adaptive_noise(estimation);
  soopnav::python::register_kalman(estimation);
  soopnav::python::register_fixed_lag(estimation);
  soopnav::python::register_multiple_model(estimation);
  soopnav::python::register_particle(estimation);
  soopnav::python::register_geometry(geometry);
  soopnav::python::register_gravity(geometry);
  soopnav::python::register_gnss(gnss);
  soopnav::python::register_gnss_attitude(gnss);
  soopnav::python::register_gps(gps);
  soopnav::python::register_inertial(inertial);
  soopnav::python::register_lte(lte);
  soopnav::python::register_lte_paths(lte);
  soopnav::python::register_lte_tracking(lte);
  soopnav::python::register_ofdm(ofdm);
  soopnav::python::register_simulation(simulation);
  soopnav::python::register_indoor(simulation);
  soopnav::python::register_sounding(simulation);
  soopnav::python::register_gnss_simulation(simulation);
  soopnav::python::register_handset_world(simulation);
  soopnav::python::register_trajectory(simulation);
  soopnav::python::register_spatial_trajectory(simulation);
  soopnav::python::register_ofdm_link(simulation);
  soopnav::python::register_array_link(simulation);
  soopnav::python::register_aperture_link(simulation);
  soopnav::python::register_navigation(navigation);
  soopnav::python::register_handset(navigation);
  soopnav::python::register_node_mapper(navigation);
  soopnav::python::register_source(navigation);
  soopnav::python::register_ofdm_inertial(navigation);
  soopnav::python::register_strapdown(navigation);
  soopnav::python::register_ground_plane(vision);
  soopnav::python::register_vision(vision);
  soopnav::python::register_ground(vision);
  soopnav::python::register_iridium(iridium);
  soopnav::python::register_ambiguity(dsp);
  soopnav::python::register_orbits(geometry);
  soopnav::python::register_pair_link(simulation);
  soopnav::python::register_cooperative(navigation);
  soopnav::python::register_cooperative_group(navigation);
  soopnav::python::register_ground_scene(simulation);
}
