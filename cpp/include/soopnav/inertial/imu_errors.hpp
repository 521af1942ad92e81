#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <stdexcept>
#include <string>

#include "soopnav/core/angle.hpp"
#include "soopnav/core/constants.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/inertial/planar_mechanization.hpp"

namespace soopnav::inertial {

/// Errors of a sensor with one or more equal axes; "unit" is rad/s or m/s². All are zero by default.
///
/// Model: y = Q(sat((I + M) u + b + g + n))                                            (doc/clocks.md eq. 17)
///   M: scale factors on the diagonal, misalignments beside it, drawn once.   b: drawn once, then a random walk.
///   g: first-order Gauss-Markov.   n: white, of variance sample_sigma² + white_density² / dt.
struct SensorErrorModel {
  double sample_sigma = 0.0;       ///< white, of each sample whatever its step [unit]
  double white_density = 0.0;      ///< white, root of the two-sided density [unit/√Hz]: angle or velocity random walk
  double turn_on_sigma = 0.0;      ///< bias at start [unit]
  double bias_walk_density = 0.0;  ///< of the bias' random walk [unit/√s]
  double markov_sigma = 0.0;       ///< of a bias that forgets itself, in its steady state from the start [unit]
  double markov_time_s = 0.0;      ///< its correlation time; positive where markov_sigma is
  double scale_sigma = 0.0;        ///< relative
  double misalignment_sigma = 0.0;  ///< of each small angle between an axis and another's place [rad]
  double saturation = std::numeric_limits<double>::infinity();  ///< largest magnitude that comes out [unit]
  double quantum = 0.0;                                         ///< step of the converter, 0: none [unit]
};

/// Errors of a unit's gyros [rad/s] and accelerometers [m/s²].
struct ImuErrorModel {
  SensorErrorModel gyro{};
  SensorErrorModel accelerometer{};

  /// White, 0.1 rad/s and 0.1 m/s² per sample at 50 Hz (crosby section 4.1).
  [[nodiscard]] static ImuErrorModel crosby() noexcept {
    ImuErrorModel m;
    m.gyro.sample_sigma = 0.1;
    m.accelerometer.sample_sigma = 0.1;
    return m;
  }
  /// Consumer grade: 200 µg/√Hz and 0.01 °/s/√Hz, turn-on biases of 5 mg and 50 °/h.
  [[nodiscard]] static ImuErrorModel consumer() noexcept { return mems(200e-6, radians(0.01), 5e-3, 50.0); }
  /// Industrial grade: 60 µg/√Hz and 0.15 °/√h, turn-on biases of 0.5 mg and 5 °/h.
  [[nodiscard]] static ImuErrorModel industrial() noexcept { return mems(60e-6, radians(0.15) / 60.0, 0.5e-3, 5.0); }
  /// Tactical grade: 30 µg/√Hz and 0.05 °/√h, turn-on biases of 0.3 mg and 1 °/h.
  [[nodiscard]] static ImuErrorModel tactical() noexcept { return mems(30e-6, radians(0.05) / 60.0, 0.3e-3, 1.0); }

 private:
  static ImuErrorModel mems(double accelerometer_g, double gyro_radps, double bias_g, double bias_degph) noexcept {
    ImuErrorModel m;
    m.gyro.white_density = gyro_radps;
    m.gyro.turn_on_sigma = radians(bias_degph) / 3600.0;
    m.accelerometer.white_density = accelerometer_g * kStandardGravityMps2;
    m.accelerometer.turn_on_sigma = bias_g * kStandardGravityMps2;
    return m;
  }
};

/// What became of a reading.
enum class ReadingStatus : std::uint8_t {
  kValid,
  kSaturated,  ///< at least one axis is at its limit
  kRejected,   ///< the truth or the step was no number, or the step not positive: nothing has changed
};

/// A sensor of N equal axes with its own errors, drawn from a stream: one realisation.
///
/// Each kind of error has a substream, so that switching one on leaves the others' numbers as they are. `apply` neither
/// allocates nor throws.
template <int N>
class SensorErrors {
 public:
  using Vector = Eigen::Matrix<double, N, 1>;
  using Matrix = Eigen::Matrix<double, N, N>;

  /// @throws std::invalid_argument unless all numbers of the model are >= 0 and finite (the saturation: positive, may
  /// be infinite), and markov_time_s > 0 where markov_sigma is. `name` begins the sentence.
  SensorErrors(const SensorErrorModel& model, const RandomStream& random, const char* name = "sensor")
      : model_(check(model, name)),
        white_(random.substream(0)),
        walk_(random.substream(1)),
        markov_stream_(random.substream(2)) {
    RandomStream once = random.substream(3);
    for (int i = 0; i < N; ++i) bias_[i] = once.normal(0.0, model.turn_on_sigma);
    for (int i = 0; i < N; ++i) markov_[i] = markov_stream_.normal(0.0, model.markov_sigma);
    for (int i = 0; i < N; ++i) {
      for (int j = 0; j < N; ++j) {
        gain_(i, j) = (i == j ? 1.0 : 0.0) + once.normal(0.0, i == j ? model.scale_sigma : model.misalignment_sigma);
      }
    }
  }

