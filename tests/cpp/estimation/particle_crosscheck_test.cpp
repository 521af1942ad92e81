// Against exact answers: the Kalman filter where it is exact, and the likelihood that must come out unbiased.

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <vector>

#include "soopnav/core/constants.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/estimation/particle_filter.hpp"

namespace soopnav {
namespace {

// Position and velocity on a line, white acceleration held over the step, position measured.
using Track = ComposedState<PlanarFrame, Role<1, PositionTag>, Role<1, VelocityTag>>;
inline constexpr auto kX = kPositionOf<1>;
inline constexpr auto kV = kVelocityOf<1>;

struct Drive {
  static constexpr int kNoise = 1;
  double sigma = 0.5;
  template <class X, class W, class Y>
  [[nodiscard]] bool propagate(const X& x, double dt_s, const W& w, Y& y) const {
    const auto a = w[0] * sigma;
    y.next(kX)[0] = x(kX)[0] + x(kV)[0] * dt_s + a * (0.5 * dt_s * dt_s);
    y.next(kV)[0] = x(kV)[0] + a * dt_s;
    return true;
  }
};
struct Seen {
  static constexpr int kDim = 1;
  template <class X, class Y>
  [[nodiscard]] bool predict(const X& x, Y& y) const {
    y.value(0) = x(kX)[0];
    return true;
  }
};

struct Exact {
  Eigen::Vector2d x{0.0, 1.0};
  Eigen::Matrix2d P = Eigen::Matrix2d::Identity();
  double log_likelihood = 0.0;

  void step(double z, double R, double dt) {
    Eigen::Matrix2d F;
    F << 1.0, dt, 0.0, 1.0;
    const Eigen::Vector2d G(0.5 * 0.5 * dt * dt, 0.5 * dt);
    x = F * x;
    P = F * P * F.transpose() + G * G.transpose();
    const double S = P(0, 0) + R;
    const Eigen::Vector2d K = P.col(0) / S;
    const double innovation = z - x[0];
    log_likelihood += -0.5 * (innovation * innovation / S + std::log(kTwoPi * S));
    x += K * innovation;
    P -= (K * P.row(0)).eval();
  }
};

std::vector<double> measured(int steps) {
  RandomStream random(77);
  std::vector<double> z;
  double x = 0.0;
  double v = 1.0;
  for (int k = 0; k < steps; ++k) {
    const double a = 0.5 * random.normal();
    x += v + 0.5 * a;
    v += a;
    z.push_back(x + 0.7 * random.normal());
  }
  return z;
}

constexpr double kR = 0.49;

template <class T>
double run(std::size_t count, std::uint64_t seed, const std::vector<double>& z, Exact& exact, Eigen::Vector2d& error,
           double threshold, Resampling scheme) {
  Track x0;
  x0.x << 0.0, 1.0;
  ParticleFilter<Track, T> f(x0, Eigen::Matrix2d::Identity(),
                             {.count = count, .seed = seed, .resampling = scheme, .ess_threshold = threshold});
  exact = Exact{};
  for (const double observed : z) {
    EXPECT_TRUE(f.step(Drive{}, 1.0, Observed<Seen>(Seen{}, observed, kR)).accepted());
    exact.step(observed, kR, 1.0);
  }
  error = f.mean().x - exact.x;
  return f.log_likelihood();
}

// Errors of the mean over 60 runs: their mean is 0 within 4.5 of its own sigmas, and their size falls as 1 / sqrt(N).
template <class T>
void expect_posterior(double threshold, Resampling scheme) {
  const auto z = measured(20);
  constexpr int kRuns = 60;
  double size[2] = {0.0, 0.0};
  for (int which = 0; which < 2; ++which) {
    const std::size_t count = which == 0 ? 250 : 4000;
    Eigen::Vector2d sum = Eigen::Vector2d::Zero();
    Eigen::Vector2d squares = Eigen::Vector2d::Zero();
    Exact exact;
    for (int r = 0; r < kRuns; ++r) {
      Eigen::Vector2d error;
      static_cast<void>(run<T>(count, static_cast<std::uint64_t>(r), z, exact, error, threshold, scheme));
      sum += error;
      squares += error.cwiseAbs2();
    }
    for (int i = 0; i < 2; ++i) {
      const double mean = sum[i] / kRuns;
      const double sigma = std::sqrt(squares[i] / kRuns);
      // A bias of the order 1 / N is allowed for: a hundredth of the posterior's width at 250 particles.
      const double bias = 0.01 * std::sqrt(exact.P(i, i)) * 250.0 / static_cast<double>(count);
      EXPECT_LT(std::abs(mean), 4.5 * sigma / std::sqrt(kRuns) + bias) << count << " " << i;
      EXPECT_LT(sigma, 6.0 * std::sqrt(exact.P(i, i) / static_cast<double>(count))) << count << " " << i;
    }
    size[which] = std::sqrt(squares[0]);
  }
  EXPECT_NEAR(size[0] / size[1], 4.0, 2.0);  // sqrt(4000 / 250); the sigma of the ratio is 0.37
}

TEST(ParticleCrosscheck, PosteriorOfALinearSystem) {
  expect_posterior<double>(0.5, Resampling::kSystematic);
  expect_posterior<double>(1.0, Resampling::kMultinomial);
  expect_posterior<float>(1.0, Resampling::kStratified);
}

TEST(ParticleCrosscheck, LikelihoodIsUnbiased) {
  // The mean over runs of exp(estimate - exact) is 1 within 4.5 of its sigmas, whenever it is resampled.
  const auto z = measured(8);
  for (const double threshold : {0.0, 0.5, 1.0}) {
    constexpr int kRuns = 1500;
    double sum = 0.0;
    double squares = 0.0;
    for (int r = 0; r < kRuns; ++r) {
      Exact exact;
      Eigen::Vector2d error;
      const double estimate =
          run<double>(300, 1000 + static_cast<std::uint64_t>(r), z, exact, error, threshold, Resampling::kSystematic);
      const double ratio = std::exp(estimate - exact.log_likelihood);
      sum += ratio;
      squares += ratio * ratio;
    }
    const double mean = sum / kRuns;
    const double sigma = std::sqrt((squares / kRuns - mean * mean) / kRuns);
    EXPECT_LT(sigma, 0.04) << threshold;
    EXPECT_NEAR(mean, 1.0, 4.5 * sigma) << threshold;
  }
}

}  // namespace
}  // namespace soopnav
