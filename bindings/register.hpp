#pragma once

#include <pybind11/pybind11.h>

/// One function per module of the engine; each fills the submodule it is given.
namespace soopnav::python {

void register_adaptive_noise(pybind11::module_& module);
void register_ambiguity(pybind11::module_& module);
void register_aperture_link(pybind11::module_& module);
void register_array(pybind11::module_& module);
void register_array_link(pybind11::module_& module);
void register_calibration(pybind11::module_& module);
void register_cdma(pybind11::module_& module);
void register_characterization(pybind11::module_& module);
void register_clock(pybind11::module_& module);
void register_coherence(pybind11::module_& module);
void register_cooperative(pybind11::module_& module);
void register_cooperative_group(pybind11::module_& module);
void register_dsp(pybind11::module_& module);
void register_estimation(pybind11::module_& module);
void register_estimation_bounds(pybind11::module_& module);
void register_estimation_linear(pybind11::module_& module);
void register_fixed_lag(pybind11::module_& module);
void register_geometry(pybind11::module_& module);
void register_gnss(pybind11::module_& module);
void register_gnss_attitude(pybind11::module_& module);
void register_gnss_simulation(pybind11::module_& module);
void register_gps(pybind11::module_& module);
void register_gps_phase(pybind11::module_& module);
void register_gps_receiver(pybind11::module_& module);
void register_gravity(pybind11::module_& module);
void register_ground(pybind11::module_& module);
void register_ground_plane(pybind11::module_& module);
void register_ground_scene(pybind11::module_& module);
void register_handset(pybind11::module_& module);
void register_handset_world(pybind11::module_& module);
void register_indoor(pybind11::module_& simulation);
void register_inertial(pybind11::module_& module);
void register_iridium(pybind11::module_& module);
void register_kalman(pybind11::module_& module);
void register_kalman_report(pybind11::module_& module);
void register_lte(pybind11::module_& module);
void register_lte_paths(pybind11::module_& module);
void register_lte_tracking(pybind11::module_& module);
void register_measurement(pybind11::module_& module);
void register_multiple_model(pybind11::module_& module);
void register_navigation(pybind11::module_& module);
void register_ofdm(pybind11::module_& module);
void register_ofdm_inertial(pybind11::module_& module);
void register_ofdm_link(pybind11::module_& module);
void register_opportunistic(pybind11::module_& module);
void register_opportunity_link(pybind11::module_& module);
void register_orbits(pybind11::module_& module);
void register_pair_link(pybind11::module_& module);
void register_particle(pybind11::module_& module);
void register_phase_stitcher(pybind11::module_& module);
void register_process(pybind11::module_& module);
void register_simulation(pybind11::module_& module);
void register_sop_catalog(pybind11::module_& module);
void register_source(pybind11::module_& module);
void register_spatial_trajectory(pybind11::module_& module);
void register_strapdown(pybind11::module_& module);
void register_synthetic_aperture(pybind11::module_& module);
void register_tracking(pybind11::module_& module);
void register_trajectory(pybind11::module_& module);
void register_vision(pybind11::module_& module);

}  // namespace soopnav::python
