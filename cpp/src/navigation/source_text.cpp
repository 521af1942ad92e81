#include <cmath>
#include <cstdio>
#include <stdexcept>
#include <string>

#include "soopnav/core/angle.hpp"
#include "soopnav/core/constants.hpp"
#include "soopnav/navigation/source_locator.hpp"

namespace soopnav::navigation {
namespace {

std::string number(double value) {
  char text[40];
  std::snprintf(text, sizeof text, "%.6g", value);
  return text;
}

void require(bool holds, const char* name, double value, const char* rule) {
  if (!holds) throw std::invalid_argument(std::string(name) + " = " + number(value) + ": " + rule);
}

}  // namespace

std::string_view to_string(SourceMethod method) noexcept {
  switch (method) {
    case SourceMethod::kCentroid:
      return "centroid";
    case SourceMethod::kIncenter:
      return "incenter";
    case SourceMethod::kLinear:
      return "linear";
    case SourceMethod::kStansfield:
      return "stansfield";
    case SourceMethod::kLeastSquares:
      return "least squares";
    case SourceMethod::kMaximumLikelihood:
      return "maximum likelihood";
    case SourceMethod::kExtendedKalman:
      return "extended Kalman filter";
    case SourceMethod::kEkfBank:
      return "bank of extended Kalman filters";
    case SourceMethod::kParticle:
      return "particle filter";
  }
  return "unknown";
}

std::string_view to_string(BearingUse use) noexcept {
  switch (use) {
    case BearingUse::kUsed:
      return "used";
    case BearingUse::kNotFinite:
      return "not finite";
    case BearingUse::kBadSigma:
      return "bad sigma";
    case BearingUse::kOutOfOrder:
      return "out of order";
    case BearingUse::kWaiting:
      return "waiting for a better bearing";
    case BearingUse::kUndefined:
      return "undefined at the platform";
  }
  return "unknown";
}

std::string_view to_string(SourceStatus status) noexcept {
  switch (status) {
    case SourceStatus::kConverged:
      return "converged";
    case SourceStatus::kTooFewBearings:
      return "too few bearings";
    case SourceStatus::kUnobservable:
      return "unobservable";
    case SourceStatus::kInconsistent:
      return "inconsistent";
    case SourceStatus::kOnPlatform:
      return "on the platform";
    case SourceStatus::kNotConverged:
      return "not converged";
    case SourceStatus::kDiverged:
      return "diverged";
  }
  return "unknown";
}

void SourceOptions::check() const {
  const bool searched = method == SourceMethod::kMaximumLikelihood || method == SourceMethod::kLeastSquares;
  const bool stated = searched || method == SourceMethod::kExtendedKalman || method == SourceMethod::kEkfBank;
  require(dimensions == 2 || dimensions == 3, "dimensions", dimensions, "2 or 3 expected");
  if (motion == SourceMotion::kConstantVelocity && !stated) {
    throw std::invalid_argument("motion: " + std::string(to_string(method)) + " is for a source at rest");
  }
  if (heading_bias_sigma_rad > 0.0 && !stated) {
    throw std::invalid_argument("heading_bias_sigma_rad: " + std::string(to_string(method)) +
                                " estimates no heading bias");
  }
  if (start_m && !(start_m->allFinite())) throw std::invalid_argument("start_m: finite numbers expected");
  const auto positive = [](double v) { return v > 0.0 && std::isfinite(v); };
  require(positive(start_sigma_m), "start_sigma_m", start_sigma_m, "a positive number expected");
  require(positive(start_speed_sigma_mps), "start_speed_sigma_mps", start_speed_sigma_mps,
          "a positive number expected");
  require(acceleration_psd >= 0.0 && std::isfinite(acceleration_psd), "acceleration_psd", acceleration_psd,
          "zero or a positive number expected");
  require(positive(min_range_m), "min_range_m", min_range_m, "a positive number expected");
  require(max_range_m > min_range_m && std::isfinite(max_range_m), "max_range_m", max_range_m,
          "more than min_range_m expected");
  require(outlier_probability >= 0.0 && outlier_probability < 1.0, "outlier_probability", outlier_probability,
          "[0, 1) expected");
  require(heading_bias_sigma_rad >= 0.0 && std::isfinite(heading_bias_sigma_rad), "heading_bias_sigma_rad",
          heading_bias_sigma_rad, "zero or a positive number expected");
  require(min_crossing_rad > 0.0 && min_crossing_rad < 0.5 * kPi, "min_crossing_rad", min_crossing_rad,
          "between 0 and pi/2 expected");
  require(triple_spacing >= 1 && triple_spacing <= 100000, "triple_spacing", triple_spacing, "1 ... 100 000 expected");
  require(grid_size >= 8 && grid_size <= 512, "grid_size", grid_size, "8 ... 512 expected");
  require(max_iterations >= 1, "max_iterations", max_iterations, "at least 1 expected");
  require(particles >= 16 && particles <= 10'000'000, "particles", static_cast<double>(particles),
          "16 ... 10 000 000 expected");
  require(ess_threshold > 0.0 && ess_threshold <= 1.0, "ess_threshold", ess_threshold, "(0, 1] expected");
  require(filters >= 2 && filters <= 64, "filters", filters, "2 ... 64 expected");
  require(bank_sigma_rad > 0.0 && std::isfinite(bank_sigma_rad), "bank_sigma_rad", bank_sigma_rad,
          "a positive number expected");
  require(bank_azimuths >= 0 && bank_azimuths <= 36, "bank_azimuths", bank_azimuths, "0 ... 36 expected");
  const std::size_t least = method == SourceMethod::kCentroid || method == SourceMethod::kIncenter
                                ? 2 * static_cast<std::size_t>(triple_spacing) + 2
                                : 8;
  require(max_bearings >= least && max_bearings <= 10'000'000, "max_bearings", static_cast<double>(max_bearings),
          "8 ... 10 000 000 expected, and room for a triangle of triple_spacing");
  require(false_alarm_probability > 0.0 && false_alarm_probability < 0.5, "false_alarm_probability",
          false_alarm_probability, "between 0 and 0.5 expected");
}

std::string SourceFix::message() const {
  char text[240];
  std::string out;
  const auto where = [&] {
    if (dimensions == 3) {
      std::snprintf(text, sizeof text, "(%.2f, %.2f, %.2f) m, sigma (%.2g, %.2g, %.2g) m", position_m[0], position_m[1],
                    position_m[2], std::sqrt(covariance_m2(0, 0)), std::sqrt(covariance_m2(1, 1)),
                    std::sqrt(covariance_m2(2, 2)));
    } else {
      std::snprintf(text, sizeof text, "(%.2f, %.2f) m, sigma (%.2g, %.2g) m", position_m[0], position_m[1],
                    std::sqrt(covariance_m2(0, 0)), std::sqrt(covariance_m2(1, 1)));
    }
    return std::string(text);
  };
  switch (status) {
    case SourceStatus::kConverged:
      out = "the source is at " + where();
      break;
    case SourceStatus::kTooFewBearings:
      out = "too few bearings for a position";
      break;
    case SourceStatus::kUnobservable:
      out = "the range is not observable: the bearings are parallel or from one place";
      break;
    case SourceStatus::kInconsistent:
      out = "no position explains the bearings; the best is " + where();
      break;
    case SourceStatus::kOnPlatform:
      out = "the source is not told from the platform: " + where();
      break;
    case SourceStatus::kNotConverged:
      out = "no minimum found; the best point seen is " + where();
      break;
    case SourceStatus::kDiverged:
      out = "diverged: nothing explains the bearings any more";
      break;
  }
  if (line) {
    std::snprintf(text, sizeof text, "; it lies on the line from (%.2f, %.2f) m at azimuth %.2f deg, sigma %.2g deg",
                  line->point_m[0], line->point_m[1], degrees(std::atan2(line->direction[1], line->direction[0])),
                  degrees(line->sigma_rad));
    out += text;
  }
  out += "; " + std::to_string(used) + " bearings used";
  if (outliers > 0) out += ", " + std::to_string(outliers) + " of them outliers";
  if (rejected > 0) {
    out += ", " + std::to_string(rejected) + " left out (the last: " + std::string(to_string(last)) + ")";
    if (last == BearingUse::kUsed) out = out.substr(0, out.rfind(" (the last"));
  }
  return out;
}

}  // namespace soopnav::navigation