  [[nodiscard]] const SensorErrorModel& model() const noexcept { return model_; }
  [[nodiscard]] Vector bias() const noexcept { return bias_ + markov_; }  ///< all of it, now [unit]
  [[nodiscard]] const Matrix& gain() const noexcept { return gain_; }     ///< I + M
  /// Errors that are known in place of drawn ones. @throws std::invalid_argument unless all are finite.
  void set_bias(const Vector& bias) {
    if (!bias.allFinite()) throw std::invalid_argument("bias must be finite");
    bias_ = bias;
    markov_.setZero();
  }
  void set_gain(const Matrix& gain) {
    if (!gain.allFinite()) throw std::invalid_argument("gain must be finite");
    gain_ = gain;
  }

  /// `truth`, the mean over the `dt_s` seconds that end now, becomes what the sensor says.
  [[nodiscard]] ReadingStatus apply(Vector& truth, double dt_s) noexcept {
    if (!(dt_s > 0.0) || std::isinf(dt_s) || !truth.allFinite()) return ReadingStatus::kRejected;
    const double white =
        std::sqrt(model_.sample_sigma * model_.sample_sigma + model_.white_density * model_.white_density / dt_s);
    if (model_.bias_walk_density > 0.0) {
      const double step = model_.bias_walk_density * std::sqrt(dt_s);
      for (int i = 0; i < N; ++i) bias_[i] += step * walk_.normal();
    }
    if (model_.markov_sigma > 0.0) {
      const double keep = std::exp(-dt_s / model_.markov_time_s);
      const double fresh = model_.markov_sigma * std::sqrt(-std::expm1(-2.0 * dt_s / model_.markov_time_s));
      for (int i = 0; i < N; ++i) markov_[i] = keep * markov_[i] + fresh * markov_stream_.normal();
    }
    Vector reading = gain_ * truth + bias_ + markov_;
    ReadingStatus status = ReadingStatus::kValid;
    for (int i = 0; i < N; ++i) {
      reading[i] += white * white_.normal();
      if (std::abs(reading[i]) >= model_.saturation) {
        status = ReadingStatus::kSaturated;
        reading[i] = std::copysign(model_.saturation, reading[i]);
      }
      if (model_.quantum > 0.0) reading[i] = model_.quantum * std::nearbyint(reading[i] / model_.quantum);
    }
    truth = reading;
    return status;
  }

 private:
  static const SensorErrorModel& check(const SensorErrorModel& m, const char* name) {
    const auto require = [name](double value, const char* what) {
      if (!(value >= 0.0) || std::isinf(value)) {
        throw std::invalid_argument(std::string(name) + "." + what + " = " + std::to_string(value) +
                                    " must be finite and >= 0");
      }
    };
    require(m.sample_sigma, "sample_sigma");
    require(m.white_density, "white_density");
    require(m.turn_on_sigma, "turn_on_sigma");
    require(m.bias_walk_density, "bias_walk_density");
    require(m.markov_sigma, "markov_sigma");
    require(m.markov_time_s, "markov_time_s");
    require(m.scale_sigma, "scale_sigma");
    require(m.misalignment_sigma, "misalignment_sigma");
    require(m.quantum, "quantum");
    if (!(m.saturation > 0.0)) {
      throw std::invalid_argument(std::string(name) + ".saturation = " + std::to_string(m.saturation) +
                                  " must be positive");
    }
    if (m.markov_sigma > 0.0 && !(m.markov_time_s > 0.0)) {
      throw std::invalid_argument(std::string(name) + ".markov_time_s = 0 must be positive where markov_sigma is");
    }
    return m;
  }

  SensorErrorModel model_;
  RandomStream white_;
  RandomStream walk_;
  RandomStream markov_stream_;
  Vector bias_ = Vector::Zero();
  Vector markov_ = Vector::Zero();
  Matrix gain_ = Matrix::Identity();
};

/// A unit of `Gyros` gyros and `Accelerometers` accelerometers: 1 and 2 in the plane, 3 and 3 in space.
template <int Gyros, int Accelerometers>
struct ImuErrors {
  SensorErrors<Gyros> gyro;
  SensorErrors<Accelerometers> accelerometer;

  ImuErrors(const ImuErrorModel& model, const RandomStream& random)
      : gyro(model.gyro, random.substream(0), "gyro"),
        accelerometer(model.accelerometer, random.substream(1), "accelerometer") {}

  /// Both sensors at once; nothing has changed when either truth is rejected.
  [[nodiscard]] ReadingStatus apply(Eigen::Matrix<double, Gyros, 1>& rate_radps,
                                    Eigen::Matrix<double, Accelerometers, 1>& force_mps2, double dt_s) noexcept {
    if (!rate_radps.allFinite() || !force_mps2.allFinite()) return ReadingStatus::kRejected;
    const ReadingStatus of_gyro = gyro.apply(rate_radps, dt_s);
    const ReadingStatus of_accelerometer = accelerometer.apply(force_mps2, dt_s);
    return std::max(of_gyro, of_accelerometer);
  }

  /// The same for a planar sample.
  [[nodiscard]] ReadingStatus apply(PlanarImuSample& sample, double dt_s) noexcept
      requires(Gyros == 1 && Accelerometers == 2) {
    Eigen::Matrix<double, 1, 1> rate(sample.yaw_rate_radps);
    const ReadingStatus status = apply(rate, sample.specific_force_b_mps2, dt_s);
    sample.yaw_rate_radps = rate[0];
    return status;
  }
};

using PlanarImuErrors = ImuErrors<1, 2>;
using SpatialImuErrors = ImuErrors<3, 3>;

}  // namespace soopnav::inertial
