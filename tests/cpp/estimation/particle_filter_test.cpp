#include "soopnav/estimation/particle_filter.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <limits>
#include <numeric>
#include <string>
#include <vector>

#include "estimation/particle_scene.hpp"
#include "soopnav/measurement/azimuth.hpp"
#include "support/nan.hpp"

namespace soopnav {
namespace {

using test::planar_epoch;
using test::planar_start;
using test::PlanarClock;
using test::PlanarMotion;
using test::PlanarPseudorange;
using Filter = ParticleFilter<PlanarClock>;
using Square5 = Eigen::Matrix<double, 5, 5>;
using Line = ComposedState<PlanarFrame, Role<1, PositionTag>>;
using LineFilter = ParticleFilter<Line>;
using Square1 = Eigen::Matrix<double, 1, 1>;

using ::soopnav::test::kNan;
constexpr double kInfinity = std::numeric_limits<double>::infinity();

struct LinePosition {
  static constexpr int kDim = 1;
  template <class X, class Y>
  [[nodiscard]] bool predict(const X& x, Y& y) const {
    y.value(0) = x(kPositionOf<1>)[0];
    if constexpr (Y::kJacobian) y.jacobian(kPositionOf<1>)(0) = 1.0;
    return true;
  }
};

struct Walk {
  static constexpr int kNoise = 2;
  template <class X, class W, class Y>
  [[nodiscard]] bool propagate(const X& x, double /*dt_s*/, const W& w, Y& y) const {
    for (int i = 0; i < 2; ++i) y.next(kPlanarPosition)[i] = x(kPlanarPosition)[i] + w[i] * 0.8;
    return true;
  }
};

struct Breaks {
  static constexpr int kNoise = 0;
  template <class X, class W, class Y>
  [[nodiscard]] bool propagate(const X& x, double dt_s, const W& /*w*/, Y& y) const {
    using std::sqrt;
    y.next(kPositionOf<1>)[0] = sqrt(x(kPositionOf<1>)[0]) * dt_s;
    return true;
  }
};

Filter make(ParticleOptions options = {}) { return {planar_start(), Square5::Identity(), options}; }

std::vector<double> numbers(const Filter& f) {
  std::vector<double> all;
  for (int c = 0; c < Filter::kSize; ++c) all.insert(all.end(), f.component(c).begin(), f.component(c).end());
  std::vector<double> w(f.count());
  f.weights(w);
  all.insert(all.end(), w.begin(), w.end());
  all.push_back(f.log_likelihood());
  all.push_back(f.ess());
  return all;
}

template <class F>
std::string message_of(F f) {
  try {
    f();
  } catch (const std::invalid_argument& e) {
    return e.what();
  }
  return "nothing thrown";
}

TEST(ParticleFilter, SetUpIsChecked) {
  EXPECT_THAT(message_of([] { make({.count = 0}); }), testing::HasSubstr("count is 0"));
  EXPECT_THAT(message_of([] { make({.threads = 0}); }), testing::HasSubstr("threads is 0"));
  EXPECT_THAT(message_of([] { make({.ess_threshold = 1.5}); }), testing::HasSubstr("ess_threshold is 1.5"));
  EXPECT_THAT(message_of([] { make({.ess_threshold = kNan}); }), testing::HasSubstr("ess_threshold"));
  EXPECT_THAT(message_of([] { make({.resampling = static_cast<Resampling>(9)}); }),
              testing::HasSubstr("resampling is 9"));
  PlanarClock bad = planar_start();
  bad.x[2] = kNan;
  EXPECT_THAT(message_of([&] { Filter(bad, Square5::Identity(), {}); }), testing::HasSubstr("x0"));
  EXPECT_THAT(message_of([&] { Filter(planar_start(), -Square5::Identity(), {}); }), testing::HasSubstr("P0"));
  EXPECT_THAT(message_of([&] { Filter(planar_start(), Filter::Tangent::Ones(), Filter::Tangent::Zero(), {}); }),
              testing::HasSubstr("low[0]"));
  EXPECT_THAT(message_of([&] { Filter(std::span<const PlanarClock>(), {}); }), testing::HasSubstr("count is 0"));
  EXPECT_THAT(message_of([&] { Filter(std::span<const PlanarClock>(&bad, 1), {}); }), testing::HasSubstr("particles"));
  std::vector<double> small(3);
  EXPECT_THROW(make().weights(small), std::invalid_argument);
}

TEST(ParticleFilter, StartsAsAsked) {
  Square5 P0 = Square5::Identity();
  P0(0, 1) = P0(1, 0) = 0.8;
  P0(4, 4) = 0.0;  // known exactly
  const Filter normal(planar_start(), P0, {.count = 200000, .seed = 3});
  const PlanarClock mean = normal.mean();
  const Square5 P = normal.covariance(mean);
  for (int i = 0; i < 5; ++i) {
    EXPECT_NEAR(mean.x[i], planar_start().x[i], 5.0 / std::sqrt(200000.0)) << i;
    for (int j = 0; j < 5; ++j) EXPECT_NEAR(P(i, j), P0(i, j), 5.0 * std::sqrt(2.0 / 200000.0)) << i << j;
  }
  EXPECT_NEAR(P(4, 4), 0.0, 1e-25);
  EXPECT_EQ(normal.ess(), 200000.0);

  Filter::Tangent low;
  Filter::Tangent high;
  low << -1, -2, 0, 3, 4;
  high << 1, 2, 0, 5, 5;
  const Filter box(planar_start(), low, high, {.count = 20000, .seed = 3});
  for (int c = 0; c < 5; ++c) {
    const auto x = box.component(c);
    EXPECT_GE(*std::min_element(x.begin(), x.end()), planar_start().x[c] + low[c]);
    EXPECT_LE(*std::max_element(x.begin(), x.end()), planar_start().x[c] + high[c]);
    EXPECT_NEAR(box.covariance()(c, c), std::pow(high[c] - low[c], 2) / 12.0,
                0.08 * std::pow(high[c] - low[c], 2) / 12.0);
  }

  std::vector<PlanarClock> given(3, planar_start());
  given[1].x[0] = 9.0;
  const Filter from(given, {.seed = 1});
  EXPECT_EQ(from.count(), 3U);
  EXPECT_EQ(from.particle(1).x, given[1].x);
  EXPECT_NEAR(from.mean().x[0], 5.0, 1e-14);
}

TEST(ParticleFilter, OneParticle) {
  Filter f = make({.count = 1, .ess_threshold = 1.0});
  for (int k = 1; k < 5; ++k) {
    const auto report = f.step(PlanarMotion{}, 0.1, planar_epoch(k));
    EXPECT_TRUE(report.accepted());
    EXPECT_EQ(report.ess, 1.0);
  }
  EXPECT_EQ(f.mean().x, f.particle(0).x);
  EXPECT_EQ(f.covariance(), Square5::Zero());
  std::vector<double> w(1);
  f.weights(w);
  EXPECT_EQ(w[0], 1.0);
  f.resample();
  EXPECT_EQ(f.ess(), 1.0);
}

TEST(ParticleFilter, RefusedCallsChangeNothing) {
  Filter f = make({.count = 333, .ess_threshold = 1.0});
  static_cast<void>(f.step(PlanarMotion{}, 0.1, planar_epoch(1)));
  const auto before = numbers(f);
  const auto expect_refused = [&](const ParticleReport& report, ParticleStatus status) {
    EXPECT_EQ(report.status, status) << to_string(report.status);
    EXPECT_TRUE(std::isnan(report.log_likelihood));
    EXPECT_EQ(numbers(f), before);
  };
  const PlanarPseudorange model{Eigen::Vector2d(0, 0)};
  for (const double z : {kNan, kInfinity}) expect_refused(f.update(model, z, 1.0), ParticleStatus::kNonFinite);
  expect_refused(f.update(model, 1.0, kNan), ParticleStatus::kNonFinite);
  for (const double R : {0.0, -1.0}) expect_refused(f.update(model, 1.0, R), ParticleStatus::kNotPositiveDefinite);
  auto epoch = planar_epoch(2);
  epoch[3].z[0] = kNan;
  expect_refused(f.step(PlanarMotion{}, 0.1, epoch), ParticleStatus::kNonFinite);
  epoch = planar_epoch(2);
  epoch[2].R(0, 0) = -1.0;
  expect_refused(f.step(PlanarMotion{}, 0.1, epoch), ParticleStatus::kNotPositiveDefinite);
  for (const double dt : {0.0, -0.1, kNan, kInfinity}) {
    expect_refused(f.predict(PlanarMotion{}, dt), ParticleStatus::kTimeNotAdvancing);
    expect_refused(f.step(PlanarMotion{}, dt, planar_epoch(2)), ParticleStatus::kTimeNotAdvancing);
  }
  const Contaminated<PlanarPseudorange> outlier{planar_epoch(2)[0], 1.5, 0.1};
  expect_refused(f.update(outlier), ParticleStatus::kNonFinite);
  // Correlated: wrong size, not symmetric, too many.
  const std::vector<PlanarPseudorange> two(2, model);
  const Eigen::Vector2d z(5.0, 6.0);
  Eigen::Matrix2d R;
  R << 1.0, 0.5, 0.2, 1.0;
  expect_refused(f.update(Correlated<PlanarPseudorange>{two, z, R}), ParticleStatus::kNotPositiveDefinite);
  expect_refused(f.update(Correlated<PlanarPseudorange>{two, z, Eigen::Matrix3d::Identity()}),
                 ParticleStatus::kNotPositiveDefinite);
  const std::vector<PlanarPseudorange> many(17, model);
  expect_refused(
      f.update(Correlated<PlanarPseudorange>{many, Eigen::VectorXd::Zero(17), Eigen::MatrixXd::Identity(17, 17)}),
      ParticleStatus::kTooManyRows);
}

TEST(ParticleFilter, VanishedWeightsAreRestored) {
  Filter f = make({.count = 600, .ess_threshold = 0.0});
  static_cast<void>(f.step(PlanarMotion{}, 0.1, planar_epoch(1)));
  const auto before = numbers(f);
  const Region nowhere{[](const auto& x) { return x(kPlanarPosition)[0] > 1e9; }};
  const auto report = f.update(nowhere);
  EXPECT_EQ(report.status, ParticleStatus::kDegenerate);
  EXPECT_EQ(report.log_likelihood, -kInfinity);
  EXPECT_EQ(numbers(f), before);
  for (const double l : {-kInfinity, kNan, kInfinity}) {
    const auto all =
        f.reweight([l](const Filter::Chunk&, std::span<double> out) { std::fill(out.begin(), out.end(), l); });
    EXPECT_EQ(all.status, ParticleStatus::kDegenerate);
    EXPECT_EQ(numbers(f), before);
  }
  // In a step the prediction stands, with the weights from before it.
  Filter predicted = f;
  static_cast<void>(predicted.predict(PlanarMotion{}, 0.1));
  EXPECT_EQ(f.step(PlanarMotion{}, 0.1, nowhere).status, ParticleStatus::kDegenerate);
  EXPECT_EQ(numbers(f), numbers(predicted));
  EXPECT_TRUE(f.step(PlanarMotion{}, 0.1, planar_epoch(3)).accepted());
}

TEST(ParticleFilter, VanishedWeightsAfterResamplingAreEqual) {
  Filter f = make({.count = 600, .ess_threshold = 1.0});
  static_cast<void>(f.step(PlanarMotion{}, 0.1, planar_epoch(1)));
  const Region nowhere{[](const auto& x) { return x(kPlanarPosition)[0] > 1e9; }};
  const auto report = f.step(PlanarMotion{}, 0.1, nowhere);
  EXPECT_EQ(report.status, ParticleStatus::kDegenerate);
  EXPECT_TRUE(report.resampled);
  EXPECT_EQ(report.ess, 600.0);
  EXPECT_TRUE(f.mean().x.allFinite());
  EXPECT_TRUE(f.step(PlanarMotion{}, 0.1, planar_epoch(2)).accepted());
}

TEST(ParticleFilter, SomeLikelihoodsThatAreNoNumbers) {
  std::vector<Line> given(20);
  for (int i = 0; i < 20; ++i) given[static_cast<std::size_t>(i)].x[0] = i;
  LineFilter f(given, {});
  const auto report = f.reweight([](const LineFilter::Chunk& chunk, std::span<double> out) {
    ASSERT_EQ(chunk.first, 0U);
    ASSERT_EQ(out.size(), 20U);
    for (std::size_t i = 0; i < out.size(); ++i) {
      out[i] = i == 3 ? kNan : i == 4 ? kInfinity : i == 5 ? -kInfinity : chunk.components[0][i] < 10.0 ? 0.0 : -1e4;
    }
  });
  EXPECT_TRUE(report.accepted());
  EXPECT_NEAR(report.ess, 7.0, 1e-12);
  EXPECT_NEAR(report.log_likelihood, std::log(7.0 / 20.0), 1e-14);
  std::vector<double> w(20);
  f.weights(w);
  for (std::size_t i = 0; i < 20; ++i) EXPECT_EQ(w[i] > 0.0, i < 3 || (i > 5 && i < 10)) << i;
}

TEST(ParticleFilter, AnExceptionOfALikelihoodPassesOn) {
  for (const int threads : {1, 2}) {
    Filter f = make({.count = 2000, .threads = threads});
    const auto before = numbers(f);
    EXPECT_THROW(static_cast<void>(f.reweight([](const Filter::Chunk& chunk, std::span<double> out) {
                   out[0] = -1.0;
                   if (chunk.first > 0) throw std::runtime_error("no likelihood");
                 })),
                 std::runtime_error);
    EXPECT_EQ(numbers(f), before);
    Filter untouched = make({.count = 2000, .threads = threads});
    f.resample();
    untouched.resample();
    EXPECT_EQ(numbers(f), numbers(untouched));
    EXPECT_TRUE(f.update(planar_epoch(1)).accepted());
  }
}

// Throws for the second chunk and all behind it.
struct Fails {
  static constexpr int kNoise = 0;
  std::atomic<int>* calls;
  template <class X, class W, class Y>
  [[nodiscard]] bool propagate(const X& x, double /*dt_s*/, const W& /*w*/, Y& y) const {
    if (calls->fetch_add(1) > 100) throw std::runtime_error("no motion");
    y.next(kPositionOf<1>)[0] = x(kPositionOf<1>)[0];
    return true;
  }
};

TEST(ParticleFilter, AnExceptionOfAMotionPassesOn) {
  std::vector<Line> given(2000);
  for (std::size_t i = 0; i < given.size(); ++i) given[i].x[0] = static_cast<double>(i) / 1000.0 - 1.0;
  for (const double threshold : {0.0, 1.0}) {
    for (const int threads : {1, 2}) {
      LineFilter f(given, {.threads = threads, .ess_threshold = threshold});
      ASSERT_TRUE(f.update(LinePosition{}, 0.5, 0.01).accepted());
      const double mean = f.mean().x[0];
      const double ess = f.ess();
      std::atomic<int> calls{0};
      EXPECT_THROW(static_cast<void>(f.step(Fails{&calls}, 1.0, Observed<LinePosition>(LinePosition{}, 0.5, 0.01))),
                   std::runtime_error);
      EXPECT_NEAR(f.mean().x[0], mean, threshold == 0.0 ? 0.0 : 0.01);
      EXPECT_EQ(f.ess(), threshold == 0.0 ? ess : 2000.0);
      f.resample();
      EXPECT_NEAR(f.mean().x[0], mean, 0.01);
      EXPECT_TRUE(f.update(LinePosition{}, 0.5, 0.01).accepted());
    }
  }
}

TEST(ParticleFilter, WeightsAreTheGaussian) {
  std::vector<Line> given(5);
  for (int i = 0; i < 5; ++i) given[static_cast<std::size_t>(i)].x[0] = i;
  LineFilter f(given, {});
  const auto density = [](double x, double z, double R) {
    return std::exp(-0.5 * (x - z) * (x - z) / R) / std::sqrt(kTwoPi * R);
  };
  const auto first = f.update(LinePosition{}, 1.5, 0.5);
  double sum = 0.0;
  for (int i = 0; i < 5; ++i) sum += density(i, 1.5, 0.5) / 5.0;
  EXPECT_NEAR(first.log_likelihood, std::log(sum), 1e-14);
  // A second one, with the weights carried on.
  const auto second = f.update(LinePosition{}, 2.5, 2.0);
  std::vector<double> w(5);
  std::vector<double> expected(5);
  double total = 0.0;
  for (int i = 0; i < 5; ++i) {
    total += expected[static_cast<std::size_t>(i)] = density(i, 1.5, 0.5) * density(i, 2.5, 2.0);
  }
  f.weights(w);
  for (std::size_t i = 0; i < 5; ++i) EXPECT_NEAR(w[i], expected[i] / total, 1e-15);
  EXPECT_NEAR(second.log_likelihood, std::log(total / 5.0 / sum), 1e-13);
  EXPECT_NEAR(f.log_likelihood(), std::log(total / 5.0), 1e-13);
  EXPECT_NEAR(f.mean().x[0], std::inner_product(w.begin(), w.end(), std::vector<double>{0, 1, 2, 3, 4}.begin(), 0.0),
              1e-14);
  double squares = 0.0;
  for (const double x : w) squares += x * x;
  EXPECT_NEAR(f.ess(), 1.0 / squares, 1e-12);
}

TEST(ParticleFilter, CorrelatedRowsCountTheirCovariance) {
  Filter f = make({.count = 40});
  Filter separate = f;
  const auto epoch = planar_epoch(1);
  std::vector<PlanarPseudorange> models;
  Eigen::Vector4d z;
  for (int i = 0; i < 4; ++i) {
    models.push_back(epoch[static_cast<std::size_t>(i)].model);
    z[i] = epoch[static_cast<std::size_t>(i)].z[0];
  }
  Eigen::Matrix4d R = Eigen::Matrix4d::Identity();
  static_cast<void>(f.update(Correlated<PlanarPseudorange>{models, z, R}));
  static_cast<void>(separate.update(epoch));
  EXPECT_NEAR(f.log_likelihood(), separate.log_likelihood(), 1e-12);
  EXPECT_NEAR((f.mean().x - separate.mean().x).norm(), 0.0, 1e-12);
  // With a full R, against the density written out for every particle.
  Filter full = make({.count = 40});
  R.array() += 3.0;
  std::vector<double> w(40);
  double total = 0.0;
  for (std::size_t i = 0; i < 40; ++i) {
    const PlanarClock x = full.particle(i);
    Eigen::Vector4d r;
    for (int k = 0; k < 4; ++k) {
      r[k] = z[k] - (x.x.head<2>() - test::kSources[static_cast<std::size_t>(k)]).norm() - x.x[4];
    }
    total += w[i] = std::exp(-0.5 * r.dot(R.llt().solve(r))) / std::sqrt(std::pow(kTwoPi, 4) * R.determinant());
  }
  const auto report = full.update(Correlated<PlanarPseudorange>{models, z, R});
  EXPECT_NEAR(report.log_likelihood, std::log(total / 40.0), 1e-12);
  std::vector<double> got(40);
  full.weights(got);
  for (std::size_t i = 0; i < 40; ++i) EXPECT_NEAR(got[i], w[i] / total, 1e-13);
}

TEST(ParticleFilter, MoreObservationsThanABatch) {
  Filter f = make({.count = 100});
  Filter one_by_one = f;
  std::vector<Observed<PlanarPseudorange>> many;
  for (int k = 0; k < 7; ++k) {
    for (const auto& o : planar_epoch(k)) many.push_back(o);
  }
  static_cast<void>(f.update(many));
  for (const auto& o : many) static_cast<void>(one_by_one.update(o));
  EXPECT_NEAR(f.log_likelihood(), one_by_one.log_likelihood(), 1e-9);
  EXPECT_NEAR((f.mean().x - one_by_one.mean().x).norm(), 0.0, 1e-10);
}

TEST(ParticleFilter, OutliersHaveAFloor) {
  std::vector<Line> given(2);
  given[1].x[0] = 1.0;
  const auto mixture = [](double x, double z) {
    return 0.9 * std::exp(-0.5 * (z - x) * (z - x)) / std::sqrt(kTwoPi) + 0.1 * 0.01;
  };
  for (const double z : {0.7, 3.0, -40.0}) {
    LineFilter f(given, {});
    const auto report = f.update(Contaminated<LinePosition>{Observed<LinePosition>(LinePosition{}, z, 1.0), 0.1, 0.01});
    std::vector<double> w(2);
    f.weights(w);
    const double total = mixture(0.0, z) + mixture(1.0, z);
    EXPECT_NEAR(w[1], mixture(1.0, z) / total, 1e-14);
    EXPECT_NEAR(report.log_likelihood, std::log(total / 2.0), 1e-13);
  }
  // None and nothing but outliers.
  LineFilter none(given, {});
  LineFilter plain(given, {});
  const Observed<LinePosition> z(LinePosition{}, 0.3, 1.0);
  EXPECT_NEAR(none.update(Contaminated<LinePosition>{z, 0.0, 0.0}).log_likelihood, plain.update(z).log_likelihood,
              1e-14);
  LineFilter only(given, {});
  EXPECT_NEAR(only.update(Contaminated<LinePosition>{z, 1.0, 0.25}).log_likelihood, std::log(0.25), 1e-14);
  EXPECT_EQ(only.ess(), 2.0);
}

TEST(ParticleFilter, NobodyWalksThroughWalls) {
  // A room of 2 m by 2 m around the origin; fast particles.
  using Walker = ComposedState<PlanarFrame, Role<2, PositionTag>>;
  const Walls<2> room{{{{-1, -1}, {1, -1}}, {{1, -1}, {1, 1}}, {{1, 1}, {-1, 1}}, {{-1, 1}, {-1, -1}}}};
  ParticleFilter<Walker> f(Walker{}, Eigen::Matrix2d::Identity() * 0.01,
                           {.count = 3000, .seed = 2, .ess_threshold = 1.0});
  for (int k = 0; k < 20; ++k) {
    const auto report = f.step(Walk{}, 1.0, room);
    ASSERT_TRUE(report.accepted());
    EXPECT_LT(report.ess, 2900.0);
    f.resample();
    for (std::size_t i = 0; i < f.count(); ++i) ASSERT_LT(f.particle(i).x.cwiseAbs().maxCoeff(), 1.0);
  }
  EXPECT_LT(f.mean().x.norm(), 0.1);
}

TEST(Walls, CrossingTouchingAndPassing) {
  using Walker = ComposedState<PlanarFrame, Role<2, PositionTag>>;
  const Walls<2> wall{{{{0, 0}, {2, 0}}}};
  const auto allowed = [&wall](double x0, double y0, double x1, double y1) {
    Walker a;
    Walker b;
    a.x << x0, y0;
    b.x << x1, y1;
    return static_cast<bool>(wall.allows(a, b));
  };
  EXPECT_FALSE(allowed(1, -1, 1, 1));
  EXPECT_FALSE(allowed(1, 1, 0.5, -3));
  EXPECT_TRUE(allowed(3, -1, 3, 1));   // past its end
  EXPECT_TRUE(allowed(1, 1, 1, 0.1));  // not far enough
  EXPECT_FALSE(allowed(1, 1, 1, 0));   // onto it
  EXPECT_TRUE(allowed(1, 1, 1, 1));    // at rest beside it
  EXPECT_TRUE(allowed(-1, 0, -3, 0));  // away along its line... touches nothing
  EXPECT_TRUE(Walls<2>{}.allows(Walker{}, Walker{}));
  // A wall that is a point stops who walks over it, and nobody else.
  const Walls<2> post{{{{1.0, 1.0}, {1.0, 1.0}}}};
  const auto passes = [&post](double x0, double y0, double x1, double y1) {
    Walker a;
    Walker b;
    a.x << x0, y0;
    b.x << x1, y1;
    return static_cast<bool>(post.allows(a, b));
  };
  EXPECT_FALSE(passes(0, 0, 2, 2));
  EXPECT_TRUE(passes(0, 0, 2, 1.9));
  EXPECT_TRUE(passes(3, 3, 3, 3));
  EXPECT_TRUE(passes(2, 2, 3, 3));
}

TEST(ParticleFilter, LostParticlesStayAndLoseTheirWeight) {
  std::vector<Line> given(10);
  for (int i = 0; i < 10; ++i) given[static_cast<std::size_t>(i)].x[0] = i < 4 ? -1.0 : 4.0;
  LineFilter f(given, {.ess_threshold = 0.0});
  const auto report = f.predict(Breaks{}, 1.0);
  EXPECT_TRUE(report.accepted());
  EXPECT_NEAR(report.ess, 6.0, 1e-12);
  EXPECT_EQ(f.particle(0).x[0], -1.0);
  EXPECT_EQ(f.particle(9).x[0], 2.0);
  EXPECT_NEAR(f.mean().x[0], 2.0, 1e-14);
}

TEST(ParticleFilter, ResamplesWhenAsked) {
  for (const double threshold : {0.0, 0.5, 1.0}) {
    Filter f = make({.count = 500, .ess_threshold = threshold});
    static_cast<void>(f.step(PlanarMotion{}, 0.1, planar_epoch(1)));
    for (int k = 2; k < 20; ++k) {
      const double ess = f.ess();
      const auto report = f.step(PlanarMotion{}, 0.1, planar_epoch(k));
      EXPECT_EQ(report.resampled, threshold == 1.0 || ess < threshold * 500.0) << threshold << " " << k;
    }
  }
}

TEST(ParticleFilter, HistogramIsTheMarginal) {
  std::vector<Line> given(4);
  for (int i = 0; i < 4; ++i) given[static_cast<std::size_t>(i)].x[0] = i;
  LineFilter f(given, {});
  std::vector<double> bins(3);
  EXPECT_EQ(f.histogram(0, 0.5, 3.5, bins), 0.75);
  EXPECT_EQ(bins, std::vector<double>(3, 0.25));
  EXPECT_EQ(f.histogram(0, 3.0, 3.0, bins), 0.0);
  EXPECT_EQ(f.histogram(0, kNan, 3.0, bins), 0.0);
  EXPECT_EQ(bins, std::vector<double>(3, 0.0));
  EXPECT_EQ(f.histogram(0, -1e9, 1e9, bins), 1.0);
}

TEST(ParticleFilter, HeadingsHaveACircularMean) {
  using Turner = ComposedState<PlanarFrame, Role<1, HeadingTag>>;
  std::vector<Turner> given(3);
  given[0].x[0] = kPi - 0.1;
  given[1].x[0] = -kPi + 0.1;
  given[2].x[0] = -kPi + 0.3;
  const ParticleFilter<Turner> f(given, {});
  EXPECT_NEAR(wrap_to_pi(f.mean().x[0] - (kPi + 0.1)), 0.0, 1e-3);
  const double d0 = f.mean().local(given[0])[0];
  const double d1 = f.mean().local(given[1])[0];
  const double d2 = f.mean().local(given[2])[0];
  EXPECT_NEAR(f.covariance()(0, 0), (d0 * d0 + d1 * d1 + d2 * d2) / 3.0, 1e-12);
}

TEST(ParticleFilter, AttitudesHaveAMeanRotation) {
  using Body = ComposedState<EnuFrame, Role<3, AttitudeTag>, Role<1, ClockBiasTag>>;
  Body center;
  const Eigen::Quaterniond q(Eigen::AngleAxisd(2.0, Eigen::Vector3d(1, -2, 0.5).normalized()));
  center.x << q.w(), q.x(), q.y(), q.z(), 7.0;
  Eigen::Matrix4d P0 = Eigen::Matrix4d::Identity() * 0.01;
  P0(0, 1) = P0(1, 0) = 0.006;
  constexpr std::size_t kCount = 100000;
  ParticleFilter<Body> f(center, P0, {.count = kCount, .seed = 4});
  const Body mean = f.mean();
  EXPECT_LT(center.local(mean).norm(), 5.0 * 0.1 * 2.0 / std::sqrt(static_cast<double>(kCount)));
  const Eigen::Matrix4d P = f.covariance(mean);
  EXPECT_LT((P - P0).cwiseAbs().maxCoeff(), 5.0 * 0.01 * std::sqrt(2.0 / kCount) + 1e-4);
  // The packets' logarithm is the state's.
  Eigen::Matrix4d direct = Eigen::Matrix4d::Zero();
  for (std::size_t i = 0; i < kCount; ++i) {
    const auto d = mean.local(f.particle(i));
    direct += d * d.transpose() / static_cast<double>(kCount);
  }
  EXPECT_LT((P - direct).cwiseAbs().maxCoeff(), 1e-12);
}

TEST(ParticleFilter, BearingResidualsWrap) {
  using Seen = Azimuth<PlanarFrame, Known<1>, Known<2>>;
  std::vector<PlanarClock> given(2);
  given[0].x.head<2>() << 10.0, 0.1;
  given[1].x.head<2>() << 10.0, -0.1;
  ParticleFilter<PlanarClock> f(given, {});
  // The source lies in direction -pi + 0.01 from the first, pi - 0.01 from the second; seen at pi - 0.01.
  static_cast<void>(f.update(Seen{Eigen::Vector2d(0, 0), {}}, kPi - 0.01, 0.01 * 0.01));
  std::vector<double> w(2);
  f.weights(w);
  EXPECT_NEAR(w[1] / w[0], std::exp(2.0), 0.02);
}

TEST(ParticleFilter, StorageIsWhatItSays) {
  const Filter f = make({.count = 100000});
  EXPECT_GE(f.storage_bytes(), 100000U * (2 * 5 * 8 + 2 * 8));
  EXPECT_LE(f.storage_bytes(), 100000U * 98);
  const ParticleFilter<PlanarClock, float> small(planar_start(), Square5::Identity(), {.count = 100000});
  EXPECT_LE(small.storage_bytes(), 100000U * 50);
}

TEST(ParticleFilter, StatusesHaveNames) {
  EXPECT_EQ(to_string(ParticleStatus::kDegenerate), "degenerate");
  EXPECT_EQ(to_string(static_cast<ParticleStatus>(99)), "unknown");
}

}  // namespace
}  // namespace soopnav
