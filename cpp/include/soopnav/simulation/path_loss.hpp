#pragma once

#include "soopnav/core/random.hpp"

/// Link budgets. Losses are positive decibels. Parameters out of range throw std::invalid_argument naming them.
namespace soopnav::simulation {

/// Free-space path loss between isotropic antennas, 20 log10(4 pi d f / c) [dB] (ITU-R P.525-4, equation 4).
/// Negative nearer than c / (4 pi f), where there is no far field to speak of.
/// @throws std::invalid_argument unless both are finite and positive.
[[nodiscard]] double free_space_path_loss_db(double distance_m, double frequency_hz);

/// Log-distance path loss: reference_loss_db + 10 exponent log10(d / d0) [dB] (Rappaport, Wireless Communications, 2nd
/// edition, equation 4.68 without shadowing). Exponent 2 with the free-space loss at d0 is free space.
/// @throws std::invalid_argument unless the distances are finite and positive, the exponent and the loss finite and the
/// exponent >= 0.
[[nodiscard]] double log_distance_path_loss_db(double distance_m, double exponent, double reference_distance_m,
                                               double reference_loss_db);

/// A draw of log-normal shadowing to add to a loss: normal with zero mean and `sigma_db` [dB]. Takes one number.
/// @throws std::invalid_argument unless sigma_db is finite and >= 0.
[[nodiscard]] double shadowing_db(double sigma_db, RandomStream& random);

/// Power received over free space by Friis' equation, with antenna gains [dBi]:
/// P_r = P_t + G_t + G_r - free_space_path_loss_db(d, f) [dBm].
/// @throws std::invalid_argument unless all are finite, distance and frequency positive.
[[nodiscard]] double friis_received_power_dbm(double transmit_power_dbm, double transmit_gain_dbi,
                                              double receive_gain_dbi, double distance_m, double frequency_hz);

/// Thermal noise k T0 B of a receiver with a noise figure, T0 = 290 K: -173.98 dBm in 1 Hz and 0 dB [dBm].
/// @throws std::invalid_argument unless bandwidth is finite and positive and the noise figure finite and >= 0.
[[nodiscard]] double thermal_noise_dbm(double bandwidth_hz, double noise_figure_db);

}  // namespace soopnav::simulation
