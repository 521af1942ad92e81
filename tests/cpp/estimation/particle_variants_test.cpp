// Particle filters that look ahead, spread copies, follow the spread with their number, or keep a part exact.

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <set>
#include <vector>

#include "estimation/particle_variant_scene.hpp"
#include "soopnav/estimation/chi_square.hpp"
#include "soopnav/estimation/particle_bins.hpp"
#include "support/nan.hpp"

namespace soopnav {
namespace {

using test::Drift;
using test::kBias;
using test::kPlace;
using test::Pair;
using test::PairCloud;
using test::PairExact;
using test::PairMarginalized;
using test::Place;
using test::Sum;

using ::soopnav::test::kNan;

// Stays where it is.
struct Rest {
  static constexpr int kNoise = 0;
  template <class X, class W, class Y>
  [[nodiscard]] bool propagate(const X& x, double /*dt_s*/, const W& /*w*/, Y& y) const {
    for (int i = 0; i < 2; ++i) y.next(kPlanarPosition)[i] = x(kPlanarPosition)[i];
    return true;
  }
};

Pair at(double x, double b) {
  Pair p;
  p.x << x, b;
  return p;
}

std::size_t distinct(const PairCloud& f, int component = 0) {
  const auto x = f.component(component);
  return std::set<double>(x.begin(), x.end()).size();
}

// ---- looking ahead

// 40 steps of a place that moves by 0.1 and is measured to 0.1: mean square of the error of the mean against the exact
// one, and the mean of the estimated over the exact likelihood of each step.
struct Quality {
  double mean_square = 0.0;
  double likelihood_ratio = 0.0;
  double likelihood_variance = 0.0;
};
Quality sharp(bool auxiliary, std::size_t count) {
  constexpr int kRuns = 60;
  constexpr int kSteps = 40;
  const Drift drift{0.1, 0.0};
  Quality q;
  for (int run = 0; run < kRuns; ++run) {
    RandomStream random = RandomStream(77).substream(static_cast<std::uint64_t>(run));
    Eigen::Matrix2d P0 = Eigen::Vector2d(1.0, 0.0).asDiagonal();
    PairCloud f(
        at(0, 0), P0,
        {.count = count, .seed = static_cast<std::uint64_t>(run), .ess_threshold = 1.0, .auxiliary = auxiliary});
    PairExact exact{Eigen::Vector2d::Zero(), P0, 0.0};
    double x = random.normal();
    for (int k = 0; k < kSteps; ++k) {
      x += 0.1 * random.normal();
      const double z = x + 0.1 * random.normal();
      const double before = exact.log_likelihood;
      exact.predict(drift, 1.0);
      exact.update(Eigen::RowVector2d(1.0, 0.0), z, 0.01);
      const ParticleReport report = f.step(drift, 1.0, Observed<Place>(Place{}, z, 0.01));
      EXPECT_TRUE(report.accepted());
      const double ratio = std::exp(report.log_likelihood - (exact.log_likelihood - before));
      q.mean_square += std::pow(f.mean()(kPlace)[0] - exact.x[0], 2) / (kRuns * kSteps);
      q.likelihood_ratio += ratio / (kRuns * kSteps);
      q.likelihood_variance += std::pow(ratio - 1.0, 2) / (kRuns * kSteps);
    }
  }
  return q;
}

TEST(AuxiliaryParticleFilter, IsUnbiasedForSharpObservations) {
  constexpr std::size_t kCount = 500;
  const Quality plain = sharp(false, kCount);
  const Quality ahead = sharp(true, kCount);
  // 2400 ratios of the variance measured: 4.5 sigma of their mean.
  EXPECT_NEAR(ahead.likelihood_ratio, 1.0, 4.5 * std::sqrt(ahead.likelihood_variance / 2400.0));
  EXPECT_NEAR(plain.likelihood_ratio, 1.0, 4.5 * std::sqrt(plain.likelihood_variance / 2400.0));
  // The posterior's variance is 0.0062; its mean is found to within a fraction of that.
  EXPECT_LT(ahead.mean_square, 0.0062 * 0.05);
}

TEST(AuxiliaryParticleFilter, LooksThroughASharpObservationWhereTheBootstrapFilterGoesBlind) {
  // Spread over 100 m, hardly moved, measured to 0.05 m: of 400 particles the first observation leaves one or two; the
  // ones drawn for the next step come from the look ahead.
  const Drift drift{0.1, 0.0};
  const Eigen::Matrix2d P0 = Eigen::Vector2d(100.0, 0.0).asDiagonal();
  double plain = 0.0;
  double ahead = 0.0;
  for (std::uint64_t run = 0; run < 200; ++run) {
    PairCloud a(at(0, 0), P0, {.count = 400, .seed = run, .ess_threshold = 1.0});
    PairCloud b(at(0, 0), P0, {.count = 400, .seed = run, .ess_threshold = 1.0, .auxiliary = true});
    const Observed<Place> seen(Place{}, 3.0, 0.0025);
    plain += a.step(drift, 1.0, seen).ess / 200.0;
    ahead += b.step(drift, 1.0, seen).ess / 200.0;
  }
  EXPECT_GT(ahead, 5.0 * plain);
}

TEST(AuxiliaryParticleFilter, StatusesAndWhatTheyLeave) {
  const Drift drift{1.0, 1.0};
  const Eigen::Matrix2d P0 = Eigen::Matrix2d::Identity();
  PairCloud f(at(0, 0), P0, {.count = 300, .seed = 3, .auxiliary = true});
  const PairCloud before = f;
  EXPECT_EQ(f.step(drift, 1.0, Observed<Place>(Place{}, kNan, 1.0)).status, ParticleStatus::kNonFinite);
  EXPECT_EQ(f.step(drift, 1.0, Observed<Place>(Place{}, 0.0, 0.0)).status, ParticleStatus::kNotPositiveDefinite);
  EXPECT_EQ(f.step(drift, 0.0, Observed<Place>(Place{}, 0.0, 1.0)).status, ParticleStatus::kTimeNotAdvancing);
  EXPECT_TRUE(std::equal(f.component(0).begin(), f.component(0).end(), before.component(0).begin()));
  EXPECT_EQ(f.steps(), before.steps());

  // Nothing is possible: the prediction stands, and its weights are all there.
  const auto nowhere = Region{[](const auto& x) { return x(kPlace)[0] > 1e9; }};
  const ParticleReport none = f.step(drift, 1.0, Observed<Place>(Place{}, 0.0, 1.0), nowhere);
  EXPECT_EQ(none.status, ParticleStatus::kDegenerate);
  EXPECT_GT(none.ess, 100.0);
  EXPECT_TRUE(f.mean().x.allFinite());
  EXPECT_EQ(f.log_likelihood(), 0.0);

  // Possible only for those that the noise carries over the line: none is expected there, some arrive.
  PairCloud g(at(0, 0), Eigen::Matrix2d::Identity() * 1e-4, {.count = 3000, .seed = 4, .auxiliary = true});
  const auto beyond = Region{[](const auto& x) { return x(kPlace)[0] > 2.0; }};
  const ParticleReport some = g.step(drift, 1.0, Observed<Place>(Place{}, 2.0, 100.0), beyond);
  ASSERT_TRUE(some.accepted());
  EXPECT_GT(g.mean()(kPlace)[0], 2.0);

  // Drawn by the first stage and then ruled out together: worth the inverse of what they were drawn by, so that the
  // mean is that of the prediction again.
  PairCloud h(at(0, 0), P0, {.count = 20000, .seed = 5, .auxiliary = true});
  ParticleReport out;
  h.reweight([](const auto&, std::span<double> l) { std::fill(l.begin(), l.end(), 0.0); });
  const auto unmoved = Region{[](const auto& x) { return !(x(kPlace)[0] == x(kPlace)[0]); }};
  out = h.step(Drift{1e-6, 1e-6}, 1.0, Observed<Place>(Place{}, 1.0, 4.0), unmoved);
  EXPECT_EQ(out.status, ParticleStatus::kDegenerate);
  EXPECT_NEAR(h.mean()(kPlace)[0], 0.0, 4.5 / std::sqrt(20000.0) * 1.5);
  EXPECT_NEAR(h.covariance()(0, 0), 1.0, 4.5 * std::sqrt(2.0 / 20000.0) * 2.0);
}

// ---- spread copies

TEST(RegularisedParticleFilter, PartsTheCopiesOfAStateThatDoesNotMove) {
  // A constant, seen 30 times: the posterior is known. Without noise the plain filter is left with the few particles
  // that were near from the start.
  const Drift still{0.0, 0.0};
  const Eigen::Matrix2d P0 = Eigen::Vector2d(4.0, 1.0).asDiagonal();
  constexpr std::size_t kCount = 4000;
  for (const bool spread : {false, true}) {
    PairCloud f(at(0, 0), P0, {.count = kCount, .seed = 9, .regularisation = spread ? 1.0 : 0.0});
    PairExact exact{Eigen::Vector2d::Zero(), P0, 0.0};
    RandomStream random(10);
    for (int k = 0; k < 30; ++k) {
      const double z = 1.3 + 0.5 * random.normal();
      exact.update(Eigen::RowVector2d(1.0, 0.0), z, 0.25);
      ASSERT_TRUE(f.step(still, 1.0, Observed<Place>(Place{}, z, 0.25)).accepted());
    }
    f.resample();
    EXPECT_NEAR(f.mean()(kPlace)[0], exact.x[0], 0.35 * std::sqrt(exact.P(0, 0)));
    if (spread) {
      EXPECT_EQ(distinct(f), kCount);
      EXPECT_NEAR(f.covariance()(0, 0), exact.P(0, 0), 0.2 * exact.P(0, 0));
    } else {
      EXPECT_LT(distinct(f), kCount / 8);
    }
  }
}

TEST(RegularisedParticleFilter, SpreadingKeepsMeanAndCovariance) {
  Eigen::Matrix2d P0;
  P0 << 4.0, 1.9, 1.9, 1.0;
  constexpr std::size_t kCount = 50000;
  PairCloud f(at(3, -2), P0, {.count = kCount, .seed = 11, .regularisation = 1.0});
  ASSERT_TRUE(f.update(Place{}, 4.0, 4.0).accepted());
  const Eigen::Vector2d mean = f.mean().x;
  const Eigen::Matrix2d P = f.covariance();
  f.resample();
  // What resampling and the kernel's own draws change: both of order 1 / sqrt(N).
  for (int i = 0; i < 2; ++i) EXPECT_NEAR(f.mean().x[i], mean[i], 5.0 * std::sqrt(P(i, i) / kCount));
  for (int i = 0; i < 2; ++i) {
    for (int j = 0; j < 2; ++j) EXPECT_NEAR(f.covariance()(i, j), P(i, j), 8.0 * std::sqrt(2.0 / kCount) * P(0, 0));
  }
  EXPECT_EQ(distinct(f), kCount);
}

TEST(RegularisedParticleFilter, EachSpreadDrawsAnew) {
  PairCloud f(at(0, 0), Eigen::Matrix2d::Identity(), {.count = 5000, .seed = 16, .regularisation = 1.0});
  for (int k = 0; k < 15; ++k) f.resample();
  // A covariance walks by sqrt(2 / N) each time.
  EXPECT_NEAR(f.covariance().trace(), 2.0, 2.0 * 4.5 * std::sqrt(2.0 / 5000.0 * 15.0));
}

TEST(ParticleVariants, ResamplingWithoutMotionKeepsTheLikelihoodUnbiased) {
  // A constant seen four times with ten particles; each resampling must draw anew.
  const std::vector<double> z{0.4, -0.3, 0.9, 0.1};
  PairExact exact{Eigen::Vector2d::Zero(), Eigen::Vector2d(1.0, 0.0).asDiagonal(), 0.0};
  for (const double one : z) exact.update(Eigen::RowVector2d(1.0, 0.0), one, 0.25);
  constexpr int kRuns = 8000;
  for (const Resampling scheme : {Resampling::kSystematic, Resampling::kStratified, Resampling::kMultinomial}) {
    double sum = 0.0;
    double squares = 0.0;
    for (int run = 0; run < kRuns; ++run) {
      PairCloud f(at(0, 0), Eigen::Vector2d(1.0, 0.0).asDiagonal(),
                  {.count = 10, .seed = static_cast<std::uint64_t>(run), .resampling = scheme, .ess_threshold = 1.0});
      for (const double one : z) {
        if (f.resampling_due()) f.resample();
        ASSERT_TRUE(f.update(Place{}, one, 0.25).accepted());
      }
      const double ratio = std::exp(f.log_likelihood() - exact.log_likelihood);
      sum += ratio;
      squares += (ratio - 1.0) * (ratio - 1.0);
    }
    EXPECT_NEAR(sum / kRuns, 1.0, 4.5 * std::sqrt(squares / kRuns / kRuns)) << to_string(scheme);
  }
}

TEST(RegularisedParticleFilter, HeadingsAndAttitudesStayRotations) {
  using Turning = ComposedState<EnuFrame, Role<3, AttitudeTag>, Role<1, HeadingTag>>;
  Turning x{};
  x.x << 1, 0, 0, 0, 3.1;
  Eigen::Matrix4d P0 = Eigen::Vector4d(0.04, 0.01, 0.02, 0.03).asDiagonal();
  ParticleFilter<Turning> f(x, P0, {.count = 20000, .seed = 12, .regularisation = 2.0});
  f.reweight([](const auto& chunk, std::span<double> l) {
    for (std::size_t i = 0; i < l.size(); ++i) l[i] = chunk.components[1][i] > 0.0 ? 0.0 : -1.0;
  });
  const Turning mean = f.mean();
  const Eigen::Matrix4d P = f.covariance();
  f.resample();
  for (std::size_t i = 0; i < f.count(); ++i) {
    const Turning one = f.particle(i);
    ASSERT_NEAR(one.x.head<4>().norm(), 1.0, 1e-12);
    ASSERT_TRUE(one.x[4] >= -kPi && one.x[4] < kPi);
  }
  const Eigen::Vector4d d = mean.local(f.mean());
  for (int i = 0; i < 4; ++i) EXPECT_NEAR(d[i], 0.0, 6.0 * std::sqrt(P(i, i) / 20000.0)) << i;
  for (int i = 0; i < 4; ++i) EXPECT_NEAR(f.covariance()(i, i), P(i, i), 0.06 * P(i, i)) << i;
}

TEST(RegularisedParticleFilter, CopiesDoNotAppearBehindWalls) {
  using Planar = ComposedState<PlanarFrame, Role<2, PositionTag>>;
  Planar x{};
  const Walls<2> wall{{{{-100.0, 0.1}, {100.0, 0.1}}}};
  const auto below = Region{[](const auto& p) { return p(kPlanarPosition)[1] < 0.1; }};
  ParticleFilter<Planar> f(x, Eigen::Matrix2d::Identity(),
                           {.count = 5000, .seed = 13, .ess_threshold = 1.0, .regularisation = 1.0});
  ASSERT_TRUE(f.update(below).accepted());
  for (int k = 0; k < 5; ++k) ASSERT_TRUE(f.step(Rest{}, 1.0, wall).accepted());
  std::vector<double> w(f.count());
  f.weights(w);
  for (std::size_t i = 0; i < f.count(); ++i) {
    if (w[i] > 0.0) {
      ASSERT_LT(f.component(1)[i], 0.1);
    }
  }
}

// ---- as many particles as needed

TEST(AdaptiveParticleFilter, CountsByTheChiSquareBound) {
  ParticleOptions options{.count = 1000000, .adaptive = {.bin_sizes = {1.0, 0.0}, .least = 10}};
  detail::ParticleBins bins(options, 2);
  EXPECT_EQ(bins.wanted(), 10U);
  for (int k = 1; k <= 300; ++k) {
    for (int twice = 0; twice < 2; ++twice) {
      const std::vector<double> x{0.5 + k - 150, 1e6 * k};
      EXPECT_TRUE(bins.add(x));
    }
    ASSERT_EQ(bins.bins(), static_cast<std::size_t>(k));
    if (k < 3) continue;
    const double exact = chi_square_quantile(0.99, k - 1) / (2.0 * 0.05);
    EXPECT_NEAR(static_cast<double>(bins.wanted()), exact, 0.01 * exact + 1.0) << k;
  }
  bins.clear();
  EXPECT_EQ(bins.bins(), 0U);
}

TEST(AdaptiveParticleFilter, FollowsTheSpreadOfTheCloud) {
  const Drift drift{0.3, 0.0};
  const Eigen::Matrix2d P0 = Eigen::Vector2d(400.0, 1.0).asDiagonal();
  PairCloud f(at(0, 0), P0, {.count = 20000, .seed = 14, .adaptive = {.bin_sizes = {0.5, 0.0}, .least = 100}});
  EXPECT_EQ(f.count(), 20000U);
  RandomStream random(15);
  double x = 5.0;
  for (int k = 0; k < 20; ++k) {
    x += 0.3 * random.normal();
    ASSERT_TRUE(f.step(drift, 1.0, Observed<Place>(Place{}, x + 0.5 * random.normal(), 0.25)).accepted());
    EXPECT_NEAR(f.mean()(kPlace)[0], x, 2.5);
  }
  // Within about +-1.5 m there are a dozen bins: a few hundred particles.
  EXPECT_LT(f.count(), 600U);
  EXPECT_GE(f.count(), 100U);
  const std::size_t settled = f.count();
  std::vector<double> w(f.count());
  f.weights(w);
  double sum = 0.0;
  for (const double one : w) sum += one;
  EXPECT_NEAR(sum, 1.0, 1e-12);

  // Lost for a while: the cloud widens, and so does its number.
  for (int k = 0; k < 30; ++k) {
    ASSERT_TRUE(f.predict(Drift{5.0, 0.0}, 1.0).accepted());
    f.resample();
  }
  EXPECT_GT(f.count(), 3 * settled);
  EXPECT_LE(f.count(), 20000U);

  // What is kept of it is taken over by another.
  std::vector<double> components;
  for (int c = 0; c < 2; ++c) components.insert(components.end(), f.component(c).begin(), f.component(c).end());
  PairCloud g(at(0, 0), P0, f.options());
  g.restore(components, f.log_weights(), f.log_likelihood(), f.steps());
  EXPECT_EQ(g.count(), f.count());
  for (int k = 0; k < 3; ++k) {
    static_cast<void>(f.step(drift, 1.0, Observed<Place>(Place{}, x, 0.25)));
    static_cast<void>(g.step(drift, 1.0, Observed<Place>(Place{}, x, 0.25)));
  }
  ASSERT_EQ(g.count(), f.count());
  EXPECT_TRUE(std::equal(f.component(0).begin(), f.component(0).end(), g.component(0).begin()));
  EXPECT_THROW(g.restore(std::span<const double>(components).first(20), f.log_weights().first(10), 0.0, 0),
               std::invalid_argument);
}

TEST(ParticleVariants, SetUpIsChecked) {
  const Eigen::Matrix2d P0 = Eigen::Matrix2d::Identity();
  const auto refused = [&](const ParticleOptions& options) {
    EXPECT_THROW(PairCloud(at(0, 0), P0, options), std::invalid_argument);
  };
  refused({.regularisation = -0.1});
  refused({.regularisation = kNan});
  refused({.regularisation = 2.5});
  refused({.adaptive = {.bin_sizes = {1.0}}});
  refused({.adaptive = {.bin_sizes = {1.0, -1.0}}});
  refused({.adaptive = {.bin_sizes = {0.0, 0.0}}});
  refused({.adaptive = {.bin_sizes = {1.0, kNan}}});
  refused({.adaptive = {.bin_sizes = {1.0, 1.0}, .least = 0}});
  refused({.adaptive = {.bin_sizes = {1.0, 1.0}, .least = 1001}});
  refused({.adaptive = {.bin_sizes = {1.0, 1.0}, .divergence = 0.0}});
  refused({.adaptive = {.bin_sizes = {1.0, 1.0}, .probability = 0.5}});
  refused({.adaptive = {.bin_sizes = {1.0, 1.0}, .probability = 1.0}});
  refused({.auxiliary = true, .adaptive = {.bin_sizes = {1.0, 1.0}}});
}

// ---- a part kept exact

// Place by particles, bias exact, against the Kalman filter of both.
TEST(MarginalizedParticleFilter, IsTheKalmanFilterWhenNothingIsSampled) {
  const Drift drift{0.0, 0.7};
  const Eigen::Matrix2d P0 = Eigen::Vector2d(0.0, 9.0).asDiagonal();
  PairMarginalized f(at(2.0, 1.0), P0, {.count = 37, .seed = 1});
  PairExact exact{Eigen::Vector2d(2.0, 1.0), P0, 0.0};
  const std::vector<Sum> both{Sum{1.0}, Sum{-2.0}};
  Eigen::Matrix2d R;
  R << 1.0, 0.4, 0.4, 2.0;
  Eigen::Matrix2d H;
  H << 1.0, 1.0, 1.0, -2.0;
  RandomStream random(21);
  for (int k = 0; k < 50; ++k) {
    const Eigen::Vector2d z(random.normal() + 3.0, random.normal());
    exact.predict(drift, 0.5);
    exact.update(H, z, R);
    if (k % 2 == 0) {
      ASSERT_TRUE(f.step(drift, 0.5, Correlated<Sum>{both, z, R}).accepted());
    } else {
      ASSERT_TRUE(f.predict(drift, 0.5).accepted());
      ASSERT_TRUE(f.update(Correlated<Sum>{both, z, R}).accepted());
    }
    ASSERT_NEAR(f.mean()(kBias)[0], exact.x[1], 1e-11);
    ASSERT_NEAR(f.linear_covariance()(0, 0), exact.P(1, 1), 1e-11);
    ASSERT_NEAR(f.covariance()(1, 1), exact.P(1, 1), 1e-11);
  }
  EXPECT_NEAR(f.log_likelihood(), exact.log_likelihood, 1e-9);
}

TEST(MarginalizedParticleFilter, IsUnbiasedAndSharperThanSamplingEverything) {
  constexpr int kRuns = 300;
  constexpr int kSteps = 12;
  constexpr std::size_t kCount = 200;
  const Drift drift{0.5, 0.2};
  const Eigen::Matrix2d P0 = Eigen::Vector2d(1.0, 25.0).asDiagonal();
  double ratio = 0.0;
  double ratio2 = 0.0;
  double exactly = 0.0;
  double sampled = 0.0;
  double nees = 0.0;
  for (int run = 0; run < kRuns; ++run) {
    RandomStream random = RandomStream(31).substream(static_cast<std::uint64_t>(run));
    const auto seed = static_cast<std::uint64_t>(run);
    PairMarginalized f(at(0, 0), P0, {.count = kCount, .seed = seed, .ess_threshold = 0.7});
    PairCloud g(at(0, 0), P0, {.count = kCount, .seed = seed, .ess_threshold = 0.7});
    PairExact exact{Eigen::Vector2d::Zero(), P0, 0.0};
    Eigen::Vector2d x(random.normal(), 5.0 * random.normal());
    for (int k = 0; k < kSteps; ++k) {
      x += Eigen::Vector2d(0.5 * random.normal(), 0.2 * random.normal());
      const double s = x.sum() + 0.3 * random.normal();
      const double p = x[0] + random.normal();
      exact.predict(drift, 1.0);
      exact.update(Eigen::RowVector2d(1.0, 1.0), s, 0.09);
      exact.update(Eigen::RowVector2d(1.0, 0.0), p, 1.0);
      ASSERT_TRUE(f.step(drift, 1.0, test::group(Observed<Sum>(Sum{1.0}, s, 0.09))).accepted());
      ASSERT_TRUE(f.update(Observed<Place>(Place{}, p, 1.0)).accepted());
      static_cast<void>(g.step(drift, 1.0, Observed<Sum>(Sum{1.0}, s, 0.09), Observed<Place>(Place{}, p, 1.0)));
    }
    const double r = std::exp(f.log_likelihood() - exact.log_likelihood);
    ratio += r / kRuns;
    ratio2 += (r - 1.0) * (r - 1.0) / kRuns;
    exactly += (f.mean().x - exact.x).squaredNorm() / kRuns;
    sampled += (g.mean().x - exact.x).squaredNorm() / kRuns;
    const Eigen::Vector2d e = f.mean().x - x;
    nees += e.dot(f.covariance().ldlt().solve(e));
  }
  EXPECT_NEAR(ratio, 1.0, 4.5 * std::sqrt(ratio2 / kRuns));
  EXPECT_LT(exactly, 0.25 * sampled);
  // Chi-square of 600 degrees of freedom; a finite cloud adds about 1 / ESS to it.
  EXPECT_GT(nees, chi_square_quantile(5e-5, 2.0 * kRuns));
  EXPECT_LT(nees, chi_square_upper_quantile(5e-5, 2.0 * kRuns) * 1.03);
}

TEST(MarginalizedParticleFilter, StatusesAndWhatTheyLeave) {
  const Drift drift{1.0, 1.0};
  PairMarginalized f(at(0, 0), Eigen::Matrix2d::Identity(), {.count = 100, .seed = 2});
  const PairMarginalized before = f;
  const auto same = [&] {
    return f.mean().x == before.mean().x && f.covariance() == before.covariance() &&
           f.linear_covariance() == before.linear_covariance() && f.cloud().steps() == before.cloud().steps();
  };
  EXPECT_EQ(f.update(Observed<Sum>(Sum{1.0}, kNan, 1.0)).status, ParticleStatus::kNonFinite);
  EXPECT_EQ(f.update(Observed<Sum>(Sum{1.0}, 0.0, kNan)).status, ParticleStatus::kNonFinite);
  EXPECT_EQ(f.update(Observed<Sum>(Sum{1.0}, 0.0, 0.0)).status, ParticleStatus::kNotPositiveDefinite);
  EXPECT_EQ(f.predict(drift, -1.0).status, ParticleStatus::kTimeNotAdvancing);
  EXPECT_EQ(f.predict(Drift{kNan, 1.0}, 1.0).status, ParticleStatus::kNonFinite);
  EXPECT_EQ(f.step(drift, kNan, test::group(Observed<Sum>(Sum{1.0}, 0.0, 1.0))).status,
            ParticleStatus::kTimeNotAdvancing);
  EXPECT_EQ(f.step(drift, 1.0, test::group(Observed<Sum>(Sum{1.0}, kNan, 1.0))).status, ParticleStatus::kNonFinite);
  EXPECT_EQ(f.predict(Drift{1.0, 1e200}, 1.0).status, ParticleStatus::kNonFinite);
  const std::vector<Sum> many(17, Sum{1.0});
  EXPECT_EQ(f.update(Correlated<Sum>{many, Eigen::VectorXd::Zero(17), Eigen::MatrixXd::Identity(17, 17)}).status,
            ParticleStatus::kTooManyRows);
  EXPECT_TRUE(same());
  // No particle is that far away: the update is refused whole.
  EXPECT_EQ(f.update(Observed<Place>(Place{}, 1e200, 1.0)).status, ParticleStatus::kDegenerate);
  EXPECT_TRUE(same());
}

TEST(MarginalizedParticleFilter, RefusesWhatIsNotLinearByItself) {
  Eigen::Matrix2d correlated;
  correlated << 1.0, 0.1, 0.1, 1.0;
  EXPECT_THROW(PairMarginalized(at(0, 0), correlated, {}), std::invalid_argument);
  EXPECT_THROW(PairMarginalized(at(0, 0), Eigen::Matrix2d::Identity() * kNan, {}), std::invalid_argument);
  PairMarginalized f(at(0, 0), Eigen::Matrix2d::Identity(), {});
  EXPECT_THROW(static_cast<void>(f.update(Observed<test::Product>(test::Product{}, 1.0, 1.0))), std::invalid_argument);
  EXPECT_THROW(static_cast<void>(f.predict(test::Coupled{0.1, 0.0}, 1.0)), std::invalid_argument);
  EXPECT_THROW(static_cast<void>(f.predict(test::Coupled{0.0, 0.1}, 1.0)), std::invalid_argument);
}

}  // namespace
}  // namespace soopnav
