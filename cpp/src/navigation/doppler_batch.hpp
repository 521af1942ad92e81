#pragma once

#include <Eigen/Core>
#include <cmath>
#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "soopnav/core/constants.hpp"
#include "soopnav/geometry/local_frame.hpp"
#include "soopnav/navigation/doppler_fix.hpp"

// The normal equations of a Doppler fix: what its rows and priors say at a point, and how a point moves.
namespace soopnav::navigation::doppler {

inline constexpr double kOmega = wgs84::kEarthRateRadps;
inline constexpr double kFreeBiasHz = 1e5;  // a prior so wide that it says nothing

inline Eigen::Vector3d cross_rate(const Eigen::Vector3d& v) noexcept { return {-kOmega * v.y(), kOmega * v.x(), 0.0}; }

// Which unknowns there are, and where (east, north, [up], bias, [drift], [satellite biases], [ways ahead]).
struct Unknowns {
  int position = 2, drift = -1, biases = -1, along = -1, count = 3;
  [[nodiscard]] int bias() const { return position; }
};

struct Point {
  Eigen::Vector3d p_e;
  Eigen::VectorXd nuisance;  // everything after the position
};

struct Row {
  const DopplerRow* data;
  int satellite;  // index
  double weight;  // 1 / sigma
};

class Batch {
 public:
  Batch(std::vector<Row> rows, const DopplerFixOptions& options, std::span<const double> along_sigmas_m,
        double satellite_bias_sigma_hz, double reference_s, double scale)
      : rows_(std::move(rows)),
        options_(options),
        along_sigmas_m_(along_sigmas_m),
        bias_sigma_hz_(satellite_bias_sigma_hz),
        reference_s_(reference_s),
        scale_(scale) {
    const int n = static_cast<int>(along_sigmas_m.size());
    u_.position = options.height_m && options.height_sigma_m == 0.0 ? 2 : 3;
    u_.count = u_.position + 1;
    if (options.frequency_drift_sigma_hz_per_s > 0.0) u_.drift = u_.count++;
    if (bias_sigma_hz_ > 0.0) {
      u_.biases = u_.count;
      u_.count += n;
    }
    if (std::any_of(along_sigmas_m.begin(), along_sigmas_m.end(), [](double s) { return s > 0.0; })) {
      u_.along = u_.count;
      u_.count += n;
    }
  }

  [[nodiscard]] const Unknowns& unknowns() const { return u_; }
  [[nodiscard]] const std::vector<Row>& rows() const { return rows_; }
  [[nodiscard]] Point at(const Eigen::Vector3d& p_e) const {
    return {p_e, Eigen::VectorXd::Zero(u_.count - u_.position)};
  }
  [[nodiscard]] int priors() const {
    int n = u_.position == 3 && options_.height_m ? 1 : 0;
    n += std::isfinite(options_.frequency_bias_sigma_hz) ? 1 : 0;
    n += u_.drift >= 0 && std::isfinite(options_.frequency_drift_sigma_hz_per_s) ? 1 : 0;
    n += u_.biases >= 0 ? static_cast<int>(along_sigmas_m_.size()) : 0;
    n += u_.along >= 0 ? static_cast<int>(along_sigmas_m_.size()) : 0;
    return n;
  }
  [[nodiscard]] int degrees() const { return static_cast<int>(rows_.size()) + priors() - u_.count; }

  // Measured minus predicted of one row; derivatives of the prediction.
  [[nodiscard]] bool residual(const Row& row, const Point& x, double& out, Eigen::Vector3d& by_position,
                              double& by_along) const {
    double doppler_hz = 0.0;
    if (!predict_doppler(*row.data, options_, x.p_e, value(x, u_.along, row.satellite), doppler_hz, by_position,
                         by_along))
      return false;
    doppler_hz += x.nuisance[0] + value(x, u_.biases, row.satellite);
    if (u_.drift >= 0) doppler_hz += x.nuisance[u_.drift - u_.position] * (row.data->t_s - reference_s_);
    out = row.data->doppler_hz - doppler_hz;
    return true;
  }

