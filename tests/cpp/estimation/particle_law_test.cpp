// What must hold between runs: the same bits for any number of threads and either instruction set, one pass for two
// calls, copies that go on alike.

#include <gtest/gtest.h>

#include <array>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <span>
#include <thread>
#include <vector>

#include "estimation/particle_baseline.hpp"
#include "estimation/particle_scene.hpp"
#include "soopnav/estimation/particle_filter.hpp"

namespace soopnav {
namespace {

using test::planar_epoch;
using test::planar_start;
using test::PlanarClock;
using test::PlanarMotion;

template <class T>
class ParticleLaw : public testing::Test {
 protected:
  using Filter = ParticleFilter<PlanarClock, T>;

  static Filter make(ParticleOptions options) {
    options.seed = 17;
    return {planar_start(), Eigen::Matrix<double, 5, 5>::Identity() * 0.5, options};
  }
  // Everything there is, as bits.
  static std::vector<std::uint64_t> bits(const Filter& f) {
    std::vector<double> all;
    for (int c = 0; c < Filter::kSize; ++c) {
      for (const T x : f.component(c)) all.push_back(static_cast<double>(x));
    }
    std::vector<double> w(f.count());
    f.weights(w);
    all.insert(all.end(), w.begin(), w.end());
    const PlanarClock mean = f.mean();
    const auto P = f.covariance();
    all.insert(all.end(), mean.x.data(), mean.x.data() + mean.x.size());
    all.insert(all.end(), P.data(), P.data() + P.size());
    all.push_back(f.log_likelihood());
    all.push_back(f.ess());
    std::vector<std::uint64_t> out(all.size());
    std::memcpy(out.data(), all.data(), all.size() * sizeof(double));
    return out;
  }
  static void drive(Filter& f, int first = 1, int last = 8) {
    for (int k = first; k <= last; ++k) {
      if (k % 3 == 0) {
        static_cast<void>(f.predict(PlanarMotion{}, 0.1));
        static_cast<void>(f.update(planar_epoch(k)));
      } else {
        static_cast<void>(f.step(PlanarMotion{}, 0.1, planar_epoch(k)));
      }
    }
  }
};

using Scalars = testing::Types<double, float>;
TYPED_TEST_SUITE(ParticleLaw, Scalars);

// Around the edges of packets and chunks, and several chunks.
constexpr std::size_t kCounts[] = {1, 7, 16, 511, 512, 513, 5000};

TYPED_TEST(ParticleLaw, ThreadsDoNotShow) {
  for (const Resampling scheme :
       {Resampling::kSystematic, Resampling::kStratified, Resampling::kMultinomial, Resampling::kResidual}) {
    for (const std::size_t count : kCounts) {
      std::vector<std::uint64_t> alone;
      for (const int threads : {1, 2, 3}) {
        auto f = this->make({.count = count, .threads = threads, .resampling = scheme, .ess_threshold = 0.9});
        this->drive(f);
        if (threads == 1) {
          alone = this->bits(f);
        } else {
          ASSERT_EQ(this->bits(f), alone) << to_string(scheme) << " " << count << " " << threads;
        }
      }
    }
  }
}

// Variants of the filter, for as many threads and either instruction set.
TYPED_TEST(ParticleLaw, VariantsShowNeitherThreadsNorInstructionSet) {
  const AdaptiveCount adaptive{.bin_sizes = {0.2, 0.2, 0.0, 0.0, 0.0}, .least = 5};
  for (const std::size_t count : {std::size_t{7}, std::size_t{513}, std::size_t{5000}}) {
    const std::vector<ParticleOptions> variants = {{.count = count, .auxiliary = true},
                                                   {.count = count, .auxiliary = true, .regularisation = 1.0},
                                                   {.count = count, .regularisation = 0.5, .adaptive = adaptive}};
    for (std::size_t v = 0; v < variants.size(); ++v) {
      std::vector<std::uint64_t> alone;
      for (const int threads : {1, 2, 3, -1}) {
        ParticleOptions options = variants[v];
        options.threads = std::abs(threads);
        options.portable_kernels = threads < 0;
        auto f = this->make(options);
        this->drive(f);
        if (alone.empty()) alone = this->bits(f);
        ASSERT_EQ(this->bits(f), alone) << "variant " << v << ", " << count << ", " << threads << " threads";
      }
    }
  }
}

TYPED_TEST(ParticleLaw, TheInstructionSetDoesNotShow) {
  if (!detail::has_wide_loops()) GTEST_SKIP() << "this build or processor has one instruction set only";
  for (const std::size_t count : kCounts) {
    auto wide = this->make({.count = count, .ess_threshold = 0.9});
    auto portable = this->make({.count = count, .ess_threshold = 0.9, .portable_kernels = true});
    this->drive(wide);
    this->drive(portable);
    ASSERT_EQ(this->bits(wide), this->bits(portable)) << count;
  }
}

TYPED_TEST(ParticleLaw, TheLibrarysKernelsAreTheBaselines) {
  using T = TypeParam;
  RandomStream random(9);
  for (const std::size_t n : {16U, 64U, 512U}) {
    for (const double spread : {1.0, 50.0, 400.0}) {
      std::vector<T> l(n);
      for (T& x : l) x = static_cast<T>(spread * random.normal());
      l[n / 2] = -std::numeric_limits<T>::infinity();
      const auto sums = detail::weigh_chunk(l.data(), n);
      EXPECT_EQ((std::array{sums.largest, sums.sum, sums.squares}), particle_baseline::weigh(l.data(), n));
      std::vector<double> here(n);
      std::vector<double> there(n);
      detail::relative_weights(l.data(), sums.largest, n, here.data());
      particle_baseline::relative(l.data(), sums.largest, n, there.data());
      EXPECT_EQ(here, there);
      for (std::size_t i = 0; i < n; ++i) {
        const double exact = std::exp(static_cast<double>(l[i] - static_cast<T>(sums.largest)));
        const double unit = sizeof(T) == 8 ? 2.3e-16 : 1.2e-7;
        ASSERT_NEAR(here[i], exact, unit * exact + (sizeof(T) == 8 ? 1e-300 : 1e-37));
      }
    }
  }
  std::vector<T> normals(1000);
  std::vector<T> baseline(1000);
  RandomStream(4).fill_normal(std::span(normals));
  particle_baseline::normals(4, std::span(baseline));
  EXPECT_EQ(normals, baseline);
  std::vector<double> weights(1500);
  for (double& w : weights) w = random.uniform() < 0.2 ? 0.0 : std::exp(3.0 * random.normal());
  std::vector<std::uint32_t> here(2000);
  std::vector<std::uint32_t> there(2000);
  RandomStream draws(6);
  EXPECT_TRUE(resample(Resampling::kSystematic, weights, draws, here));
  EXPECT_TRUE(particle_baseline::systematic(weights, 6, there));
  EXPECT_EQ(here, there);
}

TYPED_TEST(ParticleLaw, AStepIsAPredictionAndAnUpdate) {
  for (const double threshold : {0.0, 0.6, 1.0}) {
    auto fused = this->make({.count = 1500, .ess_threshold = threshold});
    auto split = this->make({.count = 1500, .ess_threshold = threshold});
    for (int k = 1; k < 8; ++k) {
      static_cast<void>(fused.step(PlanarMotion{}, 0.1, planar_epoch(k)));
      static_cast<void>(split.predict(PlanarMotion{}, 0.1));
      static_cast<void>(split.update(planar_epoch(k)));
    }
    ASSERT_EQ(this->bits(fused), this->bits(split)) << threshold;
  }
}

TYPED_TEST(ParticleLaw, CopiesGoOnAlike) {
  auto f = this->make({.count = 1100, .threads = 2, .ess_threshold = 0.8});
  this->drive(f, 1, 3);
  auto copy = f;
  const auto before = this->bits(copy);
  this->drive(f, 4, 6);
  EXPECT_EQ(this->bits(copy), before);
  this->drive(copy, 4, 6);
  EXPECT_EQ(this->bits(copy), this->bits(f));
  auto moved = std::move(copy);
  this->drive(moved, 7, 8);
  this->drive(f, 7, 8);
  EXPECT_EQ(this->bits(moved), this->bits(f));
}

TYPED_TEST(ParticleLaw, SeedsDiffer) {
  const Eigen::Matrix<double, 5, 5> P0 = Eigen::Matrix<double, 5, 5>::Identity();
  const ParticleFilter<PlanarClock, TypeParam> a(planar_start(), P0, {.count = 100, .seed = 1});
  const ParticleFilter<PlanarClock, TypeParam> b(planar_start(), P0, {.count = 100, .seed = 2});
  EXPECT_NE(this->bits(a), this->bits(b));
}

TEST(ParticleLaw, ResamplingKeepsTheMean) {
  // The mean of a resampled cloud lies within its Monte-Carlo error of the weighted one (5 sigma).
  for (const Resampling scheme :
       {Resampling::kSystematic, Resampling::kStratified, Resampling::kMultinomial, Resampling::kResidual}) {
    ParticleFilter<PlanarClock> f(planar_start(), Eigen::Matrix<double, 5, 5>::Identity(),
                                  {.count = 20000, .seed = 3, .resampling = scheme});
    static_cast<void>(f.update(planar_epoch(1)));
    const PlanarClock weighted = f.mean();
    const auto P = f.covariance(weighted);
    f.resample();
    EXPECT_EQ(f.ess(), 20000.0);
    for (int i = 0; i < 5; ++i) {
      EXPECT_NEAR(f.mean().x[i], weighted.x[i], 5.0 * std::sqrt(P(i, i) / 20000.0)) << to_string(scheme) << " " << i;
      EXPECT_NEAR(f.covariance()(i, i), P(i, i), 0.1 * P(i, i)) << to_string(scheme) << " " << i;
    }
  }
}

TEST(ParticleThreads, EveryPieceOnce) {
  for (const int threads : {1, 2, 5}) {
    detail::ParticleThreads crew(threads);
    for (const std::size_t pieces : {0U, 1U, 2U, 100U}) {
      for (int call = 0; call < 50; ++call) {
        std::vector<std::atomic<int>> done(pieces);
        crew.run(pieces, [&done](std::size_t i) { done[i].fetch_add(1); });
        for (const auto& d : done) ASSERT_EQ(d.load(), 1);
      }
    }
  }
}

TEST(ParticleThreads, WakeAfterASleep) {
  detail::ParticleThreads crew(3);
  std::atomic<int> done{0};
  for (int call = 0; call < 3; ++call) {
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
    crew.run(64, [&done](std::size_t) { done.fetch_add(1); });
  }
  EXPECT_EQ(done.load(), 192);
}

}  // namespace
}  // namespace soopnav
