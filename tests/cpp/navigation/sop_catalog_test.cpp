#include "soopnav/navigation/sop_catalog.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

#include "soopnav/core/constants.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/navigation/sop_fusion.hpp"
#include "support/allocation_count.hpp"

namespace soopnav::navigation {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kInfinity = std::numeric_limits<double>::infinity();
const clock::Oscillator kClock = clock::Oscillator::ocxo();

SopClock clock_at(double t_s, double bias_s, double drift, bool independent = true) {
  SopClock out;
  out.t_s = t_s;
  out.value = {bias_s, drift};
  out.covariance << 1e-18, 3e-22, 3e-22, 1e-24;
  out.independent = independent;
  return out;
}

SopSource source(const std::string& id, const Eigen::Vector3d& p_e = {6.37e6, 1e5, 2e5}) {
  SopSource out;
  out.id = id;
  out.name = "na\xc3\xafve " + id;
  out.kind = SopKind::kCdma;
  out.carrier_hz = 881.52e6;
  out.contributions = 3;
  out.newest_us = 1'772'366'400'123'456;
  out.at_us = 1'772'366'400'500'000;
  out.grade = 'B';
  out.position = SopPosition{};
  out.position->value = p_e;
  out.position->covariance << 4.0, 1.0, 0.5, 1.0, 9.0, -0.25, 0.5, -0.25, 1.0;
  out.clock = clock_at(0.0, 2.5e-7, -4e-12);
  out.noise = SopNoise{{-54.0, -58.5}, Eigen::Matrix2d{{0.1, -0.02}, {-0.02, 0.3}}};
  return out;
}

std::string sentence_of(const std::vector<std::byte>& bytes) {
  try {
    static_cast<void>(SopCatalog::read(bytes));
  } catch (const std::invalid_argument& error) {
    return error.what();
  }
  return "read";
}

bool says(const std::string& sentence, const char* part) { return sentence.find(part) != std::string::npos; }

std::uint64_t whole(const std::vector<std::byte>& bytes, std::size_t at, std::size_t size) {
  std::uint64_t out = 0;
  for (std::size_t i = size; i > 0; --i) out = out * 256 + std::to_integer<std::uint64_t>(bytes[at + i - 1]);
  return out;
}

double real(const std::vector<std::byte>& bytes, std::size_t at) {
  const std::uint64_t word = whole(bytes, at, 8);
  double out = 0.0;
  std::memcpy(&out, &word, sizeof out);
  return out;
}

/// Puts the checksum right, bit by bit.
void seal(std::vector<std::byte>& bytes) {
  std::uint32_t crc = ~0U;
  for (std::size_t i = 0; i < bytes.size(); ++i) {
    if (i >= 36 && i < 40) continue;
    crc ^= std::to_integer<std::uint32_t>(bytes[i]);
    for (int bit = 0; bit < 8; ++bit) crc = (crc & 1U) != 0 ? 0xEDB88320U ^ (crc >> 1U) : crc >> 1U;
  }
  crc = ~crc;
  for (std::size_t i = 0; i < 4; ++i) bytes[36 + i] = static_cast<std::byte>((crc >> (8 * i)) & 0xFFU);
}

TEST(SopFusion, AClockMovesAsTheTwoStateModelSays) {
  SopClock moved = clock_at(10.0, 1e-7, 2e-11);
  ASSERT_TRUE(move_clock(moved, kClock, 110.0));
  EXPECT_DOUBLE_EQ(moved.value[0], 1e-7 + 100.0 * 2e-11);
  EXPECT_DOUBLE_EQ(moved.value[1], 2e-11);
  const double s_f = 0.5 * kClock.h0, s_g = 2.0 * kPi * kPi * kClock.h_minus_2;
  EXPECT_NEAR(moved.covariance(0, 0) / (1e-18 + 200.0 * 3e-22 + 1e4 * 1e-24 + 100.0 * s_f + 1e6 * s_g / 3.0), 1.0,
              1e-12);
  EXPECT_NEAR(moved.covariance(0, 1) / (3e-22 + 100.0 * 1e-24 + 0.5e4 * s_g), 1.0, 1e-12);
  EXPECT_NEAR(moved.covariance(1, 1) / (1e-24 + 100.0 * s_g), 1.0, 1e-12);

  SopClock in_steps = clock_at(10.0, 1e-7, 2e-11), back = in_steps;
  for (const double t : {11.0, 45.0, 110.0}) ASSERT_TRUE(move_clock(in_steps, kClock, t));
  EXPECT_NEAR((in_steps.covariance - moved.covariance).cwiseQuotient(moved.covariance).cwiseAbs().maxCoeff(), 0.0,
              1e-12);
  ASSERT_TRUE(move_clock(back, kClock, -90.0));  // mirrored in time: the drift's sign turns
  EXPECT_DOUBLE_EQ(back.value[0], 1e-7 - 100.0 * 2e-11);
  EXPECT_NEAR(back.covariance(1, 1) / moved.covariance(1, 1), 1.0, 1e-12);
  EXPECT_LT(back.covariance(0, 1), 0.0);
}

TEST(SopFusion, WhatIsNotANumberMovesNothing) {
  SopClock c = clock_at(0.0, 0.0, 0.0);
  EXPECT_FALSE(move_clock(c, kClock, kNan));
  EXPECT_FALSE(move_clock(c, kClock, kInfinity));
  EXPECT_FALSE(move_clock(c, {-1e-24, 0.0}, 1.0));
  EXPECT_FALSE(move_clock(c, {kNan, 0.0}, 1.0));
  EXPECT_FALSE(age(c, -1.0, 1.0));
  EXPECT_FALSE(age(c, 1.0, kNan));
  EXPECT_EQ(c.t_s, 0.0);
  SopClock bad = clock_at(0.0, kNan, 0.0);
  EXPECT_FALSE(fuse_independent(c, bad));
  EXPECT_TRUE(std::isnan(intersect(c, bad)));
  EXPECT_EQ(disagreement(c, bad), kInfinity);
  bad = clock_at(0.0, 0.0, 0.0);
  bad.covariance(0, 0) = -1.0;
  EXPECT_TRUE(std::isnan(intersect(c, bad)));
  EXPECT_EQ(c.value, Eigen::Vector2d::Zero());

  SopClock out;
  const std::array<SopClock, 2> falling{clock_at(1.0, 0.0, 0.0), clock_at(0.0, 0.0, 0.0)};
  EXPECT_EQ(fuse_clocks({}, kClock, 0.0, out), SopFusionStatus::kEmpty);
  EXPECT_EQ(fuse_clocks(falling, kClock, 0.0, out), SopFusionStatus::kUnordered);
  EXPECT_EQ(fuse_clocks({&bad, 1}, kClock, 0.0, out), SopFusionStatus::kUndefined);
  EXPECT_EQ(fuse_clocks({&c, 1}, kClock, kNan, out), SopFusionStatus::kUndefined);
  EXPECT_EQ(fuse_clocks({&c, 1}, kClock, 5.0, out), SopFusionStatus::kOk);
}

TEST(SopFusion, TheSameWordTwiceIsWorthOneWhenItMayBeTheSame) {
  SopClock a = clock_at(0.0, 1e-7, 0.0), free = a;
  const double w = intersect(a, clock_at(0.0, 1e-7, 0.0));
  EXPECT_TRUE(w >= 0.0 && w <= 1.0);
  EXPECT_NEAR(a.covariance(0, 0) / 1e-18, 1.0, 1e-9);
  EXPECT_FALSE(a.independent);
  ASSERT_TRUE(fuse_independent(free, clock_at(0.0, 1e-7, 0.0)));
  EXPECT_NEAR(free.covariance(0, 0) / 0.5e-18, 1.0, 1e-9);
}

TEST(SopFusion, LeastVariancesAreThoseOfTheFilterThatReadsWithoutError) {
  // A Kalman filter of the drift alone, whose readings are increments of the offset: Riccati's equation in small steps.
  const double s_f = 0.5 * kClock.h0, s_g = 2.0 * kPi * kPi * kClock.h_minus_2, dt = 1e-3;
  double P = 1.0;
  for (int i = 0; i < 20'000; ++i) {
    P = P * s_f / (P * dt + s_f) + s_g * dt;
    if (i == 4'999) {
      EXPECT_NEAR(least_drift_variance(kClock, 5.0) / P, 1.0, 3e-3);
    }
  }
  EXPECT_NEAR(least_drift_variance(kClock, kInfinity) / P, 1.0, 3e-3);
  // At 240 s and 2.6e-22, 4e-26 no estimator can do better than a spread of 0.65 in ln h-2 (the full bound is 0.74).
  EXPECT_NEAR(std::sqrt(least_ln_walk_variance({2.6e-22, 4e-26}, 240.0)), 0.65, 0.01);
  EXPECT_TRUE(std::isnan(least_drift_variance(kClock, 0.0)));
  EXPECT_TRUE(std::isnan(least_ln_walk_variance({0.0, 1.0}, 1.0)));
}

TEST(SopCatalog, WhatIsWrittenIsReadBack) {
  const std::vector<SopSource> sources{source("b"), source("a", {6.38e6, 0.0, 0.0}), source("c")};
  std::vector<SopSource> bare = sources;
  bare[2].position.reset();
  bare[2].clock.reset();
  bare[2].noise.reset();
  const auto catalog = SopCatalog::read(write_snapshot(bare, 77));
  ASSERT_EQ(catalog.sources().size(), 3U);
  EXPECT_EQ(catalog.created_us(), 77);
  EXPECT_EQ(catalog.sources()[0].id, "a");
  const SopSource* const b = catalog.find("b");
  ASSERT_NE(b, nullptr);
  EXPECT_EQ(b->name, sources[0].name);
  EXPECT_EQ(b->kind, SopKind::kCdma);
  EXPECT_EQ(b->carrier_hz, 881.52e6);
  EXPECT_EQ(b->contributions, 3U);
  EXPECT_EQ(b->newest_us, sources[0].newest_us);
  EXPECT_EQ(b->grade, 'B');
  EXPECT_EQ(b->position->covariance, sources[0].position->covariance);
  EXPECT_EQ(b->clock->value, sources[0].clock->value);
  EXPECT_EQ(b->noise->ln_covariance, sources[0].noise->ln_covariance);
  const SopSource* const c = catalog.find("c");
  ASSERT_NE(c, nullptr);
  EXPECT_TRUE(!c->position && !c->clock && !c->noise);
  EXPECT_EQ(catalog.find("d"), nullptr);
  EXPECT_EQ(SopCatalog::read(write_snapshot({}, 0)).sources().size(), 0U);
}

TEST(SopCatalog, BytesAreWhereTheFormatHasThem) {
  const auto bytes = write_snapshot(std::array{source("tower")}, -5);
  ASSERT_EQ(bytes.size(), 40U + 624U);
  EXPECT_EQ(std::memcmp(bytes.data(), "SOPCAT\r\n", 8), 0);
  EXPECT_EQ(whole(bytes, 8, 2), 1U);
  EXPECT_EQ(whole(bytes, 10, 2), 40U);
  EXPECT_EQ(whole(bytes, 12, 4), 624U);
  EXPECT_EQ(whole(bytes, 16, 8), 1U);
  EXPECT_EQ(static_cast<std::int64_t>(whole(bytes, 24, 8)), -5);
  auto sealed = bytes;
  seal(sealed);
  EXPECT_EQ(sealed, bytes);
  EXPECT_EQ(std::memcmp(bytes.data() + 40, "tower\0\0", 7), 0);
  EXPECT_EQ(whole(bytes, 40 + 440, 4), 1U | 7U << 8U | std::uint64_t{'B'} << 16U);
  EXPECT_EQ(real(bytes, 40 + 448), 881.52e6);
  EXPECT_EQ(real(bytes, 40 + 472), 6.37e6);
  EXPECT_EQ(real(bytes, 40 + 504), 1.0);     // covariance xy
  EXPECT_EQ(real(bytes, 40 + 544), 2.5e-7);  // offset
  EXPECT_EQ(real(bytes, 40 + 576), 1e-24);   // variance of the drift
  EXPECT_EQ(real(bytes, 40 + 584), -54.0);   // ln h0
  EXPECT_EQ(real(bytes, 40 + 616), 0.3);     // variance of ln h-2
}

TEST(SopCatalog, RefusesWhatIsNoSnapshot) {
  const auto good = write_snapshot(std::array{source("a"), source("b")}, 0);
  ASSERT_EQ(sentence_of(good), "read");
  EXPECT_TRUE(says(sentence_of({}), "a header of 40 bytes expected, got 0"));
  auto bytes = good;
  bytes[0] = std::byte{'X'};
  EXPECT_TRUE(says(sentence_of(bytes), "not those of a snapshot"));
  bytes = good;
  bytes[8] = std::byte{2};
  EXPECT_TRUE(says(sentence_of(bytes), "version 2; this program reads version 1"));
  bytes = good;
  bytes.pop_back();
  EXPECT_TRUE(says(sentence_of(bytes), "2 records of 624 bytes expected, got 1247 bytes"));
  bytes = good;
  for (std::size_t i = 16; i < 24; ++i) bytes[i] = std::byte{0xFF};
  EXPECT_TRUE(says(sentence_of(bytes), "18446744073709551615 records"));
  bytes = good;
  bytes[12] = std::byte{0};
  EXPECT_TRUE(says(sentence_of(bytes), "records of 624 expected"));
  for (const std::size_t at : {24U, 30U, 40U, 100U, 700U, 1287U}) {  // every other byte is the checksum's
    bytes = good;
    bytes[at] ^= std::byte{0x10};
    EXPECT_TRUE(says(sentence_of(bytes), "the file is damaged")) << at;
  }
  bytes = good;
  bytes[40] = std::byte{'z'};  // ids z, b
  seal(bytes);
  EXPECT_TRUE(says(sentence_of(bytes), "record 1: ids that rise expected"));
  bytes = good;
  for (std::size_t i = 0; i < 8; ++i) bytes[40 + 544 + i] = std::byte{0xFF};  // the offset not a number
  seal(bytes);
  EXPECT_TRUE(says(sentence_of(bytes), "record 0: its clock must have finite numbers"));
  bytes = good;
  bytes[40 + 440] = std::byte{9};
  seal(bytes);
  EXPECT_TRUE(says(sentence_of(bytes), "record 0: a known kind expected"));
}

TEST(SopCatalog, RefusesWhatCannotBePrintedOrComputed) {
  const auto changed = [](std::size_t at, std::initializer_list<int> with) {
    auto bytes = write_snapshot(std::array{source("a")}, 0);
    for (const int value : with) bytes[at++] = static_cast<std::byte>(value);
    seal(bytes);
    return sentence_of(bytes);
  };
  constexpr std::size_t kName = 40 + 40, kLnH0 = 40 + 584;
  EXPECT_EQ(changed(kName, {0xF0, 0x9F, 0x93, 0xA1, 0}), "read");
  for (const auto& text : std::initializer_list<std::initializer_list<int>>{
           {0x1B, '[', 0},               // escape
           {0x7F, 0},                    // delete
           {0xC2, 0x9B, 0},              // the same as escape [ in one character
           {0xFF, 0},                    // no first byte
           {0xC0, 0x80, 0},              // zero, too long
           {0xED, 0xA0, 0x80, 0},        // a surrogate
           {0xF4, 0x90, 0x80, 0x80, 0},  // past the last
           {0xE2, 0x82, 0},              // cut off
       }) {
    EXPECT_TRUE(says(changed(kName, text), "record 0: an id and a name of UTF-8")) << std::data(text)[0];
    EXPECT_TRUE(says(changed(40, text), "record 0: an id and a name of UTF-8")) << std::data(text)[0];
  }
  const std::initializer_list<int> far{0, 0, 0, 0, 0, 0, 0, 0x7F};
  EXPECT_TRUE(says(changed(24, far), "snapshot: a time of its making between the years 1 and 9999"));
  EXPECT_TRUE(says(changed(40 + 456, far), "record 0: a newest contribution between the years 1 and 9999"));
  EXPECT_TRUE(says(changed(40 + 464, {0, 0, 0, 0, 0, 0, 0, 0x80}), "record 0: a state between the years"));
  EXPECT_TRUE(says(changed(kLnH0, {0, 0, 0, 0, 0, 0, 0x69, 0x40}), "record 0: logarithms of noise below 200"));  // 200
  EXPECT_THROW(static_cast<void>(write_snapshot({}, std::numeric_limits<std::int64_t>::max())), std::invalid_argument);
}

TEST(SopCatalog, RefusesToWriteWhatCannotBeRead) {
  const auto refused = [](const SopSource& one) {
    EXPECT_THROW(static_cast<void>(write_snapshot({&one, 1}, 0)), std::invalid_argument);
  };
  SopSource s = source("");
  refused(s);
  s.id = std::string(41, 'x');
  refused(s);
  s = source("a");
  s.name = std::string(401, 'x');
  refused(s);
  s = source("a");
  s.carrier_hz = kNan;
  refused(s);
  s = source("a");
  s.grade = 'E';
  refused(s);
  s = source("a");
  s.clock->covariance(1, 1) = 0.0;
  refused(s);
  s = source("a");
  s.position->covariance(0, 1) = s.position->covariance(1, 0) = 7.0;  // correlation above 1
  refused(s);
  EXPECT_THROW(static_cast<void>(write_snapshot(std::array{source("a"), source("a")}, 0)), std::invalid_argument);
}

TEST(SopCatalog, FilesAreReadOrRefusedByName) {
  const auto path = std::filesystem::path(::testing::TempDir()) / "sop_catalog_test.sopcat";
  const auto bytes = write_snapshot(std::array{source("a")}, 0);
  std::ofstream(path, std::ios::binary)
      .write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
  EXPECT_EQ(SopCatalog::open(path).sources().size(), 1U);
  std::ofstream(path, std::ios::binary) << "nothing of the kind";
  try {
    static_cast<void>(SopCatalog::open(path));
    FAIL();
  } catch (const std::invalid_argument& error) {
    EXPECT_TRUE(says(error.what(), "sop_catalog_test.sopcat: snapshot: a header"));
  }
  std::filesystem::remove(path);
  EXPECT_THROW(static_cast<void>(SopCatalog::open(path)), std::invalid_argument);
}

TEST(SopCatalog, FindsByCarrierAndByPlaceWithoutTheHeap) {
  std::vector<SopSource> sources;
  RandomStream random(1);
  for (int i = 0; i < 200; ++i) {
    sources.push_back(source(std::to_string(i), {6.37e6, 1e4 * random.normal(), 1e4 * random.normal()}));
    sources.back().carrier_hz = 800e6 + 1e6 * i;
  }
  const auto catalog = SopCatalog::read(write_snapshot(sources, 0));
  std::array<const SopSource*, 5> found{};
  std::size_t of_carrier = 0, nearby = 0, none = 0;
  const Eigen::Vector3d here(6.37e6, 0.0, 0.0);
  SopPrior prior_of;
  bool ok = false;
  const long heap = test::allocations_of([&] {
    of_carrier = catalog.find(SopKind::kCdma, 850e6, 2.5e6, found);
    none = catalog.find(SopKind::kLte, 850e6, 2.5e6, {});
    nearby = catalog.near(here, 5e3, found);
    ok = catalog.find("77") != nullptr &&
         prior(*catalog.find("77"), Epoch(TimeScale::kUtc, 1'772'370'000, 0.0), prior_of);
  });
  if (test::kAllocationsCounted) {
    EXPECT_EQ(heap, 0);
  }
  EXPECT_TRUE(ok);
  EXPECT_EQ(of_carrier, 5U);
  EXPECT_EQ(none, 0U);
  std::vector<double> distances;
  for (const SopSource& s : sources) {
    if (const double d = (s.position->value - here).norm(); d <= 5e3) distances.push_back(d);
  }
  std::sort(distances.begin(), distances.end());
  ASSERT_EQ(nearby, distances.size());
  ASSERT_GT(nearby, 5U);
  for (std::size_t i = 0; i < 5; ++i) EXPECT_EQ((found[i]->position->value - here).norm(), distances[i]);
  EXPECT_EQ(catalog.near({kNan, 0.0, 0.0}, 5e3, found), 0U);
}

TEST(SopCatalog, APriorIsInMetresAndGrows) {
  const SopSource s = source("a");
  SopPrior now, later;
  const Epoch at(TimeScale::kUtc, 1'772'366'400, 0.5);
  ASSERT_TRUE(prior(s, at, now));
  ASSERT_TRUE(prior(s, at + 3600.0, later));
  EXPECT_NEAR(now.clock[0], kSpeedOfLightMps * 2.5e-7, 1e-12);
  EXPECT_NEAR(later.clock[0] - now.clock[0], -3600.0 * kSpeedOfLightMps * 4e-12, 1e-9);
  const double s_g = 2.0 * kPi * kPi * std::exp(-58.5 + 0.15);
  EXPECT_NEAR(later.clock_covariance(1, 1) / (kSpeedOfLightMps * kSpeedOfLightMps * (1e-24 + 3600.0 * s_g)), 1.0, 1e-4);
  EXPECT_GT(later.position_covariance_m2(0, 0), now.position_covariance_m2(0, 0));
  EXPECT_TRUE(later.has_noise);
  EXPECT_NEAR(now.noise.white_frequency_m2ps, 0.5 * kSpeedOfLightMps * kSpeedOfLightMps * std::exp(-54.0 + 0.05),
              1e-12);
  SopSource unknown = s;
  unknown.noise.reset();
  ASSERT_TRUE(prior(unknown, at, now));
  EXPECT_FALSE(now.has_noise);
  EXPECT_EQ(now.noise, clock::Oscillator::tcxo().noise());
  EXPECT_FALSE(prior(s, Epoch(TimeScale::kGps, 0, 0.0), now));
  EXPECT_FALSE(prior(s, Epoch::invalid(TimeScale::kUtc), now));
}

}  // namespace
}  // namespace soopnav::navigation