  // Normal equations A d = g and the sum of squares; false when something is not defined.
  [[nodiscard]] bool accumulate(const Point& x, Eigen::MatrixXd& A, Eigen::VectorXd& g, double& cost,
                                double& data_cost) const {
    A.setZero(u_.count, u_.count);
    g.setZero(u_.count);
    cost = 0.0;
    const auto place = geometry::ecef_to_geodetic(x.p_e);
    if (!place) return false;
    const Eigen::Matrix3d axes = geometry::rotation_ecef_to_enu(place->latitude_rad, place->longitude_rad);
    for (const Row& row : rows_) {
      double r = 0.0, by_along = 0.0;
      Eigen::Vector3d by_position;
      if (!residual(row, x, r, by_position, by_along)) return false;
      const double w = row.weight / scale_;
      const Eigen::Vector3d local = w * (axes * by_position);
      r *= w;
      cost += r * r;
      // The few columns that are not zero.
      int index[7];
      double value[7];
      int n = 0;
      for (int k = 0; k < u_.position; ++k) {
        index[n] = k;
        value[n++] = local[k];
      }
      index[n] = u_.bias();
      value[n++] = w;
      if (u_.drift >= 0) {
        index[n] = u_.drift;
        value[n++] = w * (row.data->t_s - reference_s_);
      }
      if (u_.biases >= 0) {
        index[n] = u_.biases + row.satellite;
        value[n++] = w;
      }
      if (u_.along >= 0) {
        index[n] = u_.along + row.satellite;
        value[n++] = w * by_along;
      }
      for (int i = 0; i < n; ++i) {
        g[index[i]] += value[i] * r;
        for (int j = 0; j < n; ++j) A(index[i], index[j]) += value[i] * value[j];
      }
    }
    data_cost = cost;
    const auto prior = [&](int i, double is, double expected, double sigma) {
      if (!std::isfinite(sigma)) return;
      const double r = (expected - is) / sigma;
      A(i, i) += 1.0 / (sigma * sigma);
      g[i] += r / sigma;
      cost += r * r;
    };
    if (u_.position == 3 && options_.height_m) prior(2, place->height_m, *options_.height_m, options_.height_sigma_m);
    prior(u_.bias(), x.nuisance[0], 0.0, options_.frequency_bias_sigma_hz);
    if (u_.drift >= 0)
      prior(u_.drift, x.nuisance[u_.drift - u_.position], 0.0, options_.frequency_drift_sigma_hz_per_s);
    for (int k = 0; k < static_cast<int>(along_sigmas_m_.size()); ++k) {
      if (u_.biases >= 0) prior(u_.biases + k, value(x, u_.biases, k), 0.0, bias_sigma_hz_);
      // A satellite without an error along its way has its unknown held at zero.
      const double along = along_sigmas_m_[static_cast<std::size_t>(k)];
      if (u_.along >= 0) prior(u_.along + k, value(x, u_.along, k), 0.0, along > 0.0 ? along : 1e-3);
    }
    return std::isfinite(cost);
  }

  // East and north over the ellipsoid at the same height, then up: a known height stays what it is.
  [[nodiscard]] std::optional<Point> moved(const Point& x, const Eigen::VectorXd& d) const {
    const auto place = geometry::ecef_to_geodetic(x.p_e);
    if (!place) return std::nullopt;
    const Eigen::Matrix3d axes = geometry::rotation_ecef_to_enu(place->latitude_rad, place->longitude_rad);
    const auto to = geometry::ecef_to_geodetic(x.p_e + axes.row(0).transpose() * d[0] + axes.row(1).transpose() * d[1]);
    if (!to) return std::nullopt;
    const double height_m = place->height_m + (u_.position == 3 ? d[2] : 0.0);
    if (!(std::abs(height_m) < 1e6)) return std::nullopt;
    return Point{geometry::geodetic_to_ecef(to->latitude_rad, to->longitude_rad, height_m),
                 x.nuisance + d.tail(d.size() - u_.position)};
  }

  [[nodiscard]] double value(const Point& x, int first, int k) const {
    return first < 0 ? 0.0 : x.nuisance[first + k - u_.position];
  }

 private:
  std::vector<Row> rows_;
  const DopplerFixOptions& options_;
  std::span<const double> along_sigmas_m_;
  double bias_sigma_hz_, reference_s_, scale_;
  Unknowns u_;
};

}  // namespace soopnav::navigation::doppler
