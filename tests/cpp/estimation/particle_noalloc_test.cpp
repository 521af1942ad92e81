#include <gtest/gtest.h>

#include <vector>

#include "estimation/particle_scene.hpp"
#include "estimation/particle_variant_scene.hpp"
#include "soopnav/estimation/particle_filter.hpp"
#include "support/allocation_count.hpp"

namespace soopnav {
namespace {

using test::planar_epoch;
using test::planar_start;
using test::PlanarClock;
using test::PlanarMotion;
using test::PlanarPseudorange;

template <class T>
void expect_no_heap(int threads, Resampling scheme) {
  ParticleFilter<PlanarClock, T> f(planar_start(), Eigen::Matrix<double, 5, 5>::Identity(),
                                   {.count = 3000, .threads = threads, .resampling = scheme, .ess_threshold = 1.0});
  const auto epoch = planar_epoch(1);
  const Walls<2> walls{{{{100, 100}, {101, 100}}}};
  std::vector<PlanarPseudorange> models;
  for (const auto& o : epoch) models.push_back(o.model);
  const Eigen::Vector4d z(5.0, 49.0, 48.0, 67.0);
  const Eigen::MatrixXd R = Eigen::MatrixXd::Identity(4, 4) * 4.0;
  const Correlated<PlanarPseudorange> together{models, z, R};
  const Contaminated<PlanarPseudorange> wild{epoch[0], 0.1, 0.01};
  std::vector<double> weights(f.count());
  std::vector<double> bins(20);
  const long count = test::allocations_of([&] {
    for (int k = 0; k < 4; ++k) {
      static_cast<void>(f.step(PlanarMotion{}, 0.1, epoch, walls));
      static_cast<void>(f.predict(PlanarMotion{}, 0.1));
      static_cast<void>(f.update(together, wild));
      static_cast<void>(f.reweight([](const auto&, std::span<T> l) { l[0] = T{-1}; }));
      static_cast<void>(f.update(epoch[1].model, -1e9, 1e-9));
      f.resample();
      static_cast<void>(f.covariance(f.mean()));
      f.weights(weights);
      static_cast<void>(f.histogram(0, 0.0, 10.0, bins));
    }
  });
  EXPECT_EQ(count, 0) << threads << " threads, " << to_string(scheme);
}

TEST(ParticleNoAlloc, NothingAfterConstruction) {
  if (!test::kAllocationsCounted) GTEST_SKIP() << "this build does not count allocations";
  for (const int threads : {1, 2}) {
    for (const Resampling scheme : {Resampling::kSystematic, Resampling::kMultinomial, Resampling::kResidual}) {
      expect_no_heap<double>(threads, scheme);
      expect_no_heap<float>(threads, scheme);
    }
  }
}

TEST(ParticleNoAlloc, NorDoVariants) {
  if (!test::kAllocationsCounted) GTEST_SKIP() << "this build does not count allocations";
  using test::Drift;
  using test::Place;
  const Eigen::Matrix2d P0 = Eigen::Vector2d(9.0, 4.0).asDiagonal();
  const std::vector<ParticleOptions> variants = {
      {.count = 3000, .auxiliary = true, .regularisation = 1.0},
      {.count = 3000, .adaptive = {.bin_sizes = {0.5, 0.0}, .least = 20}},
      {.count = 3000, .threads = 2, .regularisation = 1.0, .adaptive = {.bin_sizes = {0.5, 0.5}, .least = 20}}};
  for (const ParticleOptions& options : variants) {
    test::PairCloud f({}, P0, options);
    test::PairMarginalized g({}, P0, options);
    const std::vector<test::Sum> models{test::Sum{1.0}, test::Sum{-1.0}};
    const Eigen::Vector2d z(0.3, 0.1);
    const Eigen::Matrix2d R = Eigen::Matrix2d::Identity();
    const Correlated<test::Sum> both{models, z, R};
    const long count = test::allocations_of([&] {
      for (int k = 0; k < 5; ++k) {
        static_cast<void>(f.step(Drift{0.1, 0.1}, 1.0, Observed<Place>(Place{}, 1.0, 0.1)));
        static_cast<void>(f.predict(Drift{3.0, 0.1}, 1.0));
        f.resample();
        static_cast<void>(g.step(Drift{0.1, 0.1}, 1.0, both));
        static_cast<void>(g.predict(Drift{3.0, 0.1}, 1.0));
        static_cast<void>(g.update(Observed<Place>(Place{}, 1.0, 0.1)));
        static_cast<void>(g.covariance());
      }
    });
    EXPECT_EQ(count, 0);
  }
}

TEST(ParticleNoAlloc, StorageIsCounted) {
  if (!test::kAllocationsCounted) GTEST_SKIP() << "this build does not count allocations";
  // The constructor takes a handful of arrays and nothing for each particle.
  const long few = test::allocations_of([] {
    const ParticleFilter<PlanarClock> f(planar_start(), Eigen::Matrix<double, 5, 5>::Identity(), {.count = 20});
    static_cast<void>(f.count());
  });
  const long many = test::allocations_of([] {
    const ParticleFilter<PlanarClock> f(planar_start(), Eigen::Matrix<double, 5, 5>::Identity(), {.count = 1000000});
    EXPECT_LE(f.storage_bytes(), 100'000'000U);
    EXPECT_GE(f.storage_bytes(), 96'000'000U);
  });
  EXPECT_EQ(few, many);
  EXPECT_LE(many, 20);
}

}  // namespace
}  // namespace soopnav
