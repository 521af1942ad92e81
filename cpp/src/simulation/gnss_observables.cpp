#include "soopnav/simulation/gnss_observables.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>

#include "simulation/require.hpp"
#include "soopnav/core/constants.hpp"
#include "soopnav/geometry/local_frame.hpp"

namespace soopnav::simulation {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kLambdaM = kSpeedOfLightMps / gnss::kL1Hz;
constexpr std::uint64_t kDrawsPerEpoch = 4;  // code, phase, Doppler, multipath

bool not_negative(double x) { return x >= 0.0 && std::isfinite(x); }

}  // namespace

void GnssObservableOptions::check() const {
  require(elevation_mask_rad >= -kPi / 2 && elevation_mask_rad < kPi / 2, "elevation_mask_rad", elevation_mask_rad,
          "must be in [-pi/2, pi/2)");
  require(std::isfinite(cn0_zenith_dbhz), "cn0_zenith_dbhz", cn0_zenith_dbhz, "must be finite");
  require(not_negative(cn0_drop_db), "cn0_drop_db", cn0_drop_db, "must be finite and not negative");
  code_loop.check();
  phase_loop.check();
  if (code_sigma_m)
    require(not_negative(*code_sigma_m), "code_sigma_m", *code_sigma_m, "must be finite and not negative");
  if (phase_sigma_m) {
    require(not_negative(*phase_sigma_m), "phase_sigma_m", *phase_sigma_m, "must be finite and not negative");
  }
  require(not_negative(doppler_sigma_hz), "doppler_sigma_hz", doppler_sigma_hz, "must be finite and not negative");
  require(not_negative(multipath_sigma_m), "multipath_sigma_m", multipath_sigma_m, "must be finite and not negative");
  require(multipath_time_s > 0.0 && std::isfinite(multipath_time_s), "multipath_time_s", multipath_time_s,
          "must be positive and finite");
  require(multipath_phase_ratio >= 0.0 && multipath_phase_ratio <= 1.0, "multipath_phase_ratio", multipath_phase_ratio,
          "must be in [0, 1]");
  if (ionosphere) ionosphere->check();
  require(relative_humidity >= 0.0 && relative_humidity <= 1.0, "relative_humidity", relative_humidity,
          "must be in [0, 1]");
  require(max_age_s >= 0.0, "max_age_s", max_age_s, "must not be negative");
}

GnssObservables::GnssObservables(gnss::EphemerisTable ephemerides, const GnssObservableOptions& options,
                                 std::size_t antennas, const RandomStream& stream)
    : table_(std::move(ephemerides)), options_(options), stream_(stream), prns_(table_.prns()) {
  options_.check();
  require(antennas >= 1, "antennas", static_cast<double>(antennas), "must be at least 1");
  integers_.assign(antennas * prns_.size(), 0.0);
  multipath_.resize(integers_.size());
  if (options_.integers) {
    for (std::size_t antenna = 0; antenna < antennas; ++antenna) {
      for (std::size_t i = 0; i < prns_.size(); ++i) {
        RandomStream own = stream_.substream(antenna).substream(static_cast<std::uint64_t>(prns_[i])).substream(1);
        integers_[antenna * prns_.size() + i] = std::floor(own.uniform(-1e6, 1e6));
      }
    }
  }
}

std::span<const double> GnssObservables::integers(std::size_t antenna) const noexcept {
  return std::span(integers_).subspan(antenna * prns_.size(), prns_.size());
}

void GnssObservables::observe(std::size_t antenna, std::uint64_t epoch, const Epoch& receive_clock,
                              const Eigen::Vector3d& p_e, const Eigen::Vector3d& v_e, double clock_bias_m,
                              double clock_drift_mps, std::span<GnssObservable> out) noexcept {
  const Epoch t = receive_clock - clock_bias_m / kSpeedOfLightMps;
  const auto place = geometry::ecef_to_geodetic(p_e);
  const auto when = gnss::week_and_second(t);
  const Eigen::Matrix3d T_enu_e =
      place ? geometry::rotation_ecef_to_enu(place->latitude_rad, place->longitude_rad) : Eigen::Matrix3d::Identity();
  for (std::size_t i = 0; i < std::min(out.size(), prns_.size()); ++i) {
    out[i] = {false, kNan, kNan, kNan, kNan, kNan, kNan, kNan, kNan};
    const gnss::Ephemeris* eph = place && when ? table_.find(prns_[i], t, options_.max_age_s) : nullptr;
    const auto seen = eph != nullptr ? gnss::sight(*eph, t, p_e, v_e) : std::nullopt;
    if (!seen) continue;
    const auto direction = geometry::direction_enu(Eigen::Vector3d::Zero(), T_enu_e * seen->direction_e);
    if (!direction || direction->elevation_rad < options_.elevation_mask_rad) continue;

    GnssObservable& o = out[i];
    o.visible = true;
    o.range_m = seen->range_m;
    o.range_rate_mps = seen->range_rate_mps;
    o.azimuth_rad = direction->azimuth_rad;
    o.elevation_rad = direction->elevation_rad;
    o.cn0_dbhz = options_.cn0_zenith_dbhz - options_.cn0_drop_db * (1.0 - std::sin(o.elevation_rad));

    const RandomStream pair = stream_.substream(antenna).substream(static_cast<std::uint64_t>(prns_[i]));
    RandomStream draws = pair;
    draws.seek(epoch * kDrawsPerEpoch);
    std::array<double, kDrawsPerEpoch> normal{};
    draws.fill_normal(normal);

    double code_noise = 0.0;
    double phase_noise = 0.0;
    double doppler_noise = 0.0;
    if (options_.noise) {
      code_noise = normal[0] * options_.code_sigma_m.value_or(gps::code_sigma_m(o.cn0_dbhz, options_.code_loop));
      phase_noise = normal[1] * options_.phase_sigma_m.value_or(gps::phase_sigma_m(o.cn0_dbhz, options_.phase_loop));
      doppler_noise = normal[2] * options_.doppler_sigma_hz;
    }
    Multipath& m = multipath_[antenna * prns_.size() + i];
    const auto since = t - m.at;
    const double keep = m.started && since ? std::exp(-std::abs(*since) / options_.multipath_time_s) : 0.0;
    m.value = keep * m.value + std::sqrt(1.0 - keep * keep) * normal[3];
    m.at = t;
    m.started = true;
    const double multipath = options_.multipath_sigma_m * std::cos(o.elevation_rad) * m.value;

    const double ionosphere =
        options_.ionosphere
            ? gnss::ionosphere_delay_m(*options_.ionosphere, *place, o.azimuth_rad, o.elevation_rad, when->second)
            : 0.0;
    const double troposphere =
        options_.troposphere ? gnss::troposphere_delay_m(*place, o.elevation_rad, options_.relative_humidity) : 0.0;
    const double common = seen->range_m + clock_bias_m - kSpeedOfLightMps * seen->at_transmission.clock_s + troposphere;
    o.code_m = common + ionosphere + multipath + code_noise;
    o.phase_cycles = (common - ionosphere + options_.multipath_phase_ratio * multipath + phase_noise) / kLambdaM +
                     integers_[antenna * prns_.size() + i];
    o.doppler_hz =
        -(seen->range_rate_mps + clock_drift_mps - kSpeedOfLightMps * seen->at_transmission.clock_rate) / kLambdaM +
        doppler_noise;
  }
}

}  // namespace soopnav::simulation
