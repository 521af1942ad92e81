#include "soopnav/simulation/path_loss.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <stdexcept>
#include <string>

#include "support/nan.hpp"

namespace soopnav::simulation {
namespace {

using ::soopnav::test::kNan;

// ITU-R P.525: 32.4 + 20 log10(f / MHz) + 20 log10(d / km), the constant being 32.45 to another digit.
TEST(PathLoss, FreeSpaceAgainstTheHandbook) {
  EXPECT_NEAR(free_space_path_loss_db(1e3, 1e6), 32.4478, 1e-4);
  EXPECT_NEAR(free_space_path_loss_db(1e3, 1e9), 92.4478, 1e-4);
  EXPECT_NEAR(free_space_path_loss_db(35'786e3, 1.57542e9), 187.47, 5e-3);
}

TEST(PathLoss, FreeSpaceGrowsBySixDecibelsPerDoubling) {
  const double doubling = 20.0 * std::log10(2.0);
  EXPECT_NEAR(free_space_path_loss_db(200.0, 8e8) - free_space_path_loss_db(100.0, 8e8), doubling, 1e-12);
  EXPECT_NEAR(free_space_path_loss_db(100.0, 16e8) - free_space_path_loss_db(100.0, 8e8), doubling, 1e-12);
}

TEST(PathLoss, LogDistanceWithExponentTwoIsFreeSpace) {
  const double at_reference = free_space_path_loss_db(10.0, 1.8e9);
  for (const double distance : {1.0, 10.0, 123.0, 1e4}) {
    EXPECT_NEAR(log_distance_path_loss_db(distance, 2.0, 10.0, at_reference), free_space_path_loss_db(distance, 1.8e9),
                1e-11);
  }
  EXPECT_NEAR(log_distance_path_loss_db(1000.0, 3.5, 10.0, 60.0), 130.0, 1e-12);
}

// Friis in linear units: P_r = P_t G_t G_r (lambda / 4 pi d)^2.
TEST(PathLoss, FriisInWatts) {
  const double wavelength = 299'792'458.0 / 739e6;
  const double watts =
      20.0 * std::pow(10.0, 1.7) * std::pow(10.0, 0.2) * std::pow(wavelength / (4.0 * 3.141592653589793 * 2500.0), 2.0);
  const double dbm = friis_received_power_dbm(10.0 * std::log10(20e3), 17.0, 2.0, 2500.0, 739e6);
  EXPECT_NEAR(dbm, 10.0 * std::log10(watts * 1e3), 1e-10);
}

TEST(PathLoss, ThermalNoise) {
  EXPECT_NEAR(thermal_noise_dbm(1.0, 0.0), -173.975, 1e-3);
  EXPECT_NEAR(thermal_noise_dbm(15e3, 5.0), -127.214, 1e-3);  // one LTE subcarrier
}

// Five standard deviations of the mean and of the variance of 20 000 draws: 6e-7 each.
TEST(PathLoss, ShadowingIsNormalInDecibels) {
  RandomStream random(12);
  constexpr int kDraws = 20'000;
  double sum = 0.0;
  double squares = 0.0;
  for (int i = 0; i < kDraws; ++i) {
    const double x = shadowing_db(8.0, random);
    sum += x;
    squares += x * x;
  }
  EXPECT_EQ(random.position(), static_cast<std::uint64_t>(kDraws));
  EXPECT_LT(std::abs(sum / kDraws), 5.0 * 8.0 / std::sqrt(1.0 * kDraws));
  EXPECT_NEAR(squares / kDraws, 64.0, 5.0 * 64.0 * std::sqrt(2.0 / kDraws));
  EXPECT_EQ(shadowing_db(0.0, random), 0.0);
}

template <class Call>
std::string refusal(Call&& call) {
  try {
    static_cast<void>(call());
  } catch (const std::invalid_argument& error) {
    return error.what();
  }
  return "";
}

TEST(PathLoss, Refusals) {
  using testing::StartsWith;
  RandomStream random(1);
  EXPECT_EQ(refusal([] { return free_space_path_loss_db(0.0, 1e9); }), "distance_m: 0; it must be finite and positive");
  EXPECT_THAT(refusal([] { return free_space_path_loss_db(1.0, kNan); }), StartsWith("frequency_hz: nan"));
  EXPECT_THAT(refusal([] { return log_distance_path_loss_db(-1.0, 2.0, 1.0, 0.0); }), StartsWith("distance_m: -1"));
  EXPECT_THAT(refusal([] { return log_distance_path_loss_db(1.0, -2.0, 1.0, 0.0); }), StartsWith("exponent: -2"));
  EXPECT_THAT(refusal([] { return log_distance_path_loss_db(1.0, 2.0, 0.0, 0.0); }),
              StartsWith("reference_distance_m: 0"));
  EXPECT_THAT(refusal([] { return log_distance_path_loss_db(1.0, 2.0, 1.0, kNan); }),
              StartsWith("reference_loss_db: nan"));
  EXPECT_THAT(refusal([&] { return shadowing_db(-1.0, random); }), StartsWith("sigma_db: -1"));
  EXPECT_THAT(refusal([] { return friis_received_power_dbm(kNan, 0.0, 0.0, 1.0, 1.0); }),
              StartsWith("transmit_power_dbm: nan"));
  EXPECT_THAT(refusal([] { return friis_received_power_dbm(0.0, kNan, 0.0, 1.0, 1.0); }),
              StartsWith("transmit_gain_dbi: nan"));
  EXPECT_THAT(refusal([] { return friis_received_power_dbm(0.0, 0.0, kNan, 1.0, 1.0); }),
              StartsWith("receive_gain_dbi: nan"));
  EXPECT_THAT(refusal([] { return thermal_noise_dbm(0.0, 0.0); }), StartsWith("bandwidth_hz: 0"));
  EXPECT_THAT(refusal([] { return thermal_noise_dbm(1.0, -1.0); }), StartsWith("noise_figure_db: -1"));
}

}  // namespace
}  // namespace soopnav::simulation
